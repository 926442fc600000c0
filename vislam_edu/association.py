"""Which landmarks are one and the same place? The joint covariance answers, and a loop is closed.

    closing = association.LoopClosing(drive, RightInvariant())
    window_slam.run(drive, noise, RightInvariant(), retire=window_slam.retire_none, associate=closing)

A tracker that comes back to a place gives it a new number, so the map holds the place twice. How far apart the two may
be follows from the joint covariance: m_i - m_j has the mean 0 and the covariance S_ij = P_ii + P_jj - P_ij - P_ji. Each
of several pairs can pass its own gate and all of them together still be impossible, because the error of the pose moves
all new landmarks alike; so pairs are judged together. Pairs that are accepted become a measurement without noise,
m_new - m_old = 0, of the whole joint state. The old row then leaves the map; the landmark keeps the new number, which
the tracker goes on using.

Sources: Neira, Tardós, Data association in stochastic mapping using the joint compatibility test, 2001; Bell, Cathey,
The iterated Kalman filter update as a Gauss-Newton method, 1993.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from . import kalman, motion, window_slam
from .drive import Drive
from .error_state import ErrorState
from .motion import Belief

ITERATIONS = 5  # of the constraint; the third changes millimetres

Pairs = list[tuple[int, int]]  # (new, old): ids, or places in `Candidates`


def in_the_world(belief: Belief, rows: np.ndarray, error_state: ErrorState) -> np.ndarray:
    """A (3n, d) with m - m_hat = A (error of the state) for the n landmarks at `rows`, metres in the world."""
    A = np.zeros((len(rows), 3, len(belief.covariance)))
    D = error_state.metres(belief.points[rows])
    A[np.arange(len(rows))[:, None], :, 3 * rows[:, None] + np.arange(3)] = D.mT
    A[:, :, belief.pose] = D @ error_state.world_landmark(belief.points[rows])
    return A.reshape(3 * len(rows), -1)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Landmarks of which some may be the same place, and their joint covariance.

    new : (n,) ids. old : (m,) ids. landmarks : (n+m, 3), m, world. covariance : (3(n+m), 3(n+m)), m^2, new ones first.
    """

    new: np.ndarray
    old: np.ndarray
    landmarks: np.ndarray
    covariance: np.ndarray

    def joint(self, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """m_new - m_old of some pairs, (3k,), and its covariance (3k, 3k). pairs : places (i in new, j in old)."""
        i, j = np.reshape(pairs, (-1, 2)).T
        j = j + len(self.new)
        n = len(self.landmarks)
        P = self.covariance.reshape(n, 3, n, 3).swapaxes(1, 2)
        S = P[np.ix_(i, i)] + P[np.ix_(j, j)] - P[np.ix_(i, j)] - P[np.ix_(j, i)]
        return (self.landmarks[i] - self.landmarks[j]).ravel(), S.swapaxes(1, 2).reshape(3 * len(i), -1)

    def joint_nis(self, pairs: Pairs) -> float:
        """NIS of some pairs together: chi-square with 3k degrees of freedom where all k are right."""
        d, S = self.joint(pairs)
        return float(kalman.nis(d, S))

    def nis(self) -> np.ndarray:
        """(n, m): NIS of every pair alone, 3 degrees of freedom."""
        n, m = len(self.new), len(self.old)
        d = self.landmarks[:n, None] - self.landmarks[None, n:]
        P = self.covariance.reshape(n + m, 3, n + m, 3).swapaxes(1, 2)
        own = np.diagonal(P).transpose(2, 0, 1)
        cross = P[:n, n:]
        return kalman.nis(d, own[:n, None] + own[None, n:] - cross - cross.swapaxes(2, 3))


def candidates(belief: Belief, new: np.ndarray, old: np.ndarray, error_state: ErrorState) -> Candidates:
    """The landmarks with ids `new` and `old` and their joint covariance in the world, from the joint belief."""
    rows = np.searchsorted(belief.ids, np.concatenate([new, old]))
    A = in_the_world(belief, rows, error_state)
    return Candidates(new, old, belief.landmarks[rows], A @ belief.covariance @ A.T)


def nearest_neighbour(both: Candidates, gate: float = 0.99) -> Pairs:
    """Each new landmark takes the nearest old one (smallest NIS) that passes its own gate and is still free."""
    nis, pairs = both.nis(), []
    for _ in range(min(nis.shape)):
        i, j = np.unravel_index(np.argmin(nis), nis.shape)
        if nis[i, j] > kalman.gate_threshold(gate, 3):
            break
        pairs.append((int(i), int(j)))
        nis[i], nis[:, j] = np.inf, np.inf
    return pairs


def sequential(both: Candidates, gate: float = 0.99) -> Pairs:
    """The nearest neighbours, closest first; one that does not fit together with those before it is left out."""
    pairs: Pairs = []
    for pair in nearest_neighbour(both, gate):
        if both.joint_nis([*pairs, pair]) <= kalman.gate_threshold(gate, 3 * (len(pairs) + 1)):
            pairs.append(pair)
    return pairs


@dataclass(frozen=True, eq=False)
class Node:
    """One set of pairs that branch and bound has looked at. best : the best set so far, this one included."""

    pairs: Pairs
    nis: float
    compatible: bool
    best: Pairs


def branch_and_bound(both: Candidates, gate: float = 0.99) -> Iterator[Node]:
    """The tree of joint compatibility, depth first: one level for each new landmark, one branch for each old one.

    A branch ends when its pairs do not fit together, or when even with a pair for each landmark that is left it would
    have fewer than the best. Among sets of equal size the smaller NIS wins. Yields every node; the `best` of the last
    one is the answer.
    Source: Neira, Tardós 2001.
    """
    nis = both.nis()
    alone = nis <= kalman.gate_threshold(gate, 3)
    order = [int(i) for i in np.argsort(np.where(alone.any(axis=1), alone.sum(axis=1), len(both.old) + 1))
             if alone[i].any()]  # the least ambiguous first: the tree is narrow where it begins
    best: Pairs = []
    best_nis = np.inf

    def below(level: int, pairs: Pairs) -> Iterator[Node]:
        nonlocal best, best_nis
        if level == len(order):
            return
        i = order[level]
        taken = {j for _, j in pairs}
        for j in np.argsort(nis[i]):
            if not alone[i, j]:
                break
            if len(pairs) + len(order) - level < len(best):
                return
            if j in taken:
                continue
            longer = [*pairs, (i, int(j))]
            together = both.joint_nis(longer)
            fits = together <= kalman.gate_threshold(gate, 3 * len(longer))
            if fits and (len(longer), -together) > (len(best), -best_nis):
                best, best_nis = longer, together
            yield Node(longer, together, fits, best)
            if fits:
                yield from below(level + 1, longer)
        if len(pairs) + len(order) - level - 1 >= len(best):  # this landmark without a partner
            yield from below(level + 1, pairs)

    yield from below(0, [])


def joint_compatibility(both: Candidates, gate: float = 0.99) -> Pairs:
    """The largest set of pairs that fit together, see `branch_and_bound`."""
    best: Pairs = []
    for node in branch_and_bound(both, gate):
        best = node.best
    return best


def constraint(belief: Belief, pairs: Pairs, error_state: ErrorState) -> tuple[np.ndarray, np.ndarray]:
    """m_new - m_old (3k,), which should be 0, and its Jacobian (3k, d). pairs : k times (new id, old id)."""
    new, old = np.searchsorted(belief.ids, np.reshape(pairs, (-1, 2)).T)
    return ((belief.landmarks[new] - belief.landmarks[old]).ravel(),
            in_the_world(belief, new, error_state) - in_the_world(belief, old, error_state))


def fuse(belief: Belief, pairs: Pairs, error_state: ErrorState, iterations: int = ITERATIONS) -> Belief:
    """The joint belief after learning that each pair is one place: a measurement m_new - m_old = 0 without noise.

    pairs : (new id, old id). The rows of the old ids leave the belief. The error may be metres large, so the constraint
    is linearised again at each new estimate; the update always starts from the prior.
    Source: Bell, Cathey 1993.
    """
    P, delta, moved = belief.covariance, np.zeros(len(belief.covariance)), belief
    for _ in range(iterations):
        d, H = constraint(moved, pairs, error_state)
        HP = H @ P
        L = cholesky(HP @ H.T, lower=True)
        Y = solve_triangular(L, np.column_stack([HP, H @ delta - d]), lower=True)
        delta = Y[:, :-1].T @ Y[:, -1]
        moved = motion.retract(belief, delta, P - Y[:, :-1].T @ Y[:, :-1], error_state)
    return window_slam.marginalise(moved, ~np.isin(moved.ids, [old for _, old in pairs]))


def merged(n_landmarks: int, pairs: Pairs) -> np.ndarray:
    """(M,): for each landmark the first id of the same place, for `batch.Problem`'s `place`. pairs : (new id, old id).

    Pairs chain: if 7 is 4 and 4 is 1, all three are 1. Union-find: each id points to an earlier one of its place, and
    a place is joined to another at its root.
    Source: Galler, Fischer, An improved equivalence algorithm, 1964.

    >>> merged(5, [(4, 2), (2, 1)]).tolist()
    [0, 1, 1, 3, 1]
    """
    parent = np.arange(n_landmarks)

    def root(i: int) -> int:
        while parent[i] != i:
            i = int(parent[i])
        return i

    for new, old in pairs:
        a, b = sorted((root(new), root(old)))
        parent[b] = a
    return np.array([root(i) for i in range(n_landmarks)])


@dataclass(eq=False)
class LoopClosing:
    """Looks in each frame for places that the map has twice, and fuses them: for `window_slam.run`'s `associate`.

    New are the landmarks in view that have been seen in `settled` frames and are not fused yet; old those that were
    last seen `forgotten` frames ago. Nothing of the future is used. `least` pairs must fit together: fewer fit by
    chance.

    choose : `joint_compatibility`, or another function of `Candidates` and gate.
    fused : list of (frame, new id, old id), what has been done.
    """

    drive: Drive
    error_state: ErrorState
    choose: Callable[[Candidates, float], Pairs] = joint_compatibility
    gate: float = 0.99
    forgotten: int = 100
    settled: int = 5
    least: int = 4
    fused: list[tuple[int, int, int]] = field(default_factory=list)

    def __call__(self, belief: Belief, k: int) -> Belief:
        """The belief of frame k, with what was found to be one place fused."""
        ids = belief.ids
        first, last = self.drive.first_seen[ids], self.drive.last_seen[ids]
        done = np.isin(ids, [new for _, new, _ in self.fused])
        new, old = ids[(last >= k) & (first <= k - self.settled) & ~done], ids[last < k - self.forgotten]
        if len(new) < self.least or len(old) < self.least:
            return belief
        both = self.compatible(belief, new, old)
        pairs = [(int(both.new[i]), int(both.old[j])) for i, j in self.choose(both, self.gate)]
        if len(pairs) < self.least:
            return belief
        self.fused += [(k, *pair) for pair in pairs]
        return fuse(belief, pairs, self.error_state)

    def compatible(self, belief: Belief, new: np.ndarray, old: np.ndarray) -> Candidates:
        """The candidates, without those old landmarks that are too far from every new one to be worth a covariance."""
        at_new, at_old = (belief.landmarks[np.searchsorted(belief.ids, ids)] for ids in (new, old))
        to_world = self.error_state.world_pose(belief.world_T_imu)[:3]
        sigma = np.sqrt(np.trace(to_world @ belief.pose_covariance @ to_world.T))
        near = np.linalg.norm(at_new[:, None] - at_old, axis=-1).min(axis=0) < 5 * sigma + 5.0
        return candidates(belief, new, old[near], self.error_state)
