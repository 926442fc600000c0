"""An IMU held against the motion that the cameras saw: when it measured, how it is mounted, how wrong it is.

The cameras' twist `[v, w]` of each step (`visual_odometry`) is turned into what the IMU should have measured,

    gyro   c_w R w + b               R = imu_R_cam, b gyro bias, c_w gyro scale
    speed  c_v (R v + p x R w)       p position of the left camera in the IMU frame (lever arm), c_v speed scale

and the difference is fitted by least squares. `p x R w` is the Adjoint's off-diagonal block: what a camera away from the
IMU sees of a turn. Source: Barfoot, State Estimation for Robotics, section 7.1.4 (the Adjoint); Markley, Attitude
determination using vector observations and the singular value decomposition, 1988 (the start).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from . import se3

ROTATION, LEVER_ARM, GYRO_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
SPEED_SCALE, GYRO_SCALE = slice(9, 10), slice(10, 11)
N_PARAMETERS = 11
_ITERATIONS = 12
_MIN_STEPS = 30
CUT = 4.0  # standard deviations: what lies beyond is a failure of tracker or IMU, not noise


class TooFewSteps(ValueError):
    """The cameras' motion is known in too few steps to judge the IMU by it."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """What fits the IMU to the cameras best.

    imu_R_cam (3, 3) · camera_in_imu (3,) m · gyro_bias (3,) rad/s · speed_scale, gyro_scale : IMU over cameras ·
    covariance (11, 11) of [rotation vector rad (in the IMU frame), camera_in_imu, gyro_bias, speed_scale, gyro_scale] ·
    steps (n,) the steps used · measured, predicted (n, 6) IMU twists and what the cameras make of them ·
    residual_sigma (6,) standard deviation of the difference · camera_sigma (6,) the part of it that is the cameras'.
    """

    imu_R_cam: np.ndarray
    camera_in_imu: np.ndarray
    gyro_bias: np.ndarray
    speed_scale: float
    gyro_scale: float
    covariance: np.ndarray
    steps: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    residual_sigma: np.ndarray
    camera_sigma: np.ndarray

    @cached_property
    def imu_sigma(self) -> np.ndarray:
        """(6,) noise of the IMU twist that drives a step, m/s and rad/s: the residual's less the cameras' own."""
        return np.sqrt(np.maximum(self.residual_sigma**2 - self.camera_sigma**2, 0))

    @cached_property
    def correlation(self) -> np.ndarray:
        """(6,) correlation of each IMU axis with what the cameras say of it."""
        return correlation(self.measured, self.predicted)

    def sigma(self, block) -> np.ndarray:
        """Standard deviations of one block of parameters."""
        return np.sqrt(np.diagonal(self.covariance)[block])

    def p_value(self, block, deviation) -> float:
        """Probability of a deviation (k,) at least that far from zero if the true one were zero (Wald's test)."""
        deviation = np.atleast_1d(deviation)
        wald = deviation @ np.linalg.solve(self.covariance[block, block], deviation)
        return float(chi2.sf(wald, len(deviation)))


def correlation(a, b):
    """Correlation of the columns of a and b (n, k), (k,); zero where a column is constant."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return (a * b).sum(axis=0) / np.where(scale > 0, scale, 1)


def usable_steps(motions):
    """(T-1,) bool: the cameras' motion is known far better than a step of driving is long."""
    sigma = np.sqrt(np.diagonal(motions.twist_covariance, axis1=1, axis2=2))
    return motions.ok & (sigma[:, :3].max(axis=1) < 1.0) & (sigma[:, 3:].max(axis=1) < 0.03)


def _enough_steps(motions):
    steps = np.flatnonzero(usable_steps(motions))
    if len(steps) < _MIN_STEPS:
        raise TooFewSteps(f"the cameras' motion is known in {len(steps)} steps only, {_MIN_STEPS} are needed")
    return steps


def align(drive, motions) -> Alignment:
    """Fit mounting, bias and scales of the IMU to the cameras' motions, by Gauss-Newton from a closed-form start.

    drive : its `step_twists` are taken as they are, its extrinsics are not used. motions : its `FrameMotions`.
    Each of the six axes is weighed by its own residual; what lies beyond four standard deviations is left out.
    Raises TooFewSteps (a ValueError) when fewer than 30 steps are usable.
    """
    steps = _enough_steps(motions)
    measured, seen = drive.step_twists[steps], motions.twists[steps]
    R, p, b, scales = _start(measured, seen), np.zeros(3), np.zeros(3), np.ones(2)
    for _ in range(_ITERATIONS):
        predicted, jacobian = _model(seen, R, p, b, scales)
        residual = measured - predicted
        sigma, inlier = _spread(residual)
        weight = inlier / sigma**2
        information = np.einsum("kai,ka,kaj->ij", jacobian, weight, jacobian)
        information += np.diag(np.r_[np.zeros(3), np.full(3, 1e-4), np.zeros(5)]) + 1e-9 * np.eye(N_PARAMETERS)
        gradient = np.einsum("kai,ka->i", jacobian, weight * residual)
        gradient[LEVER_ARM] -= 1e-4 * p  # a lever arm nothing tells of (no turns) stays near zero: prior of 100 m
        delta = np.linalg.solve(information, gradient)
        R = se3.so3_exp(delta[ROTATION]) @ R
        p, b, scales = p + delta[LEVER_ARM], b + delta[GYRO_BIAS], scales + delta[9:]
    predicted, _ = _model(seen, R, p, b, scales)
    sigma, _ = _spread(measured - predicted)
    imu_T_cam = se3.pose(R, p)
    Ad = se3.Adjoint(imu_T_cam)
    cameras = Ad @ motions.twist_covariance[steps] @ Ad.T
    return Alignment(
        imu_R_cam=R, camera_in_imu=p, gyro_bias=b, speed_scale=float(scales[0]), gyro_scale=float(scales[1]),
        covariance=np.linalg.inv(information), steps=steps, measured=measured, predicted=predicted,
        residual_sigma=sigma, camera_sigma=np.sqrt(np.diagonal(cameras, axis1=1, axis2=2).mean(axis=0)),
    )  # fmt: skip


def _start(measured, seen):
    """Rotation that carries the cameras' velocities and (centred) rates closest to the IMU's, by SVD."""
    rates, turns = (w[:, 3:] - np.median(w[:, 3:], axis=0) for w in (measured, seen))
    speeds, moves = measured[:, :3], seen[:, :3]
    # Each kind of vector weighs by its own size: m/s and rad/s cannot be compared
    B = speeds.T @ moves / max(np.linalg.norm(speeds) * np.linalg.norm(moves), 1e-12)
    B += rates.T @ turns / max(np.linalg.norm(rates) * np.linalg.norm(turns), 1e-12)
    U, _, Vt = np.linalg.svd(B)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


def _model(seen, R, p, b, scales):
    """IMU twists (n, 6) the cameras expect, and the Jacobian (n, 6, 11) by the parameters."""
    v, w = np.matvec(R, seen[:, :3]), np.matvec(R, seen[:, 3:])
    lever = np.cross(p, w)
    predicted = np.concatenate([scales[0] * (v + lever), scales[1] * w + b], axis=-1)
    J = np.zeros((len(seen), 6, N_PARAMETERS))
    J[:, :3, ROTATION] = -scales[0] * (se3.so3_hat(v) + se3.so3_hat(p) @ se3.so3_hat(w))
    J[:, 3:, ROTATION] = -scales[1] * se3.so3_hat(w)
    J[:, :3, LEVER_ARM] = -scales[0] * se3.so3_hat(w)
    J[:, 3:, GYRO_BIAS] = np.eye(3)
    J[:, :3, 9] = v + lever
    J[:, 3:, 10] = w
    return predicted, J


def _spread(residual):
    """Standard deviation (6,) of the residuals and which of them (n, 6) lie within four of them."""
    sigma = np.maximum(np.median(np.abs(residual), axis=0) / 0.6745, 1e-9)
    for _ in range(5):
        inlier = np.abs(residual) < CUT * sigma
        sigma = np.maximum(np.sqrt((residual**2 * inlier).sum(axis=0) / np.maximum(inlier.sum(axis=0), 1)), 1e-9)
    return sigma, inlier


# --- when the IMU measured --------------------------------------------------------------------------------------------

OFFSETS = np.arange(-4.0, 4.25, 0.5)


def likelihood_of_offsets(drive, motions):
    """How well IMU sample k fits the cameras' motion over step k + s, for offsets s in `OFFSETS`: log likelihoods.

    s = 0 is the reading "k" (the sample drives the step that follows it), s = -1 is "k+1", s = -0.5 is "mean"; half
    numbers average two steps of the cameras, which are smooth and nearly free of noise, never two IMU samples: averaging
    those would halve their noise and win for that reason alone. Mounting, bias and scale are not needed: each axis is
    regressed freely on the cameras' six and a constant.
    Returns (len(OFFSETS),); only differences mean something. Raises TooFewSteps as `align` does.
    """
    steps = _enough_steps(motions)
    seen = motions.twists[steps]
    samples = np.arange(4, drive.n_frames - 5)
    near = np.abs(samples - steps[np.searchsorted(steps, samples).clip(0, len(steps) - 1)]) <= 4
    samples = samples[near]
    measured = drive.twists[samples]
    log_likelihood = []
    for offset in OFFSETS:
        at = samples + offset  # single gaps are bridged, as between the steps
        regressors = np.stack([np.interp(at, steps, axis) for axis in seen.T], axis=-1)
        design = np.column_stack([regressors, np.ones(len(samples))])
        fit, *_ = np.linalg.lstsq(design, measured, rcond=None)
        sigma, _ = _spread(measured - design @ fit)
        log_likelihood.append(-len(samples) * np.log(sigma).sum())
    return np.array(log_likelihood)
