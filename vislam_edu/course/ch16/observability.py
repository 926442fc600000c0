"""What a few frames with a real IMU can measure, by the rank of all their residuals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ... import imu, se3
from ...imu import Preintegrated, State
from ...inertial import ImuSamples
from ...stereo import ROWS, StereoCamera


def motions(samples: ImuSamples, start: State, times: np.ndarray) -> list[Preintegrated]:
    """The motions between the times (n,), s, for the biases of `start`."""
    return [imu.preintegrate(*samples.between(a, b), start.gyro_bias, start.accelerometer_bias)
            for a, b in pairwise(times)]


def along(start: State, steps: list[Preintegrated]) -> list[State]:
    """The states to which the motions lead from `start`: every residual of the IMU is zero there."""
    states = [start]
    for motion in steps:
        states.append(imu.predict(states[-1], motion))
    return states


def system(camera: StereoCamera, states: list[State], steps: list[Preintegrated], points: np.ndarray,
           shift: float = 0.0) -> np.ndarray:
    """The Jacobian (rows, 15n + 3m) of the motions between n states and of the pixels of m points (m, 3), m.

    Columns: the states, 15 each in the order of `imu`, then the points. shift : m, by which the pixels of the second
    half of the frames are linearised at other positions, as after a relinearisation that spares a prior.
    """
    n, m = len(states), len(points)
    H = []
    for i, motion in enumerate(steps):
        rows = np.zeros((15, 15 * n + 3 * m))
        _, by_before, by_after = imu.residual(states[i], states[i + 1], motion)
        rows[:, 15 * i:15 * i + 30] = np.hstack([by_before, by_after])
        H.append(rows / np.sqrt(np.diag(motion.covariance))[:, None])
    for i, state in enumerate(states):
        R, moved = state.rotation, [shift if i >= n // 2 else 0.0, 0.0, 0.0]
        s = (points - state.position - moved) @ R
        J = camera.measurement_jacobian(se3.transform(camera.cam_T_imu, s))[:, ROWS]
        rows = np.zeros((m, 3, 15 * n + 3 * m))
        rows[:, :, 15 * i:15 * i + 3] = J @ se3.so3_hat(s)
        rows[:, :, 15 * i + 3:15 * i + 6] = -J @ R.T
        for j in range(m):
            rows[j, :, 15 * n + 3 * j:15 * n + 3 * j + 3] = J[j] @ R.T
        H.append(rows.reshape(3 * m, -1))
    return np.concatenate(H)


def unmeasured(H: np.ndarray) -> int:
    """How many directions of the unknowns no row of H sees."""
    values = np.linalg.svd(H / np.linalg.norm(H, axis=0), compute_uv=False)
    return int(np.sum(values <= 1e-9 * values[0]))
