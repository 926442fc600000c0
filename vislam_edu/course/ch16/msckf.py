"""The pieces of an MSCKF: clones of the pose instead of landmarks, and the null space that removes a landmark.

The state holds copies (clones) of the last poses. A landmark never enters it: when its track ends, all its pixels
become one measurement of the clones, r = H_x (errors of the clones) + H_f (error of the landmark) + noise. With the
columns of N an orthonormal basis of the vectors that H_f does not reach, N^T H_f = 0, N^T r no longer depends on the
landmark.

Source: Mourikis, Roumeliotis, A multi-state constraint Kalman filter for vision-aided inertial navigation, 2007.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, qr

from ... import kalman, se3
from ...error_state import RightPerturbation
from ...stereo import ROWS, StereoCamera


def clone(covariance: np.ndarray, pose: slice) -> np.ndarray:
    """The covariance (d+6, d+6) after a copy of the pose, at `pose`, has joined a state of d numbers as its last."""
    rows = np.r_[:len(covariance), pose]
    return covariance[np.ix_(rows, rows)]


def track_jacobians(camera: StereoCamera, poses: np.ndarray, landmark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H_x (3n, 6n) and H_f (3n, 3), px: rows [u_left, v, u_right] of one landmark (3,) seen from n poses (n, 4, 4).

    Errors are those of `RightPerturbation`.
    """
    J = camera.measurement_jacobian(camera.to_cam(poses, landmark))[:, ROWS]
    H_x = np.zeros((len(poses), 3, len(poses), 6))
    H_f = np.empty((len(poses), 3, 3))
    for i, (pose, J_i) in enumerate(zip(poses, J)):
        [H_f[i]], [H_x[i, :, i]] = RightPerturbation().jacobians(pose, landmark[None], J_i[None])
    return H_x.reshape(3 * len(poses), -1), H_f.reshape(-1, 3)


def null_space(H_f: np.ndarray) -> np.ndarray:
    """N (m, m-3), orthonormal columns with N^T H_f = 0, for H_f (m, 3) of rank 3: the last of Q in H_f = Q R."""
    return qr(H_f)[0][:, H_f.shape[1]:]


def update(covariance: np.ndarray, H_x: np.ndarray, H_f: np.ndarray, residual: np.ndarray,
           sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """The MSCKF's update by one track: estimated error (d,) of the clones and their covariance (d, d) afterwards.

    residual : (m,), each of standard deviation sigma, one unit for all: divide rows that differ by theirs first.
    """
    N = null_space(H_f)
    return kalman.update(covariance, N.T @ H_x, sigma**2 * np.eye(N.shape[1]), N.T @ residual)


def joint_update(covariance: np.ndarray, H_x: np.ndarray, H_f: np.ndarray, residual: np.ndarray,
                 sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """The same the long way: clones and landmark estimated together by least squares, then the landmark marginalised.

    The landmark has no prior. Its elimination is the Schur complement of chapter 11.
    """
    U = np.linalg.inv(covariance) + H_x.T @ H_x / sigma**2
    V, W = H_f.T @ H_f / sigma**2, H_x.T @ H_f / sigma**2
    S = U - W @ np.linalg.solve(V, W.T)
    g = (H_x.T @ residual - W @ np.linalg.solve(V, H_f.T @ residual)) / sigma**2
    factor = cho_factor(S)
    return cho_solve(factor, g), cho_solve(factor, np.eye(len(S)))


class FirstEstimates(RightPerturbation):
    """The report's error with first-estimates Jacobians: every derivative is taken where its variable was first known.

    A pose is linearised at its prediction, a landmark where it was born, in F and in H alike, whatever has been learnt
    since. Then the direction that no camera sees, a turn of everything, is the same in all. A point is (n, 2, 3):
    the landmark as now estimated, and as first estimated. An object serves one run: it remembers the last prediction.
    Source: Huang, Mourikis, Roumeliotis, A first-estimates Jacobian EKF for improving SLAM consistency, 2009.
    """

    name = "first-estimates"
    point_shape = (2, 3)

    def __init__(self) -> None:
        self.predicted = np.eye(4)

    def pose_transition(self, after: np.ndarray, increment: np.ndarray,
                        body_noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F between two predictions, not from the corrected pose to the next prediction."""
        F = se3.adjoint(se3.inverse(after) @ self.predicted)
        self.predicted = after
        return F, body_noise

    def measure(self, camera: StereoCamera, world_T_imu: np.ndarray,
                points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels of the landmark as now estimated, H at the one first estimated. The pose is the predicted one."""
        q, *_ = super().measure(camera, world_T_imu, points[:, 0])
        return q, *super().measure(camera, world_T_imu, points[:, 1])[1:]

    def triangulate(self, camera: StereoCamera, world_T_imu: np.ndarray, pixels: np.ndarray, sigma_px: float,
                    min_disparity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The point twice: now and first are one."""
        points, covariance, ok = super().triangulate(camera, world_T_imu, pixels, sigma_px, min_disparity)
        return np.stack([points, points], axis=1), covariance, ok

    def inherited(self, world_T_imu: np.ndarray, points: np.ndarray) -> np.ndarray:
        """G at the pose's first estimate, its prediction, so that the new landmark turns with the others."""
        return super().inherited(self.predicted, points[:, 1])

    def retract(self, world_T_imu: np.ndarray, points: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The estimates move, the first ones stay."""
        pose, moved = super().retract(world_T_imu, points[:, 0], delta)
        return pose, np.stack([moved, points[:, 1]], axis=1)

    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            points: np.ndarray) -> np.ndarray:
        """True minus estimated position."""
        return true_landmarks - points[:, 0]
