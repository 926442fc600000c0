"""A fixed-lag smoother: least squares over the last few frames, and a Gaussian for all that came before.

The oldest frame leaves the window together with the landmarks that no later frame sees. What they say about those that
stay is a Schur complement, the marginalisation prior. It stays linearised where it was made. Landmarks are points: they
should be near enough for one frame to show how far.

Source: Leutenegger et al., Keyframe-based visual-inertial odometry using nonlinear optimization, 2015; Usenko et al.,
Visual-inertial mapping with non-linear factor recovery, 2020, section III.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ... import batch, imu, se3
from ...drive import Drive
from ...imu import State
from ...inertial_batch import FROM_IMU, Estimate, Problem
from ...noise import Noise

ITERATIONS = 3


@dataclass(frozen=True, eq=False)
class Prior:
    """What left the window, as a Gaussian over its first frame and m of its landmarks.

    With d their `difference` from `at` the cost is d^T information d - 2 d^T vector.
    ids : (m,). at : an `Estimate` of one frame and m landmarks. information : (15 + 3m, 15 + 3m). vector : (15 + 3m,).
    """

    ids: np.ndarray
    at: Estimate
    information: np.ndarray
    vector: np.ndarray


def difference(estimate: Estimate, at: Estimate) -> np.ndarray:
    """(15 + 3m,): an estimate of one frame and m landmarks minus another."""
    pose = se3.log(se3.inverse(at.world_T_imu[0]) @ estimate.world_T_imu[0])
    return np.concatenate([pose, (estimate.motion - at.motion)[0], (estimate.landmarks - at.landmarks).ravel()])


def error(estimate: Estimate, true: State) -> np.ndarray:
    """(15,): what the covariance of `run` speaks of, [pose as a right perturbation, velocity, biases]."""
    return difference(estimate_of(*_frame(true), np.empty((0, 3))), estimate)


def estimate_of(poses: np.ndarray, motion: np.ndarray, landmarks: np.ndarray) -> Estimate:
    """An `Estimate` without constants."""
    return Estimate(poses, landmarks, np.array([0.0, 0.0, 0.0, 1.0]), motion=motion)


def run(drive: Drive, noise: Noise, begin: tuple[State, np.ndarray], lag: int = 5,
        freeze: bool = True) -> Iterator[tuple[Estimate, np.ndarray]]:
    """From frame 1 on: the newest frame as an `Estimate`, and the covariance (15, 15) of its error.

    begin : `imu.State` at frame 0 and its covariance (15, 15). lag : frames in the window. freeze : whether all that
    the prior speaks of keeps, in every derivative, the value that it had when the prior was made (first-estimates
    Jacobians); otherwise it is linearised at each new estimate.
    """
    state, P = begin
    turn, none = np.eye(15), np.empty(0, dtype=int)
    turn[:3, :3] = state.rotation  # an error of the position is one of the body's here, of the world's there
    now = estimate_of(*_frame(state), np.empty((0, 3)))
    prior = Prior(none, now, turn.T @ np.linalg.inv(P[np.ix_(FROM_IMU, FROM_IMU)]) @ turn, np.zeros(15))
    ids, first = none, 0
    for k in range(1, drive.n_frames):
        problem = Problem(drive.slice(first, k + 1), noise, begin=(now.states[0], np.eye(15)))
        n, end = problem.drive.n_frames, imu.predict(now.states[-1], problem.motions[-1])
        poses, motion = map(np.concatenate, zip((now.world_T_imu, now.motion), _frame(end)))
        landmarks, old = batch.nearest_views(problem, poses), ids
        ids = np.unique(drive.landmark[drive.frame_start[first]:drive.frame_start[k + 1]])
        landmarks[np.searchsorted(ids, old)] = now.landmarks
        now = estimate_of(poses, motion, landmarks)
        for _ in range(ITERATIONS):
            H, g = _normal(problem, now, ids, prior, freeze)
            now = now.retract(np.append(np.linalg.solve(H, g), np.zeros(4)), none)
        yield (estimate_of(now.world_T_imu[-1:], now.motion[-1:], np.empty((0, 3))),
               np.linalg.inv(H)[15 * n - 15:15 * n, 15 * n - 15:15 * n])
        if n == lag:
            prior = marginalise(problem, now, ids, prior, freeze)
            later = problem.drive.last_seen > 0
            now, ids = estimate_of(now.world_T_imu[1:], now.motion[1:], now.landmarks[later]), ids[later]
            first += 1


def marginalise(problem: Problem, now: Estimate, ids: np.ndarray, prior: Prior, freeze: bool) -> Prior:
    """The next prior: frame 0 and the landmarks that only it sees leave the window, by the Schur complement."""
    drive, n, old = problem.drive, problem.drive.n_frames, np.searchsorted(ids, prior.ids)
    seen = drive.frame_start[1]  # the observations of frame 0, the first ones
    H, g = _normal(problem, now, ids, prior, freeze, np.r_[:15, 15 * (n - 1):15 * (n - 1) + 3 * seen])
    touched = np.union1d(old, drive.landmark[:seen])
    stay = touched[drive.last_seen[touched] > 0]
    gone, kept = _columns(n, 0, np.setdiff1d(touched, stay)), _columns(n, 1, stay)
    G = np.linalg.solve(H[np.ix_(gone, gone)], H[np.ix_(gone, kept)])
    information, vector = H[np.ix_(kept, kept)] - H[np.ix_(kept, gone)] @ G, g[kept] - G.T @ g[gone]
    here = at = estimate_of(now.world_T_imu[1:2], now.motion[1:2], now.landmarks[stay])
    if freeze:  # what the last prior spoke of keeps its value
        landmarks = here.landmarks.copy()
        landmarks[np.isin(stay, old)] = prior.at.landmarks[np.isin(old, stay)]
        at = estimate_of(here.world_T_imu, here.motion, landmarks)
    return Prior(ids[stay], at, information, vector + information @ difference(here, at))


def _normal(problem: Problem, now: Estimate, ids: np.ndarray, prior: Prior, freeze: bool,
            rows: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """H and g of the step H delta = g: some rows (by default all) of the window's residuals, and the prior."""
    old, at = np.searchsorted(ids, prior.ids), now
    if freeze:
        landmarks = now.landmarks.copy()
        landmarks[old] = prior.at.landmarks
        at = estimate_of(np.concatenate([prior.at.world_T_imu, now.world_T_imu[1:]]),
                         np.concatenate([prior.at.motion, now.motion[1:]]), landmarks)
    r = batch.linearise(problem, now).whole()[0][15:][rows]  # the first 15 are a prior of the problem, not used here
    J = batch.linearise(problem, at).whole()[1][15:].toarray()[rows]
    H, g = J.T @ J, -J.T @ r
    of_prior = _columns(problem.drive.n_frames, 0, old)
    apart = difference(estimate_of(now.world_T_imu[:1], now.motion[:1], now.landmarks[old]), prior.at)
    H[np.ix_(of_prior, of_prior)] += prior.information
    g[of_prior] += prior.vector - prior.information @ apart
    return H, g


def _columns(n: int, frame: int, landmarks: np.ndarray) -> np.ndarray:
    """Where a frame of n and these landmarks stand in [frames 15n, landmarks 3m]."""
    return np.concatenate([15 * frame + np.arange(15), (15 * n + 3 * landmarks[:, None] + np.arange(3)).ravel()])


def _frame(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Pose (1, 4, 4) and motion (1, 9) of a state of `imu`."""
    return (se3.pose(state.rotation, state.position)[None],
            np.concatenate([state.velocity, state.gyro_bias, state.accelerometer_bias])[None])
