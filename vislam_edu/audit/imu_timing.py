"""When the IMU measured: which of its samples belongs to which step of the cameras.

An IMU that is read late by a sample fits the cameras' motion of another step. The gyro is held against every step near
its own; where it fits best, and how much better than where it is claimed to belong, is the answer.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from . import imu_alignment

OFFSETS = np.arange(-4, 5)


@dataclass(frozen=True, eq=False)
class Timing:
    """How well IMU sample k fits the cameras' motion over step k + s, for the whole offsets s in `OFFSETS`.

    log_likelihood (9,), that of the best offset is 0. camera_noise : how much each of them scatters (variance) because
    the cameras' own noise meets the IMU's by chance, anew at every offset.
    s = 0 is the reading "k" (the sample drives the step that follows it), s = -1 is "k+1"; "mean" has its peak in
    between. (Averaging two samples for it would halve their noise and win for that reason alone.)
    """

    log_likelihood: np.ndarray
    camera_noise: float

    @property
    def best(self) -> int:
        """The likeliest whole offset."""
        return int(OFFSETS[np.argmax(self.log_likelihood)])

    @cached_property
    def peak(self) -> tuple[float, float]:
        """Top of the parabola through the best offset and its neighbours, and its standard error, in samples.

        The likelihood falls with the square of the offset as long as the motion is smooth from frame to frame.
        """
        i = int(np.clip(np.argmax(self.log_likelihood), 1, len(OFFSETS) - 2))
        before, top, after = self.log_likelihood[i - 1 : i + 2]
        curvature = 2 * top - before - after
        if curvature <= 0:
            return float(self.best), float("inf")
        error = np.sqrt(1 / curvature + self.camera_noise / (2 * curvature**2))
        return float(OFFSETS[i] + 0.5 * (after - before) / curvature), float(error)

    def p_value(self, offset) -> float:
        """How often the best offset would win by as much if this one (whole or a half) were right.

        The cameras' noise counts as in `imu_alignment.evidence`; two offsets see two independent pieces of it.
        """
        if not np.isfinite(self.peak[1]):
            return 1.0  # no offset stands out
        if abs(self.peak[0] - offset) < 0.75:
            return float(2 * ndtr(-abs(self.peak[0] - offset) / self.peak[1]))
        gain = self.log_likelihood.max() - self.log_likelihood[np.abs(OFFSETS - offset) < 0.75].max()
        z = imu_alignment.evidence(gain, 2 * self.camera_noise) ** 0.5
        return float(min(1.0, 2 * len(OFFSETS) * ndtr(-z)))


def estimate(drive, motions) -> Timing:
    """Hold the gyro at every offset from -4 to 4 against the cameras; the alignment is fitted anew for each.

    The speed is left out: it changes too slowly to tell the time, and its noise would drown what the gyro says.
    Uses the raw samples, `drive.imu_sample` does not matter. Raises `imu_alignment.TooFewSteps`, a ValueError,
    when the cameras' motion is known in fewer than 30 steps.
    """
    steps = imu_alignment.enough_steps(motions)
    seen, covariance = motions.twists[steps], motions.twist_covariance[steps]
    residuals, cameras = np.full((2, len(OFFSETS), drive.n_frames, 3), np.nan)
    fits = []
    for i, offset in enumerate(OFFSETS):
        sample = steps - offset
        there = (sample >= 0) & (sample < drive.n_frames)
        fit = imu_alignment.fit(steps[there], drive.twists[sample[there]], seen[there], covariance[there])
        fits.append(fit)
        residuals[i, sample[there]] = (fit.measured - fit.predicted)[:, 3:]
        cameras[i, sample[there]] = fit.camera_variance[:, 3:]
    quietest = min(fits, key=lambda fit: np.log(fit.imu_sigma[3:]).sum())
    noise = quietest.imu_sigma[3:] ** 2

    def gain(a, b):
        """Log likelihood of offset b less that of a, over the samples of both: those of one alone would weigh much."""
        variance = noise + (cameras[a] + cameras[b]) / 2
        cost_a, cost_b = (np.minimum(residuals[i] ** 2 / variance, imu_alignment.CUT**2) for i in (a, b))
        return 0.5 * np.nansum(cost_a - cost_b)

    best = int(np.searchsorted(OFFSETS, 0))
    for _ in range(len(OFFSETS)):
        log_likelihood = np.array([gain(best, i) for i in range(len(OFFSETS))])
        if log_likelihood.max() <= 0:
            break
        best = int(np.argmax(log_likelihood))
    camera_noise = (quietest.camera_variance[:, 3:] * noise / quietest.variance[:, 3:] ** 2).sum()
    return Timing(log_likelihood=log_likelihood - log_likelihood.max(), camera_noise=float(camera_noise))
