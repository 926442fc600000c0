"""How noisy the sensors of a recording are, measured from the recording itself instead of tuned.

Each step is driven twice: by the IMU and by the cameras. What the two differ by, after the mounting, the bias and the
scale that fit best, is the noise of both; the cameras' part is known from the Hessian of their own fit and is
subtracted. Whatever else the two disagree about (a speed averaged over another interval, slip, a wobbling mount) counts
as IMU noise, which is what a filter needs.
"""

from dataclasses import dataclass

import numpy as np

from ..noise import Noise
from . import cures, imu_alignment, visual_odometry

LEAST_PX = 1e-3  # real pixels always have some noise


@dataclass(frozen=True, eq=False)
class MeasuredNoise:
    """Standard deviations of the sensors of one recording.

    sigma_v (3,) m/s and sigma_omega (3,) rad/s : of one IMU sample, by axis of the IMU.
    sigma_px_rows : px, from v_left - v_right: what left and right disagree about, a lasting mismatch included.
    sigma_px_flow : px, from the residuals of one-frame motion: what changes from frame to frame.
    standard_error (6,) : of the six IMU numbers, same units.
    """

    sigma_v: np.ndarray
    sigma_omega: np.ndarray
    sigma_px_rows: float
    sigma_px_flow: float
    standard_error: np.ndarray

    @property
    def noise(self) -> Noise:
        """For a filter: root mean square over the axes, and the larger of the two pixel numbers."""
        return Noise(sigma_v=float(np.sqrt(np.mean(self.sigma_v**2))),
                     sigma_omega=float(np.sqrt(np.mean(self.sigma_omega**2))),
                     sigma_px=max(self.sigma_px_rows, self.sigma_px_flow, LEAST_PX))

    def __str__(self):
        v, w = (", ".join(f"{x:.3g}" for x in sigma) for sigma in (self.sigma_v, self.sigma_omega))
        return (f"IMU noise per sample: v {v} m/s, omega {w} rad/s; "
                f"pixels {self.sigma_px_rows:.2f} px (rows), {self.sigma_px_flow:.2f} px (frame to frame)")


def measure(drive) -> MeasuredNoise:
    """Noise of the IMU and of the pixels of a drive, from one-frame stereo motion.

    Extrinsics, gyro bias and scales are fitted on the way and need not be right; `drive.imu_sample` must be (`audit`
    tells). Tracks are used up to their first copy only. Raises ValueError when the cameras see too little to judge.
    """
    tracks = cures.end_tracks_at_copies()(drive)
    motions = visual_odometry.estimate(tracks)
    return from_alignment(tracks, imu_alignment.align(tracks, motions), motions)


def from_alignment(drive, alignment, motions, every=1) -> MeasuredNoise:
    """The same from an `Alignment` and `FrameMotions` already at hand. every : samples that a step of it averages."""
    # The mean of two samples has half the variance
    per_sample = 2**0.5 if every == 1 and drive.imu_sample == "mean" else every**0.5
    sigma = per_sample * alignment.imu_sigma
    # Squared residuals scatter by sqrt(2) of their variance; all of that falls on the IMU's part
    variance_error = np.sqrt(2 / np.sum(alignment.variance**-2, axis=0))
    error = per_sample * variance_error / (2 * alignment.imu_sigma)
    return MeasuredNoise(sigma[:3], sigma[3:], sigma_px_rows=visual_odometry.row_noise(drive.pixels),
                         sigma_px_flow=motions.sigma_px, standard_error=error)


def from_samples(drive) -> MeasuredNoise:
    """Noise of the IMU from its own samples (`imu_alignment.white_noise`), where no camera can judge it."""
    sigma = imu_alignment.white_noise(drive.twists)
    rows = visual_odometry.row_noise(drive.pixels)
    error = sigma / drive.n_frames**0.5  # of a median, neighbours sharing samples: about one over the root
    return MeasuredNoise(sigma[:3], sigma[3:], sigma_px_rows=rows, sigma_px_flow=rows, standard_error=error)
