"""What a real IMU measures along a smooth path: rotation rate and specific force, with noise and walking biases.

A path is known at some times, as poses; `SmoothPath` puts splines through them, and the samples are exact for these
splines. `inertial_loop` is the street loop with such an IMU, from a stand-still.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import se3
from ..drive import Drive
from ..imu import ADIS16448, GRAVITY, ImuNoise
from ..inertial import ImuSamples
from . import drives, streets

__all__ = ["SmoothPath", "inertial_loop", "measure", "perfect_samples"]


class SmoothPath:
    """Poses at any time between the first and the last of some known ones: a quintic spline and a rotation spline.

    times : (n,) s, at least six. world_T_imu : (n, 4, 4).
    """

    def __init__(self, times: np.ndarray, world_T_imu: np.ndarray) -> None:
        from scipy.interpolate import make_interp_spline  # here: `run`, which makes no samples, need not wait for them
        from scipy.spatial.transform import Rotation, RotationSpline

        self._position = make_interp_spline(times, world_T_imu[:, :3, 3], k=5)
        self._rotation = RotationSpline(times, Rotation.from_matrix(world_T_imu[:, :3, :3]))

    def poses(self, times: np.ndarray) -> np.ndarray:
        """(n, 4, 4) at times (n,), s."""
        return se3.pose(self._rotation(times).as_matrix(), self._position(times))

    def velocities(self, times: np.ndarray) -> np.ndarray:
        """(n, 3), m/s, world frame."""
        return self._position(times, nu=1)


def perfect_samples(path: SmoothPath, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gyro (n, 3) rad/s and accelerometer (n, 3) m/s^2 between the times (n+1,), s: means over each interval.

    `imu.propagate` follows them from rotation to rotation and from velocity to velocity without error.
    """
    taus = np.diff(times)[:, None]
    R = path.poses(times)[:, :3, :3]
    gyro = se3.so3_log(R[:-1].mT @ R[1:]) / taus
    halfway = R[:-1] @ se3.so3_exp(taus * gyro / 2)
    return gyro, np.vecmat(np.diff(path.velocities(times), axis=0) / taus - GRAVITY, halfway)


def measure(path: SmoothPath, times: np.ndarray, noise: ImuNoise = ADIS16448, seed: int = 0,
            biases: np.ndarray | None = None) -> tuple[ImuSamples, np.ndarray]:
    """The samples between the times (n+1,), s, with white noise and biases that walk.

    biases : (6,), rad/s and m/s^2, at the first time; zero where none are given.
    Returns the samples and the true biases (n+1, 6) at the times. The last sample, which no interval follows, repeats
    the one before.
    """
    rng, taus = np.random.default_rng((seed, len(times))), np.diff(times)
    sigma = np.sqrt([noise.covariance(tau).diagonal() for tau in taus])
    draws = sigma * rng.standard_normal(sigma.shape)
    walk = np.cumsum(np.concatenate([np.zeros((1, 6)), draws[:, 6:]]), axis=0) + (0 if biases is None else biases)
    values = np.hstack(perfect_samples(path, times)) + draws[:, :6] + walk[:-1]
    values = np.concatenate([values, values[-1:]])
    return ImuSamples(times, values[:, :3], values[:, 3:], noise), walk


def inertial_loop(seed: int = 0, *, frames: int = 500, tau: float = 0.1, still: float = 2.0, rate: float = 200.0,
                  speed: float = 10.0, noise: ImuNoise = ADIS16448, biases: np.ndarray | None = None,
                  sigma_px: float = 0.7, warp: Callable[[np.ndarray], np.ndarray] | None = None,
                  **tracks: Any) -> tuple[Drive, np.ndarray, np.ndarray]:
    """A street loop with an accelerometer, after a stand-still: the drive, true velocity (T, 3), true biases (T, 6).

    frames, tau : cameras, and s between them. still : s without motion at the start; the car then needs 4 s to reach
    its speed, m/s. rate : Hz of the IMU. biases : (6,) at the start, drawn where none are given (0.01 rad/s and
    0.05 m/s^2 on each axis). warp : time of the drive to time on the road, s, instead of this start. tracks :
    arguments of `drives.along`. The world has z up.
    """
    times = tau * np.arange(frames)
    fine = np.linspace(0, times[-1], max(7, round(20 * times[-1]) + 1))
    road = warp or (lambda t: _pull_away(t - still))
    loop = max(speed * times[-1], drives.SHORTEST_LOOP)
    rng = np.random.default_rng((seed, 100))
    path = SmoothPath(fine, streets.drive_along(rng, road(fine), speed, loop, 1.0))
    if biases is None:
        biases = np.repeat([0.01, 0.05], 3) * rng.standard_normal(6)
    imu_times = np.linspace(0, times[-1], round(rate * times[-1]) + 1)
    samples, walk = measure(path, imu_times, noise, seed, biases)
    drive = drives.along(path.poses(times), times, seed, **({"name": "inertial loop"} | tracks))
    drive = drives.add_noise(drive, seed, sigma_v=0, sigma_omega=0, sigma_px=sigma_px).replace(imu=samples)
    return drive, path.velocities(times), walk[np.searchsorted(imu_times, times - 1e-9)]


def _pull_away(t: np.ndarray) -> np.ndarray:
    """Seconds on the road: none before t = 0, then a pace that rises smoothly to one within 4 s."""
    u = np.clip(t / 4, 0, 1)
    return 4 * (u**3 - u**4 / 2) + np.maximum(t - 4, 0)
