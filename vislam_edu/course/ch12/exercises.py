"""Exercises of notebook 12: which landmarks are one place, and what it means for all the others."""

import numpy as np

from ... import association, kalman
from ..checks.exercise import exercise
from ..checks.inputs import random_covariance


def maps(rng):
    for n, i, j in ((6, 3, 1), (5, 0, 4), (7, 2, 5)):
        yield "random", (rng.normal(size=(n, 3)), random_covariance(rng, 3 * n), i, j)


@exercise(chapter=12, cases=maps, shows=[association.Candidates.joint], outputs=["difference", "S"], hints=[
    "The difference of two correlated vectors: write it as [I, -I] times both.",
    "S = P_ii + P_jj - P_ij - P_ji."])
def pair_covariance(landmarks, covariance, i, j):
    """How far apart two landmarks of the map are, and the covariance of that.

    landmarks : (n, 3), m, world. covariance : (3n, 3n), m^2, of all of them. i, j : two of them.
    Returns m_i - m_j (3,) and its covariance S_ij (3, 3).
    """
    a, b = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
    P = covariance
    return landmarks[i] - landmarks[j], P[a, a] + P[b, b] - P[a, b] - P[b, a]


pair_covariance.slip("cross terms dropped", """P_ii + P_jj is right only for independent errors. Both landmarks were
    seen from one drifting car: what they share cancels in the difference.""", (" - P[a, b] - P[b, a]", ""))
pair_covariance.slip("plus for minus", """That is the covariance of the sum. In a difference what both share cancels:
    minus P_ij and minus P_ji.""", ("- P[a, b] - P[b, a]", "+ P[a, b] + P[b, a]"))
pair_covariance.slip("one cross term twice", """P_ij and P_ji are transposes of each other, not equal: subtract each
    once, or S is not symmetric.""", ("P[b, a]", "P[a, b]"))
pair_covariance.slip("steps of one", "Landmark i has the rows 3i to 3i + 2.", ("3 * i, 3 * i + 3", "i, i + 3"),
    ("3 * j, 3 * j + 3", "j, j + 3"))


def _pairs_of(rng):
    for n, pairs in ((4, [(0, 2)]), (6, [(0, 3), (2, 4)]), (9, [(8, 0), (5, 1), (4, 2), (7, 5)])):
        yield "random", (0.3 * rng.normal(size=(n, 3)), random_covariance(rng, 3 * n), pairs)


@exercise(chapter=12, cases=_pairs_of, shows=[association.Candidates.joint, kalman.gate_threshold],
          outputs=["nis", "threshold"], hints=[
    "Stack the k differences into one vector; its covariance has 3k rows and is not block diagonal.",
    "A has the rows [.. I .. -I ..]: d = A m, S = A P A^T, nis = d^T S^-1 d, threshold = "
    "kalman.gate_threshold(0.99, 3k)."])
def joint_nis(landmarks, covariance, pairs):
    """The NIS of k pairs together, and the largest that right pairs have with probability 0.99.

    landmarks : (n, 3), m, world. covariance : (3n, 3n), m^2. pairs : k tuples (i, j), m_i - m_j should be 0.
    Returns the joint NIS and the threshold. You may use `kalman`.
    """
    A = np.zeros((3 * len(pairs), 3 * len(landmarks)))
    for k, (i, j) in enumerate(pairs):
        A[3 * k:3 * k + 3, 3 * i:3 * i + 3] = np.eye(3)
        A[3 * k:3 * k + 3, 3 * j:3 * j + 3] = -np.eye(3)
    d = A @ landmarks.ravel()
    S = A @ covariance @ A.T
    return d @ np.linalg.inv(S) @ d, kalman.gate_threshold(0.99, len(d))


joint_nis.slip("sum of the individual NIS", """The pairs share the error of the pose, so their differences are
    correlated. Adding their own NIS drops the off-diagonal blocks of S, and with them the whole joint test.""",
    ("A @ covariance @ A.T", "A @ covariance @ A.T * np.kron(np.eye(len(pairs)), np.ones((3, 3)))"))
joint_nis.slip("3 degrees of freedom", """k pairs are 3k numbers: the gate has 3k degrees of freedom. With 3 it turns
    away right pairs as soon as there are several.""", ("len(d)", "3"))
joint_nis.slip("k degrees of freedom", "A pair is three numbers, not one: 3k degrees of freedom.",
    ("len(d)", "len(pairs)"))
joint_nis.slip("mean over the pairs", """The NIS is the sum, d^T S^-1 d, which the threshold for 3k degrees of freedom
    belongs to.""", ("inv(S) @ d", "inv(S) @ d / len(pairs)"))
joint_nis.slip("mean over the numbers", """The NIS is the sum, d^T S^-1 d, which the threshold for 3k degrees of freedom
    belongs to. Do not divide by 3k.""", ("inv(S) @ d", "inv(S) @ d / len(d)"))
joint_nis.slip("threshold of another probability", """Right pairs stay below the threshold with probability 0.99, not
    0.95.""", ("0.99", "0.95"))
joint_nis.slip("threshold of 1 %", """Right pairs are to stay *below* with probability 0.99: the quantile of 0.99, not
    of 0.01.""", ("0.99", "0.01"))


def _one_pair(rng):
    for n, new, old in ((4, 3, 1), (6, 4, 2), (5, 1, 3)):
        landmarks = rng.normal(size=(n, 3))
        landmarks[new] = landmarks[old] + 0.1 * rng.normal(size=3)
        yield "random", (landmarks, random_covariance(rng, 3 * n), new, old)


@exercise(chapter=12, cases=_one_pair, shows=[association.fuse], outputs=["landmarks", "covariance"], tolerance=1e-7,
          hints=[
    "It is a Kalman update with the measurement m_new - m_old = 0, without noise. Then the old row goes.",
    "H = [.. I .. -I ..], S = H P H^T, K = P H^T S^-1: all landmarks move by K (0 - (m_new - m_old)), P - K H P."])
def fuse_pair(landmarks, covariance, new, old):
    """A map after learning that two of its landmarks are one place: the whole map is corrected, the old row leaves.

    landmarks : (n, 3), m, world. covariance : (3n, 3n), m^2. new, old : rows of the two. Returns landmarks (n-1, 3) and
    covariance (3n-3, 3n-3), the others in their old order.
    """
    n = len(landmarks)
    H = np.zeros((3, 3 * n))
    H[:, 3 * new:3 * new + 3] = np.eye(3)
    H[:, 3 * old:3 * old + 3] = -np.eye(3)
    S = H @ covariance @ H.T
    K = covariance @ H.T @ np.linalg.inv(S)
    delta = K @ (landmarks[old] - landmarks[new])
    moved = landmarks + delta.reshape(-1, 3)
    P = covariance - K @ H @ covariance
    rows = np.arange(3 * old, 3 * old + 3)
    return np.delete(moved, old, axis=0), np.delete(np.delete(P, rows, axis=0), rows, axis=1)


fuse_pair.slip("average of the two", """The mean of the two positions ignores which of them is known better, and tells
    the rest of the map nothing. It is a Kalman update with m_new - m_old = 0.""",
    ("moved = landmarks + delta.reshape(-1, 3)",
     "moved = landmarks.copy()\n    moved[new] = (landmarks[new] + landmarks[old]) / 2"),
    (" - K @ H @ covariance", ""))
fuse_pair.slip("only the two updated", """The gain has rows for every landmark: through the cross-covariances all of
    them move and gain. That is what closing a loop is for.""",
    ("moved = landmarks + delta",
     "two = np.repeat(np.isin(np.arange(n), [new, old]), 3)\n    moved = landmarks + (two * delta)"),
    ("K @ H @ covariance", "np.outer(two, two) * (K @ H @ covariance)"))
fuse_pair.slip("both rows kept", """After the update the two rows hold the same numbers, so the covariance is singular
    and the next update breaks. The old row has to go.""",
    ("np.delete(moved, old, axis=0), np.delete(np.delete(P, rows, axis=0), rows, axis=1)", "moved, P"))
fuse_pair.slip("old row dropped, nothing learned", """Dropping the old row is marginalising: it forgets what the place
    was known to be. First the update, then the row goes.""",
    ("covariance @ H.T @ np.linalg.inv(S)", "np.zeros((3 * n, 3))"))
fuse_pair.slip("noise added", """The two are one place exactly: the measurement m_new - m_old = 0 has no noise, S = H P
    H^T.""", ("S = H @ covariance @ H.T", "S = H @ covariance @ H.T + np.eye(3)"))


def _chains(rng):
    yield "no pair", (3, [])
    yield "a pair", (4, [(3, 1)])
    yield "a chain", (8, [(4, 1), (7, 4)])
    yield "a chain, last link first", (8, [(7, 4), (4, 1)])
    yield "two chains that meet", (10, [(5, 2), (6, 3), (6, 5), (9, 6)])
    for n in (12, 16, 20):
        yield "random", (n, [tuple(map(int, rng.choice(n, 2, replace=False))) for _ in range(2 * n // 3)])


@exercise(chapter=12, cases=_chains, shows=[association.merged], hints=[
    "Pairs chain: if 7 is 4 and 4 is 1, then 7 is 1, whichever pair comes first.",
    "Keep parent[i], at first i. A pair joins the roots of both; the root of i follows parent until it stays."])
def merge_ids(n, pairs):
    """For each of n landmarks the smallest id of the same place, when each pair of ids is one place.

    pairs : tuples (new, old) of ids in [0, n). Returns (n,) integers.
    """
    place = np.arange(n)
    for new, old in pairs:
        a, b = place[new], place[old]
        place[(place == a) | (place == b)] = min(a, b)
    return place


merge_ids.slip("one way only", """The new id points to the old one, and the old one may itself be another place: follow
    the chain to its end.""", ("place[(place == a) | (place == b)] = min(a, b)", "place[new] = old"))
merge_ids.slip("only in the order of the pairs", """The old id's place is looked up when the pair comes, but a later
    pair may merge it further: all that pointed to it must follow.""",
    ("place[(place == a) | (place == b)] = min(a, b)", "place[new] = b"))
merge_ids.slip("largest id", "The place is named by its smallest id, the first that was seen.",
    ("min(a, b)", "max(a, b)"))
merge_ids.slip("both ids changed, others not", """All landmarks that have been joined to either of the two change with
    them, not only these two: replace the place of everyone at place a or b.""",
    ("place[(place == a) | (place == b)] = min(a, b)", "place[new] = place[old] = min(a, b)"))
merge_ids.slip("smaller of the pair's ids", """The ids of a pair may have been joined to smaller ones before: compare
    their places, and change all that are there.""",
    ("place[(place == a) | (place == b)] = min(a, b)", "place[new] = place[old] = min(new, old)"))
merge_ids.slip("place of the old id not followed", """The old id may itself have another place: take place[old], not
    old.""", ("place[(place == a) | (place == b)] = min(a, b)", "place[place == a] = old"))
merge_ids.slip("named by the new id", """The place is named by its smallest id, and both of a pair may have been joined
    to others before.""", ("place[(place == a) | (place == b)] = min(a, b)", "place[place == b] = new"))
merge_ids.slip("only those at the new id", "Those at place[new] move, which need not be new itself any more.",
    ("place[(place == a) | (place == b)] = min(a, b)", "place[place == new] = b"))
merge_ids.slip("places numbered anew", """The place is named by its smallest id; numbers 0, 1, 2, ... without gaps are
    other names.""", ("return place", "return np.unique(place, return_inverse=True)[1]"))
