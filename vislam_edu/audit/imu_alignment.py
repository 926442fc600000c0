"""An IMU held against the motion that the cameras saw: how it is mounted, how wrong it is.

The cameras' twist `[v, w]` of each step (`visual_odometry`) is turned into what the IMU should measure,

    gyro   c_w R w + b               R = imu_R_cam, b gyro bias, c_w gyro scale
    speed  c_v (R v + p x R w)       p position of the left camera in the IMU frame (lever arm), c_v speed scale

and the difference is fitted by least squares. `p x R w` is the Adjoint's off-diagonal block: what a camera away
from the IMU sees of a turn.

Source: Barfoot, State Estimation for Robotics, section 7.1.4 (the Adjoint); Markley, Attitude determination
using vector observations and the singular value decomposition, 1988 (the start).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from .. import se3

ROTATION, LEVER_ARM, GYRO_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
SPEED_SCALE, GYRO_SCALE, N_PARAMETERS = slice(9, 10), slice(10, 11), 11
_ITERATIONS = 12
_MIN_STEPS = 30
_MIN_TURNING = 3.0  # variance of the rates that the cameras see, over that of their noise alone
_LEAST_NOISE = 1e-6  # m/s and rad/s: no sensor is perfect, and a zero has no logarithm
# What nothing tells of (no turns, no speed) stays near zero, or one; 100 m and a scale of 100 do not pull on the rest
_PRIOR = np.diag([1e-9] * 3 + [1e-4] * 3 + [1e-9] * 3 + [1e-4] * 2)
CUT = 4.0  # standard deviations: what lies beyond is a failure of tracker or IMU, not noise


class TooFewSteps(ValueError):
    """The cameras' motion is known in too few steps, or has too few turns, to judge the IMU by it."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """What fits the IMU to the cameras best.

    imu_R_cam (3, 3) · camera_in_imu (3,) m · gyro_bias (3,) rad/s · speed_scale, gyro_scale : IMU over cameras ·
    covariance (11, 11) of [rotation vector rad (in the IMU frame), camera_in_imu, gyro_bias, speed_scale, gyro_scale] ·
    steps (n,) the steps used · measured, predicted (n, 6) IMU twists and what the cameras make of them ·
    seen, seen_covariance (n, 6), (n, 6, 6) the cameras' twists in their own frame ·
    imu_sigma (6,) noise of the IMU twist that drives a step, m/s and rad/s · camera_variance (n, 6) that of the
    cameras' prediction.
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
    seen: np.ndarray
    seen_covariance: np.ndarray
    imu_sigma: np.ndarray
    camera_variance: np.ndarray

    @cached_property
    def variance(self) -> np.ndarray:
        """(n, 6) of the difference between measured and predicted."""
        return self.imu_sigma**2 + self.camera_variance

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
        return float(chdtrc(len(deviation), deviation @ np.linalg.solve(self.covariance[block, block], deviation)))


def correlation(a, b):
    """Correlation of the columns of a and b (n, k), (k,); zero where a column is constant."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return (a * b).sum(axis=0) / np.where(scale > 0, scale, 1)


def correlation_by_extrinsics(drive, motions):
    """(6,) correlation of each IMU axis with the cameras' motion seen through the extrinsics that the drive has."""
    steps = np.flatnonzero(usable_steps(motions))
    expected = np.matvec(se3.adjoint(drive.camera.imu_T_cam), motions.twists[steps])
    return correlation(drive.step_twists[steps], expected)


def usable_steps(motions):
    """(T-1,) bool: the cameras' motion is known far better than a step of driving is long."""
    sigma = np.sqrt(np.diagonal(motions.twist_covariance, axis1=1, axis2=2))
    return motions.ok & (sigma[:, :3].max(axis=1) < 1.0) & (sigma[:, 3:].max(axis=1) < 0.03)


def enough_steps(motions):
    """The steps (n,) that `usable_steps` names.

    Raises TooFewSteps when there are fewer than 30, or when the turns in them are lost in the cameras' noise.
    """
    steps = np.flatnonzero(usable_steps(motions))
    if len(steps) < _MIN_STEPS:
        raise TooFewSteps(f"the cameras' motion is known in {len(steps)} steps only, {_MIN_STEPS} are needed")
    noise = np.trace(motions.twist_covariance[steps, 3:, 3:], axis1=1, axis2=2).mean()
    if motions.twists[steps, 3:].var(axis=0).sum() < _MIN_TURNING * noise:
        raise TooFewSteps("the drive turns by less than the cameras' noise")
    return steps


def align(drive, motions) -> Alignment:
    """Fit mounting, bias and scales of the IMU to the cameras' motions.

    drive : its `step_twists` are taken as they are, its extrinsics are not used. motions : its `FrameMotions`.
    Raises TooFewSteps (a ValueError) when the cameras' motion is known in fewer than 30 steps.
    """
    steps = enough_steps(motions)
    return fit(steps, drive.step_twists[steps], motions.twists[steps], motions.twist_covariance[steps])


def evidence(gain, camera_noise) -> float:
    """Squared z of a gain in log likelihood that the cameras' own noise (variance camera_noise) may have made.

    What the cameras got wrong meets the IMU's noise by chance, differently for every explanation. The right
    explanation, whose fit differs from a wrong one's by an energy E, loses by N(-E, 2 E + camera_noise); E is taken as
    the least favourable one. Without camera noise this is the likelihood ratio, twice the gain.
    """
    if gain <= 0:
        return 0.0
    return 2 * gain - camera_noise if gain >= camera_noise else gain**2 / camera_noise


def camera_noise(alignment) -> float:
    """Variance of the log likelihood that stems from the cameras' noise, see `evidence`."""
    return float((alignment.camera_variance * alignment.imu_sigma**2 / alignment.variance**2).sum())


def mounting_p_value(alignment, imu_R_cam) -> float:
    """How often the fitted mounting would win by as much over imu_R_cam (3, 3) if that were right.

    All else is fitted anew. A wrong angle theta sees the cameras' noise turned by theta: 4 sin^2(theta / 2) of it.
    """
    bound = fit(alignment.steps, alignment.measured, alignment.seen, alignment.seen_covariance, imu_R_cam)
    gain = (cost(bound, alignment.variance) - cost(alignment, alignment.variance)) / 2
    angle = np.linalg.norm(se3.so3_log(imu_R_cam @ alignment.imu_R_cam.T))
    return float(chdtrc(3, evidence(gain, 4 * np.sin(angle / 2) ** 2 * camera_noise(alignment))))


def cost(alignment, variance) -> float:
    """Sum of squared residuals in units of variance (n, 6), each counted up to four standard deviations."""
    return float(np.minimum((alignment.measured - alignment.predicted) ** 2 / variance, CUT**2).sum())


def fit(steps, measured, seen, covariance, imu_R_cam=None) -> Alignment:
    """Gauss-Newton from a closed-form start, or with the mounting held where it is given.

    steps (n,) int. measured (n, 6) IMU twists, seen (n, 6) and covariance (n, 6, 6) the cameras' in their own frame.
    Each number weighs by its own variance, the IMU's noise (one number per axis, estimated on the way) plus the
    cameras' in that step; what lies beyond four standard deviations is left out.
    """
    R = _start(measured, seen) if imu_R_cam is None else imu_R_cam
    p, b, scales = np.zeros(3), np.zeros(3), _start_scales(measured, seen, R)
    least = np.maximum(0.7 * white_noise(measured), _LEAST_NOISE)  # a median of few samples scatters
    free = slice(None) if imu_R_cam is None else slice(3, None)
    for iteration in range(_ITERATIONS + 1):
        predicted, jacobian = _model(seen, R, p, b, scales)
        residual = measured - predicted
        Ad = se3.adjoint(se3.pose(R, p))
        cameras = np.einsum("ai,kij,aj->ka", Ad, covariance, Ad, optimize=True)  # variance along the axes of the IMU
        sigma, inlier = _imu_noise(residual, cameras, least)
        if iteration == _ITERATIONS:
            break
        weight = inlier / (sigma**2 + cameras)
        weighted = jacobian * weight[..., None]
        information = np.einsum("kai,kaj->ij", weighted, jacobian, optimize=True) + _PRIOR
        # At the noisy twists the Jacobian's own noise would draw the scales towards zero (errors in variables)
        Ad = Ad * np.repeat(scales, 3)[:, None]
        _, jacobian = _model(seen + np.matvec(covariance @ Ad.T, residual * weight), R, p, b, scales)
        gradient = np.einsum("kai,ka->i", jacobian, residual * weight)
        gradient -= _PRIOR @ np.concatenate([np.zeros(3), p, b, scales - 1])
        delta = np.zeros(N_PARAMETERS)
        delta[free] = np.linalg.solve(information[free, free], gradient[free])
        R = se3.so3_exp(delta[ROTATION]) @ R
        p, b, scales = p + delta[LEVER_ARM], b + delta[GYRO_BIAS], scales + delta[9:]
    score = np.einsum("kai,ka->ki", jacobian, residual * inlier / (sigma**2 + cameras))
    return Alignment(imu_R_cam=R, camera_in_imu=p, gyro_bias=b, speed_scale=float(scales[0]),
                     gyro_scale=float(scales[1]), steps=steps,
                     covariance=_honest(np.linalg.inv(information), score, steps),
                     measured=measured, predicted=predicted, seen=seen, seen_covariance=covariance,
                     imu_sigma=sigma, camera_variance=cameras)


def _honest(covariance, score, steps):
    """The covariance, larger where residuals go together for a while, as in real recordings.

    score (n, 11), the gradient of each step: sums over ten steps would scatter by the information if the steps
    were independent. Source: White, Maximum likelihood estimation of misspecified models, 1982 (the sandwich).
    """
    together = steps // 10
    sums = np.stack([np.bincount(together, column) for column in score.T], axis=-1)
    sandwich = covariance @ (sums.T @ sums) @ covariance
    factor = np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(covariance), 1.0))
    return covariance * np.outer(factor, factor)


def _start(measured, seen):
    """Rotation that carries the cameras' velocities and (centred) rates closest to the IMU's, by SVD."""
    rates, turns = (w[:, 3:] - np.median(w[:, 3:], axis=0) for w in (measured, seen))
    speeds, moves = measured[:, :3], seen[:, :3]
    # Each kind of vector weighs by its own size: m/s and rad/s cannot be compared
    B = speeds.T @ moves / max(np.linalg.norm(speeds) * np.linalg.norm(moves), 1e-12)
    B += rates.T @ turns / max(np.linalg.norm(rates) * np.linalg.norm(turns), 1e-12)
    U, _, Vt = np.linalg.svd(B)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


def _start_scales(measured, seen, R):
    """Speed and gyro scale (2,) by linear regression: a gyro in degrees per second is too far away for Gauss-Newton."""
    speeds, rates = measured[:, :3], measured[:, 3:] - measured[:, 3:].mean(axis=0)
    moves, turns = np.matvec(R, seen[:, :3]), np.matvec(R, seen[:, 3:] - seen[:, 3:].mean(axis=0))
    scales = [(a * b).sum() / max((b * b).sum(), 1e-12) for a, b in ((speeds, moves), (rates, turns))]
    return np.maximum(scales, 1e-3)


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


def white_noise(samples):
    """(6,): noise of samples (n, 6) from their second differences, in which smooth motion, bias and scale hardly show.

    x_{k-1} - 2 x_k + x_{k+1} of white noise sigma has the variance 6 sigma^2; sharp turns do not move the median.
    Source: Allan, Statistics of atomic frequency standards, 1966 (differences in place of means).
    """
    second = np.abs(np.diff(samples, n=2, axis=0))
    return 1.4826 * np.median(second, axis=0) / 6**0.5 if len(second) else np.zeros(6)


def _imu_noise(residual, cameras, least):
    """IMU noise (6,), at least `least`, behind residuals (n, 6) beside the cameras' variance; which are no outliers."""
    sigma = np.maximum(np.median(np.abs(residual), axis=0) / 0.6745, least)
    for _ in range(10):
        total = sigma**2 + cameras
        inlier = residual**2 < CUT**2 * total
        weight = inlier / total**2  # of a squared residual, whose variance is 2 total^2
        variance = (weight * (residual**2 - cameras)).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
        sigma = np.sqrt(np.maximum(variance, least**2))
    return sigma, inlier
