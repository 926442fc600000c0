"""One record of a run: what a filter said, frame by frame, as far as it came.

    run = record(window_slam.run(drive, noise))
    run.world_T_imu, run.covariance, run.mean_nis

A thousand `Step`s of the joint filter hold two covariances each, about a gigabyte. A `Run` keeps a few numbers of each.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .. import metrics
from ..belief import NO_INNOVATION, Step
from ..error_state import ErrorState, RightPerturbation, to_right


@dataclass(frozen=True, eq=False)
class Run:
    """A joint filter over K frames, in which it predicted N measurements.

    error_state : the filter's, in which its covariances are expressed. world_T_imu : (K, 4, 4), after each update.
    covariance : (K, 6, 6) of these poses. frame : (N,), of each measurement. ids : (N,), its landmark.
    residual : (N, 4) px. nis : (N,), infinite for a point behind the camera. accepted : (N,) bool, by the gate.
    problem : what stopped the filter after frame K - 1, None if nothing did.
    """

    error_state: ErrorState
    world_T_imu: np.ndarray
    covariance: np.ndarray
    frame: np.ndarray
    ids: np.ndarray
    residual: np.ndarray
    nis: np.ndarray
    accepted: np.ndarray
    problem: Exception | None = None

    @property
    def stopped(self) -> int | None:
        """The frame at which it could not go on, None if it came to the end."""
        return None if self.problem is None else len(self.world_T_imu)

    @property
    def right_covariance(self) -> np.ndarray:
        """(K, 6, 6): the covariance of each pose as a right perturbation."""
        to = np.reshape([to_right(self.error_state, T) for T in self.world_T_imu], (-1, 6, 6))
        return to @ self.covariance @ to.swapaxes(1, 2)

    @property
    def mean_nis(self) -> float:
        """Of one stereo measurement, see `metrics.average_nis`."""
        return metrics.mean_nis(self.nis)

    @property
    def frame_nis(self) -> np.ndarray:
        """(K,): mean NIS of the measurements of each frame, NaN where it predicted none."""
        by_frame = [self.nis[self.frame == k] for k in range(len(self.world_T_imu))]
        return np.array([metrics.mean_nis(values) for values in by_frame])

    @property
    def used(self) -> float:
        """Share of the measurements that the gate let pass, NaN where there were none."""
        return float(self.accepted.mean()) if self.accepted.size else np.nan

    def errors(self, true_world_T_imu: np.ndarray) -> np.ndarray:
        """(K,) m: distance of each position from the true one. true_world_T_imu : (at least K, 4, 4)."""
        return metrics.position_errors(true_world_T_imu[:len(self.world_T_imu)], self.world_T_imu)

    def nees(self, true_world_T_imu: np.ndarray) -> np.ndarray:
        """(K,): NEES of each pose, infinite where its covariance is not positive definite."""
        truth = true_world_T_imu[:len(self.world_T_imu)]
        error = self.error_state.pose_difference(truth, self.world_T_imu)
        return np.array([_nees(*one) for one in zip(error, self.covariance)])


def _nees(error, covariance) -> float:
    try:
        return float(metrics.nees(error, covariance))
    except np.linalg.LinAlgError:
        return np.inf


def record(steps: Iterable[Step], error_state: ErrorState | None = None) -> Run:
    """Step a joint filter to its end; what it raises is passed on.

    steps : as `window_slam.run` yields them. error_state : the filter's, `RightPerturbation()` by default.
    """
    run = attempt(steps, error_state)
    if run.problem is not None:
        raise run.problem
    return run


def attempt(steps: Iterable[Step], error_state: ErrorState | None = None) -> Run:
    """Step a joint filter as far as it comes; arguments as in `record`.

    It stops where a pose is not finite, or where the filter raises LinAlgError (a matrix that is not positive definite)
    or ValueError.
    """
    kept: list[tuple] = []
    problem = None
    try:
        for step in steps:
            if not np.isfinite(step.posterior.world_T_imu).all():
                raise np.linalg.LinAlgError("a pose is not a finite number")
            seen = step.innovation
            kept.append((step.posterior.world_T_imu, step.posterior.pose_covariance.copy(), seen.ids, seen.residual,
                         seen.nis, seen.accepted))  # a view would keep the covariance of the whole window
    except (np.linalg.LinAlgError, ValueError) as error:
        problem = error
    poses, covariances, ids, residuals, nis, accepted = zip(*kept) if kept else [()] * 6
    empty = NO_INNOVATION
    return Run(
        error_state or RightPerturbation(), np.reshape(poses, (-1, 4, 4)), np.reshape(covariances, (-1, 6, 6)),
        np.repeat(np.arange(len(kept)), [len(each) for each in ids]), np.concatenate([empty.ids, *ids]),
        np.concatenate([empty.residual, *residuals]), np.concatenate([empty.nis, *nis]),
        np.concatenate([empty.accepted, *accepted]), problem,
    )


def truth_beside(drive, world_T_imu):
    """The true poses (T, 4, 4) in the world of the estimated ones (T, 4, 4), NaN where unknown; None if all are."""
    if not drive.has_truth:
        return None
    truth = drive.true_world_T_imu
    if drive.imu is not None:
        return truth  # `run_pipeline` has put it into the world of the estimate
    first = np.flatnonzero(np.isfinite(truth[:, 0, 0]))[0]
    return world_T_imu[first] @ truth if first else truth  # one that starts late is in the frame of its own first pose


def against_truth(true, world_T_imu, covariance) -> tuple[float, float]:
    """Mean NEES of the pose, and the share of the frames in which its error is inside 3 sigma on its worst axis.

    true, world_T_imu : (n, 4, 4), NaN where there is no truth. covariance : (n, 6, 6) of right perturbations.
    """
    known = np.isfinite(true[:, 0, 0])
    error, P = RightPerturbation().pose_difference(true[known], world_T_imu[known]), covariance[known]
    inside = np.abs(error) <= 3 * np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    return float(metrics.nees(error, P).mean()), float(inside.mean(axis=0).min())
