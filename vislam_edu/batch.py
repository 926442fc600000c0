"""The whole drive at once: the poses and landmarks that fit all measurements best, by least squares.

    solution = batch.solve(batch.Problem(drive, noise))
    solution.estimate.world_T_imu, solution.cost

The report states this objective (section 2.3). A filter passes every measurement once; here each is linearised again
at every iteration. The unknowns are the poses T_k, the landmarks m_j and some constants: the IMU's gyro bias b, the
scale s of its speed and, if asked for, numbers c of the lenses. Each residual is divided by its standard deviation:

    IMU       S xi_k + [0, b] - u_k,   xi_k = log(T_k^-1 T_{k+1})^v / tau_k,   S = diag(s, s, s, 1, 1, 1)
    walk      xi_{k+1} - xi_k          a car cannot change its twist at once (optional)
    prior     log(T_prior^-1 T_0)^v    ties the world down;  b, s - 1 and c
    pixels    h(T_k, m_j) + F_kj c - z_kj    three numbers: u_left, v, u_right

The error of a pose is a right perturbation, T = T_hat exp(epsilon^). Columns are ordered [poses 6T, landmarks 3M,
IMU 4, lenses L].

Sources: report section 2.3; Barfoot, State Estimation for Robotics (batch estimation, bundle adjustment, Schur
complement); Triggs et al., Bundle adjustment: a modern synthesis, 2000 (robust weights, damping, sparsity).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError
from scipy.sparse import bsr_array, csr_array, hstack, vstack
from scipy.sparse.csgraph import reverse_cuthill_mckee

from . import odometry, se3
from .drive import Drive, DriveError
from .noise import Noise
from .normal_equations import Factorised, NormalEquations, block_rows
from .stereo import ROW_VARIANCE, ROWS, reduce_rows

BEHIND = 1e4  # squared residual of a landmark that an iteration has put behind the camera: bad, but finite
DAMPING = 1e-9, 1e8  # least and most of Levenberg-Marquardt's lambda

Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def quadratic(squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plain least squares: cost r^2 and weight 1 of squared residuals r^2 (n,)."""
    return squared, np.ones_like(squared)


def cauchy(squared: np.ndarray, c: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Robust loss: cost c^2 log(1 + r^2 / c^2) and its derivative by r^2, the weight, of squared residuals r^2 (n,).

    c : where the weight has fallen to one half, in standard deviations. Source: Triggs et al., section 3.

    >>> cauchy(np.array([0.0, 4.0, 400.0]))[1].round(3).tolist()
    [1.0, 0.5, 0.01]
    """
    return c**2 * np.log1p(squared / c**2), 1 / (1 + squared / c**2)


@dataclass(frozen=True, eq=False)
class Estimate:
    """One value of all unknowns.

    world_T_imu : (T, 4, 4). landmarks : (M, 3), m, world. imu : (4,), gyro bias in rad/s, scale of the speed.
    lens : (L,), px, the numbers of `Problem.lens`.
    """

    world_T_imu: np.ndarray
    landmarks: np.ndarray
    imu: np.ndarray
    lens: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def retract(self, delta: np.ndarray, anchor: np.ndarray) -> Estimate:
        """The estimate after a step delta (6T + 3M + 4 + L,), the same to first order as T exp(epsilon^) and m + delta.

        Steps are large at first: a heading wrong by 30 degrees turns all that follows, and on straight lines the path
        would tear. So the twist along each step of the path is corrected, the steps are joined anew, and each landmark
        moves with its anchor, (M,), a frame that sees it. The IMU's residual is then linear, however large the step.
        """
        ends = np.cumsum([self.world_T_imu.shape[0] * 6, self.landmarks.size, 4])
        epsilon, landmarks, imu, lens = np.split(delta, ends)
        epsilon = epsilon.reshape(-1, 6)
        twist, by_this, by_next = path_twists(self.world_T_imu, np.ones(len(epsilon) - 1))
        twist = twist + np.matvec(by_this, epsilon[:-1]) + np.matvec(by_next, epsilon[1:])
        poses = se3.chain(self.world_T_imu[0] @ se3.exp(epsilon[0]), se3.exp(twist))

        s = se3.transform(se3.inverse(self.world_T_imu[anchor]), self.landmarks)
        moved = np.vecmat(landmarks.reshape(-1, 3), self.world_T_imu[anchor, :3, :3])
        moved -= np.matvec(se3.odot(s)[:, :3], epsilon[anchor])
        return Estimate(poses, se3.transform(poses[anchor], s + moved), self.imu + imu, self.lens + lens)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be minimised.

    walk_sigma : m/s and rad/s, how much the twist may change from frame to frame, or None for no such residual.
    imu_sigma : (4,), standard deviations of the prior on bias and scale, 0 for a constant that is known.
    loss : `quadratic` or `cauchy`, of the squared residual of one pixel measurement.
    place : (M,), the row of the map that each track of the drive is a view of; by default each has its own.
    prior_world_T_imu : (4, 4), mean of the prior on T_0, whose covariance is `noise.initial_pose_covariance`.
    lens : (N, 4, L), by how many px each observation is off for 1 px of each of L numbers of the lenses.
    lens_sigma : (L,), px, standard deviations of the prior on these numbers, whose mean is 0.

    size : unknowns of a frame; `inertial_batch` adds a velocity and two biases to the six of a pose.
    Raises DriveError for a drive of one frame or without observations, ValueError for an IMU without noise.
    """

    size: ClassVar[int] = 6
    drive: Drive
    noise: Noise
    walk_sigma: tuple[float, float] | None = None
    imu_sigma: np.ndarray = field(default_factory=lambda: np.zeros(4))
    loss: Loss = quadratic
    place: np.ndarray | None = None
    prior_world_T_imu: np.ndarray = field(default_factory=lambda: np.eye(4))
    lens: np.ndarray | None = None
    lens_sigma: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.drive.n_frames < 2 or not len(self.drive.pixels):
            raise DriveError("a batch estimate needs two frames and a landmark in view, not "
                             f"{self.drive.n_frames} frames with {len(self.drive.pixels)} observations")
        if min(self.noise.sigma_v, self.noise.sigma_omega) <= 0:
            raise ValueError("a batch estimate divides each residual by its sigma, so the IMU's must be above 0, not "
                             f"sigma_v {self.noise.sigma_v:g} m/s and sigma_omega {self.noise.sigma_omega:g} rad/s")

    @property
    def dof(self) -> int:
        """Degrees of freedom: residuals less unknowns. Poses, the IMU's samples and constants cancel each other."""
        walk = 0 if self.walk_sigma is None else 6 * (self.drive.n_frames - 2)
        return 3 * (len(self.landmark) - len(np.unique(self.landmark))) + walk

    @cached_property
    def landmark(self) -> np.ndarray:
        """(N,): the row of the map that each observation is a view of."""
        return self.drive.landmark if self.place is None else np.asarray(self.place)[self.drive.landmark]

    @cached_property
    def by_lens(self) -> np.ndarray:
        """(N, 3, L): derivative of each pixel residual by the numbers of the lenses, not yet divided by its sigma."""
        shifts = np.zeros((len(self.landmark), 4, 0)) if self.lens is None else self.lens
        return np.swapaxes(reduce_rows(np.swapaxes(shifts, 1, 2)), 1, 2)

    @cached_property
    def sigma_constants(self) -> np.ndarray:
        """(4 + L,): standard deviations of the priors on the constants of the IMU and the lenses, 0 where known."""
        return np.concatenate([self.imu_sigma, self.lens_sigma])

    @cached_property
    def anchor(self) -> np.ndarray:
        """(M,): the first frame that sees each landmark, 0 where none does."""
        first = np.zeros(self.drive.n_landmarks, dtype=int)
        first[self.landmark[::-1]] = self.drive.frame[::-1]  # of several writes to one row the last one stays
        return first

    def motion_residuals(self, estimate: Estimate) -> tuple[np.ndarray, bsr_array, np.ndarray]:
        """All residuals without a landmark: prior on T_0, IMU, walk. Each is divided by its standard deviation.

        Returns r (n,), its derivative by the poses, sparse (n, 6T), and by the constants of the IMU (n, 4).
        """
        drive, noise, T = self.drive, self.noise, self.drive.n_frames
        xi, by_this, by_next = path_twists(estimate.world_T_imu, drive.taus)

        whiten = np.linalg.inv(np.linalg.cholesky(noise.initial_pose_covariance))
        e0 = se3.log(se3.inverse(self.prior_world_T_imu) @ estimate.world_T_imu[0])
        rows = [(whiten @ e0, block_rows(T, (whiten @ se3.right_jacobian_inverse(e0))[None]), np.zeros((6, 4)))]

        bias, scale = estimate.imu[:3], estimate.imu[3]
        gain = np.repeat([scale, 1.0], 3)
        weight = 1 / np.repeat([noise.sigma_v, noise.sigma_omega], 3)
        by_imu = np.zeros((T - 1, 6, 4))
        by_imu[:, 3:, :3], by_imu[:, :3, 3] = np.eye(3), xi[:, :3]
        scaled = (weight * gain)[:, None]
        rows.append(((weight * (gain * xi + np.pad(bias, (3, 0)) - drive.step_twists)).ravel(),
                     block_rows(T, scaled * by_this, scaled * by_next), (weight[:, None] * by_imu).reshape(-1, 4)))

        if self.walk_sigma is not None:
            weight = 1 / np.repeat(self.walk_sigma, 3)
            w = weight[:, None]
            rows.append(((weight * np.diff(xi, axis=0)).ravel(),
                         block_rows(T, -w * by_this[:-1], w * (by_this[1:] - by_next[:-1]), w * by_next[1:]),
                         np.zeros((6 * (T - 2), 4))))
        r, J, J_imu = zip(*rows)
        return np.concatenate(r), vstack(J, format="bsr"), np.concatenate(J_imu)

    def dead_reckoned(self) -> np.ndarray:
        """(T, 4, 4): the poses that the IMU alone says."""
        return odometry.dead_reckon(self.drive, self.noise, self.prior_world_T_imu).world_T_imu

    def at(self, world_T_imu: np.ndarray) -> Estimate:
        """An estimate with these poses (T, 4, 4), each landmark from its nearest view, the constants as expected."""
        return Estimate(world_T_imu, nearest_views(self, world_T_imu), np.array([0.0, 0.0, 0.0, 1.0]),
                        np.zeros_like(self.lens_sigma))

    def by_frame(self, blocks: np.ndarray) -> bsr_array:
        """Blocks (N, size, 3), one for each observation, as a sparse matrix (size T, 3M) of frames and landmarks."""
        return bsr_array((blocks, self.landmark, self.drive.frame_start),
                         shape=(self.size * self.drive.n_frames, 3 * self.drive.n_landmarks))

    @cached_property
    def rank(self) -> np.ndarray:
        """(T,): when each frame is eliminated. Frames in which one landmark is seen should stand close together.

        As driven, or by Cuthill and McKee where that is better: a car that comes back joins the ends of its drive.
        """
        T, N = self.drive.n_frames, len(self.landmark)
        seen = csr_array((np.ones(N), self.landmark, self.drive.frame_start), shape=(T, self.drive.n_landmarks))
        common = (seen @ seen.T).tocoo()
        orders = np.arange(T), np.argsort(reverse_cuthill_mckee(common.tocsr(), symmetric_mode=True))
        return min(orders, key=lambda rank: np.abs(rank[common.row] - rank[common.col]).max())


def start(problem: Problem, world_T_imu: np.ndarray | None = None) -> Estimate:
    """Where the iterations begin: poses (T, 4, 4), by default dead reckoning, each landmark from its nearest view."""
    return problem.at(problem.dead_reckoned() if world_T_imu is None else np.asarray(world_T_imu))


def nearest_views(problem: Problem, world_T_imu: np.ndarray) -> np.ndarray:
    """(M, 3) m, world: each landmark where its nearest view puts it, given the poses (T, 4, 4)."""
    drive = problem.drive
    points, _ = drive.camera.triangulate(drive.pixels)
    near_last = np.argsort(drive.pixels[:, 0] - drive.pixels[:, 2])
    landmarks = np.zeros((drive.n_landmarks, 3))  # of several writes to one row the last one stays
    landmarks[problem.landmark[near_last]] = drive.camera.to_world(world_T_imu[drive.frame], points)[near_last]
    return landmarks


def in_front_again(problem: Problem, estimate: Estimate) -> Estimate:
    """The estimate with every landmark that lies behind one of its cameras begun anew: it has no derivative there."""
    drive = problem.drive
    points = drive.camera.to_cam(estimate.world_T_imu[drive.frame], estimate.landmarks[problem.landmark])
    lost = np.isin(np.arange(drive.n_landmarks), problem.landmark[points[:, 2] <= 0])
    if not lost.any():
        return estimate
    anew = nearest_views(problem, estimate.world_T_imu)
    return replace(estimate, landmarks=np.where(lost[:, None], anew, estimate.landmarks))


def path_twists(world_T_imu: np.ndarray, taus: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The twist along each step of a path, xi_k = log(T_k^-1 T_{k+1})^v / tau_k, and its derivatives.

    world_T_imu : (T, 4, 4). taus : (T-1,), s. Returns xi (T-1, 6), and by the right perturbation of T_k and of T_{k+1}
    (T-1, 6, 6): -J_l^-1(tau xi) / tau and J_r^-1(tau xi) / tau.
    """
    step = se3.log(se3.inverse(world_T_imu[:-1]) @ world_T_imu[1:])
    tau = taus[:, None, None]
    return (step / taus[:, None], -se3.left_jacobian_inverse(step) / tau, se3.right_jacobian_inverse(step) / tau)


def pixel_residuals(problem: Problem, estimate: Estimate) -> tuple[np.ndarray, ...]:
    """Predicted minus measured pixels, [u_left, v, u_right], divided by their standard deviations.

    Returns r (N, 3), derivatives by the pose (N, 3, 6) and the landmark (N, 3, 3) of each observation and by the lenses
    (N, 3, L), and in_front (N,). Where a landmark is not in front of the camera the others are zero.
    """
    drive = problem.drive
    poses, landmarks = estimate.world_T_imu[drive.frame], estimate.landmarks[problem.landmark]
    points = drive.camera.to_cam(poses, landmarks)
    predicted, in_front = drive.camera.project(points)
    weight = in_front[:, None] / (problem.noise.sigma_px * np.sqrt(ROW_VARIANCE))
    J = weight[..., None] * drive.camera.measurement_jacobian(points)[:, ROWS]
    s = se3.transform(se3.inverse(poses), landmarks)
    by_pose = np.concatenate([-J, J @ se3.so3_hat(s)], axis=-1)
    by_landmark = J @ np.swapaxes(poses[:, :3, :3], -1, -2)
    r = reduce_rows(predicted - drive.pixels) + problem.by_lens @ estimate.lens
    return weight * r, by_pose, by_landmark, weight[..., None] * problem.by_lens, in_front


@dataclass(frozen=True, eq=False)
class Linearised:
    """All residuals at one estimate and their derivatives; those of the pixels times the root of their robust weight.

    cost : what is minimised. r, J, J_imu : see `Problem.motion_residuals`, the prior on the constants left out.
    r_px, J_pose, J_landmark, J_lens : see `pixel_residuals`. r_constants : (4 + L,), constants of the IMU and the
    lenses minus their prior mean, not divided.
    """

    problem: Problem
    cost: float
    r: np.ndarray
    J: bsr_array
    J_imu: np.ndarray
    r_px: np.ndarray
    J_pose: np.ndarray
    J_landmark: np.ndarray
    J_lens: np.ndarray
    r_constants: np.ndarray

    def whole(self) -> tuple[np.ndarray, csr_array]:
        """Residuals (n,) and their whole sparse Jacobian (n, size T + 3M), constants taken as known: to look at."""
        problem, N = self.problem, len(self.r_px)
        drive, rows = problem.drive, np.arange(N + 1)
        by_pose = bsr_array((self.J_pose, drive.frame, rows), shape=(3 * N, problem.size * drive.n_frames))
        by_landmark = bsr_array((self.J_landmark, problem.landmark, rows), shape=(3 * N, 3 * drive.n_landmarks))
        nothing = csr_array((len(self.r), 3 * drive.n_landmarks))
        return (np.concatenate([self.r, self.r_px.ravel()]),
                vstack([hstack([self.J, nothing]), hstack([by_pose, by_landmark])], format="csr"))


def linearise(problem: Problem, estimate: Estimate) -> Linearised:
    """The problem at an estimate: cost, residuals, derivatives."""
    r, J, J_imu = problem.motion_residuals(estimate)
    r_px, J_pose, J_landmark, J_lens, in_front = pixel_residuals(problem, estimate)
    J_pose = np.pad(J_pose, ((0, 0), (0, 0), (0, problem.size - 6)))
    cost_px, weight = problem.loss(np.where(in_front, np.sum(r_px**2, axis=-1), BEHIND))
    root = np.sqrt(weight)[:, None, None]
    r_constants = np.concatenate([estimate.imu - [0, 0, 0, 1], estimate.lens])
    free = problem.sigma_constants > 0
    cost = r @ r + cost_px.sum() + np.sum((r_constants[free] / problem.sigma_constants[free])**2)
    return Linearised(problem, float(cost), r, J, J_imu, root[..., 0] * r_px, root * J_pose, root * J_landmark,
                      root * J_lens, r_constants)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One accepted step. estimate : after it. cost : there. damping : lambda of the step. tried : lambdas it took.

    converged : whether no other step is needed.
    """

    estimate: Estimate
    cost: float
    damping: float
    tried: int
    converged: bool = False


def iterate(problem: Problem, estimate: Estimate | None = None, damping: float = 1e-4,
            tolerance: float = 1e-2, still: float = 0.0, most: int = 100) -> Iterator[Iteration]:
    """Levenberg-Marquardt: yields the start, then every step that lowered the cost.

    A step that raises the cost, or a matrix that is not positive definite, makes lambda ten times larger and is tried
    again; a good step makes it ten times smaller. Ends when a step lowers the cost by less than `tolerance`: the cost
    is a chi-square, so 1 is what an error of one standard deviation costs, whatever the number of measurements. With a
    robust loss the cost falls on and on while far outliers settle: then also when an undamped step moves no position
    by more than `still`, m.
    Source: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, 1963.
    """
    estimate = start(problem) if estimate is None else estimate
    at = linearise(problem, estimate)
    yield Iteration(estimate, at.cost, damping, 0)
    for _ in range(most):
        normal, tried, before = NormalEquations(at), 0, at.cost
        while damping < DAMPING[1]:
            tried += 1
            try:
                step = Factorised(normal, damping).solve(normal.g[:, None])[:, 0]
            except LinAlgError:
                damping *= 10
                continue
            moved = in_front_again(problem, estimate.retract(normal.with_known(step), problem.anchor))
            at = linearise(problem, moved)
            if at.cost <= before:
                break
            damping *= 10
        else:
            return
        way = np.linalg.norm((moved.world_T_imu - estimate.world_T_imu)[:, :3, 3], axis=1).max()
        converged = before - at.cost < tolerance or bool(way < still and tried == 1)
        estimate = moved
        yield Iteration(estimate, at.cost, damping, tried, converged)
        if converged:
            return
        damping = max(damping / 10, DAMPING[0])


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iterations end. iterations : how many steps were taken. converged : whether they had come to rest."""

    problem: Problem
    estimate: Estimate
    cost: float
    iterations: int
    converged: bool = False

    @property
    def cost_per_dof(self) -> float:
        """1 at the right minimum with plain squares, and less with a robust loss, if the noise is as assumed."""
        return self.cost / max(self.problem.dof, 1)

    @cached_property
    def _factorised(self) -> Factorised:
        return Factorised(NormalEquations(linearise(self.problem, self.estimate)))

    def pose_covariance(self, frames: ArrayLike) -> np.ndarray:
        """(n, 6, 6): marginal covariance of the right perturbation of each of the frames (n,)."""
        return self.frame_covariance(frames)[:, :6, :6]

    def frame_covariance(self, frames: ArrayLike) -> np.ndarray:
        """(n, size, size): marginal covariance of all unknowns of each of the frames (n,)."""
        size = self.problem.size
        return self._covariance(size * np.asarray(frames)[:, None] + np.arange(size))

    def landmark_covariance(self, landmarks: np.ndarray) -> np.ndarray:
        """(n, 3, 3), m^2, world: marginal covariance of each of the landmarks (n,)."""
        first = self.problem.size * self.problem.drive.n_frames
        return self._covariance(first + 3 * np.asarray(landmarks)[:, None] + np.arange(3))

    def lens_covariance(self) -> np.ndarray:
        """(L, L), px^2: marginal covariance of the numbers of the lenses, all of which must be unknown."""
        return self._factorised.D_inverse[-len(self.estimate.lens):, -len(self.estimate.lens):]

    def _covariance(self, rows: np.ndarray) -> np.ndarray:
        """Blocks of H^-1, (n, d, d): the columns asked for are solved for, the others never formed. rows : (n, d)."""
        unit = np.zeros((self.problem.size * self.problem.drive.n_frames + 3 * self.problem.drive.n_landmarks
                         + np.count_nonzero(self.problem.sigma_constants), rows.size))
        unit[rows.ravel(), np.arange(rows.size)] = 1
        columns = self._factorised.solve(unit)
        n, d = rows.shape
        return columns[rows.ravel()].reshape(n, d, n, d)[np.arange(n), :, np.arange(n)]


def solve(problem: Problem, estimate: Estimate | None = None, tolerance: float = 1e-2, still: float = 0.0) -> Solution:
    """The estimate of the least cost. estimate, tolerance, still : see `iterate`."""
    for n, last in enumerate(iterate(problem, estimate, tolerance=tolerance, still=still)):  # noqa: B007
        pass
    return Solution(problem, last.estimate, last.cost, n, last.converged)
