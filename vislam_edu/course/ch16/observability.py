"""What a few frames with a real IMU can measure, by the rank of all their residuals."""

from __future__ import annotations

import numpy as np

from ... import imu, se3
from ...drive import Drive
from ...imu import State
from ...stereo import ROWS


def along_the_samples(drive: Drive, start: State, frames: np.ndarray) -> list[State]:
    """The states at the frames (n,) to which the samples lead from `start`: every residual of the IMU is zero there."""
    states = [start]
    for a, b in zip(drive.times[frames[:-1]], drive.times[frames[1:]]):
        motion = imu.preintegrate(*drive.imu.between(a, b), start.gyro_bias, start.accelerometer_bias)
        states.append(imu.predict(states[-1], motion))
    return states


def system(drive: Drive, states: list[State], frames: np.ndarray, points: np.ndarray, shift: float = 0.0) -> np.ndarray:
    """The Jacobian (rows, 15n + 3m) of the IMU's factors between n frames and of the pixels of m points (m, 3), m.

    Columns: the states, 15 each in the order of `imu`, then the points. shift : rad, by which the pixels of the second
    half of the frames are linearised at another heading, as after a relinearisation that spares the first half.
    """
    n, m, camera = len(states), len(points), drive.camera
    H = []
    for i, (a, b) in enumerate(zip(states[:-1], states[1:])):
        motion = imu.preintegrate(*drive.imu.between(*drive.times[frames[i:i + 2]]), a.gyro_bias, a.accelerometer_bias)
        rows = np.zeros((15, 15 * n + 3 * m))
        _, rows[:, 15 * i:15 * i + 15], rows[:, 15 * i + 15:15 * i + 30] = imu.residual(a, b, motion)
        H.append(rows / np.sqrt(np.diag(motion.covariance))[:, None])
    for i, state in enumerate(states):
        R = state.rotation if i < n // 2 else se3.so3_exp([0, 0, shift]) @ state.rotation
        s = (points - state.position) @ R
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
