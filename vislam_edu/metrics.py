"""How good is a trajectory, and does the filter know how good it is?

Accuracy holds an estimate against the truth: `ate`, `kitti_drift`. Consistency holds an error against
the covariance that the filter itself claimed: `nees`, `pose_nees`, `average_nis`, and `chi2_band` for how far
they may stray by chance.

Poses are world_T_body (T, 4, 4), true and estimated of the same body (the IMU or a camera); the two worlds
may differ. Frames whose true pose holds a NaN have no truth and are left out.

>>> from vislam_edu import metrics
>>> [round(limit, 2) for limit in metrics.chi2_band(6, runs=50)]
[4.81, 7.34]
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import kalman, se3
from .belief import Step

if TYPE_CHECKING:
    from .error_state import ErrorState

KITTI_LENGTHS = (100, 200, 300, 400, 500, 600, 700, 800)  # m


def _with_truth(true: np.ndarray, estimated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frames of both trajectories that have truth, or a ValueError that says what does not fit."""
    true, estimated = np.asarray(true, dtype=float), np.asarray(estimated, dtype=float)
    for name, poses in [("true", true), ("estimated", estimated)]:
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise ValueError(f"{name} poses must have shape (T, 4, 4), got {poses.shape}")
    if len(true) != len(estimated):
        raise ValueError(f"{len(true)} true poses but {len(estimated)} estimated ones: give one per frame of "
                         "both, with NaN where there is no truth")
    known = np.isfinite(true).all(axis=(1, 2))
    if not known.any():
        raise ValueError("no frame has a true pose")
    bad = np.flatnonzero(~np.isfinite(estimated[known]).all(axis=(1, 2)))
    if bad.size:
        raise ValueError(f"the estimated pose of frame {np.flatnonzero(known)[bad[0]]} is not finite")
    return true[known], estimated[known]


def align(true: np.ndarray, estimated: np.ndarray) -> np.ndarray:
    """The rigid motion that brings the estimated positions closest to the true ones, least squares, no scale.

    true, estimated : (T, 4, 4). Returns true_T_estimated (4, 4): compare `true` with `true_T_estimated @ estimated`.
    Positions on one straight line leave the turn about that line open; one of the best is returned.
    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991.
    """
    true, estimated = _with_truth(true, estimated)
    p, q = true[:, :3, 3], estimated[:, :3, 3]
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    U, _, Vt = np.linalg.svd((p - p_mean).T @ (q - q_mean))
    mirror = np.sign(np.linalg.det(U) * np.linalg.det(Vt))  # -1 where the best orthogonal matrix is a reflection
    R = U @ np.diag([1, 1, mirror]) @ Vt
    return se3.pose(R, p_mean - R @ q_mean)


def position_errors(true: np.ndarray, estimated: np.ndarray) -> np.ndarray:
    """(T',) m: distance of each estimated position from the true one, in one common world, no alignment.

    true, estimated : (T, 4, 4). T' is the number of frames with truth.
    """
    true, estimated = _with_truth(true, estimated)
    return np.linalg.norm(true[:, :3, 3] - estimated[:, :3, 3], axis=-1)


def ate(true: np.ndarray, estimated: np.ndarray) -> float:
    """Absolute trajectory error: RMS distance, m, between true and estimated positions after `align`.

    true, estimated : (T, 4, 4).
    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012, section IV-B; Zhang,
    Scaramuzza, A tutorial on quantitative trajectory evaluation, IROS 2018 (SE(3) alignment, all frames).
    """
    return float(np.sqrt(np.mean(np.square(position_errors(true, align(true, estimated) @ estimated)))))


def kitti_drift(true: np.ndarray, estimated: np.ndarray, lengths: Sequence[float] = KITTI_LENGTHS,
                every: int = 10) -> tuple[float, float]:
    """KITTI's drift: error of the motion over pieces of road, relative to their length.

    A piece starts at every 10th frame and ends at the first frame that is more than `length` metres further along the
    true path; its error is the last pose as seen from the first. The result is the mean over all pieces of all lengths.

    true, estimated : (T, 4, 4). lengths : m. every : frames between starts.
    Returns (per cent, deg/m), NaN when the drive is no longer than the shortest length: give shorter ones, say
    (10, 20, 50), and name them beside the figure.
    Source: KITTI odometry development kit, evaluate_odometry.cpp (on poses of the left camera); Geiger et al., Are we
    ready for autonomous driving?, CVPR 2012.
    """
    true, estimated = _with_truth(true, estimated)
    travelled = np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0, prepend=true[:1, :3, 3]), axis=-1))
    starts = np.arange(0, len(true), every)
    first, length = np.repeat(starts, len(lengths)), np.tile(np.asarray(lengths, dtype=float), len(starts))
    last = np.searchsorted(travelled, travelled[first] + length, side="right")
    whole = last < len(true)
    if not whole.any():
        return np.nan, np.nan
    first, last, length = first[whole], last[whole], length[whole]
    true_motion = se3.inverse(true[first]) @ true[last]
    error = se3.inverse(true_motion) @ se3.inverse(estimated[first]) @ estimated[last]
    translation = np.linalg.norm(error[:, :3, 3], axis=-1) / length
    rotation = np.linalg.norm(se3.so3_log(error[:, :3, :3]), axis=-1) / length
    return float(100 * translation.mean()), float(np.degrees(rotation.mean()))


def nees(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Normalised estimation error squared, e^T P^-1 e: chi-square with n degrees of freedom if the filter is honest.

    Its mean is then n. Far above n the filter is overconfident, far below it wastes what it measured.

    error : (..., n). covariance : (..., n, n), positive definite. Returns (...).
    Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.2.
    """
    covariance = (covariance + np.swapaxes(covariance, -1, -2)) / 2  # a Cholesky factorisation reads one triangle only
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), np.asarray(error)[..., None])[..., 0]
    return np.sum(whitened**2, axis=-1)


def coverage(error: np.ndarray, covariance: np.ndarray) -> float:
    """Share of the errors that lie inside their 95 % ellipsoid; an honest filter has 0.95.

    error : (N, n). covariance : (N, n, n), positive definite.
    """
    return float(np.mean(nees(error, covariance) < kalman.chi_square_quantile(0.95, np.shape(error)[-1])))


@dataclass(frozen=True, eq=False)
class PoseNees:
    """NEES (...) of the whole pose (6 degrees of freedom), its rotation (3) and its position (3) alone."""

    pose: np.ndarray
    rotation: np.ndarray
    position: np.ndarray


def pose_nees(error_state: ErrorState, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray,
              covariance: np.ndarray) -> PoseNees:
    """NEES of a pose, the error measured in the coordinates in which the filter's covariance is expressed.

    error_state : `ErrorState`; its `pose_difference` is the error, [position, rotation].
    true_world_T_imu, world_T_imu : (..., 4, 4). covariance : (..., 6, 6) of that error. A covariance of one error put
    beside an error of the other kind gives a number that means nothing. NaN where the true pose is NaN.
    """
    error = np.asarray(error_state.pose_difference(true_world_T_imu, world_T_imu))
    covariance = np.asarray(covariance)
    return PoseNees(nees(error, covariance), nees(error[..., 3:], covariance[..., 3:, 3:]),
                    nees(error[..., :3], covariance[..., :3, :3]))


def average_nis(steps: Iterable[Step]) -> float:
    """Mean NIS of one stereo measurement over all steps of a filter; 4 if prediction and pixel noise are honest.

    Gated measurements count too: leaving out the large ones would flatter the filter. A point predicted behind the
    camera has no NIS (it is infinite there) and is left out. NaN when nothing was ever predicted.

    v_left and v_right share one prediction, yet both carry noise of their own, so there are 4 degrees of freedom, not
    3. Measurements of one frame share the error of the pose, so their sum is no chi-square; the mean is right all the
    same.
    Source: Bar-Shalom et al., section 5.4.2.
    """
    return mean_nis(np.concatenate([np.empty(0), *(step.innovation.nis for step in steps)]))


def mean_nis(nis: np.ndarray) -> float:
    """Mean of the finite numbers among nis (N,), see `average_nis`. NaN when none is finite."""
    finite = nis[np.isfinite(nis)]
    return float(finite.mean()) if finite.size else np.nan


def chi2_band(dof: float, runs: int = 1, probability: float = 0.99) -> tuple[float, float]:
    """(low, high): where the mean of `runs` independent chi-square numbers lies with this probability.

    dof : degrees of freedom of one number: 6 for the NEES of a pose, 3 for its rotation or position, 4 for the NIS.
    runs : 1 for the band of a single run at a single frame, N for the mean over N runs at one frame.

    A mean over the frames of a run as well scatters less than the band says, by how much depends on how long
    errors live; the band is then on the safe side for a filter that is honest at every frame.
    Source: Bar-Shalom et al., section 5.4.2: the sum of N such numbers is chi-square with N dof degrees of freedom.
    """
    if not 0 < probability < 1:
        raise ValueError(f"a band holds a probability in (0, 1), got {probability!r}")
    if not runs >= 1:
        raise ValueError(f"runs must be at least 1, got {runs!r}")
    tail = (1 - probability) / 2
    low, high = kalman.chi_square_quantile([tail, 1 - tail], dof * runs) / runs
    return float(low), float(high)
