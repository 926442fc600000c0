"""What an error is. A filter on SE(3) cannot subtract; each class here defines true minus estimate in one way.

`ErrorState` lists what the joint filter in `window_slam`, and those who judge it, need; two filters differ in nothing
else. Errors are ordered [landmarks 3n, position 3, rotation 3]: landmarks before the pose, as in the report.

>>> import numpy as np
>>> right, T = RightPerturbation(), np.eye(4)
>>> moved, _ = right.retract(T, np.empty((0, 3)), np.array([1.0, 0, 0, 0, 0, 0]))
>>> right.pose_difference(moved, T).round(3).tolist()
[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
"""

from abc import ABC, abstractmethod

import numpy as np

from . import se3
from .belief import Belief


class ErrorState(ABC):
    """Interface that every error state implements. n landmarks, m, world frame; errors in m and rad.

    role : key of `plots.style.COLOURS` that such a filter is drawn with.
    landmark_rows, pose_rows : names of the three rows of a landmark and of the six of the pose.
    """

    name: str
    role = "slam"
    landmark_rows = ("x", "y", "z")
    pose_rows = ("forward", "left", "up", "roll", "pitch", "yaw")

    @abstractmethod
    def pose_transition(self, after: np.ndarray, increment: np.ndarray,
                        body_noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How an error of the pose, and of the twist, becomes an error one step later.

        after : (4, 4) world_T_imu at the end of the step. increment : (4, 4), exp(tau u^), the step itself.
        body_noise : (6, 6), tau J_r(tau u), twist error to pose error in the body frame at the end of the step.
        Returns F (6, 6) and B (6, 6): pose error' = F pose error + B (error of the twist).
        """

    @abstractmethod
    def landmark_transition(self, landmarks: np.ndarray, B: np.ndarray) -> np.ndarray:
        """(n, 3, 6): error of the twist to error of each landmark; zeros where it moves none."""

    @abstractmethod
    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                  J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How an error changes what the cameras measure: H of a measurement of each landmark, in two parts.

        J : (n, m, 3), derivative of the m numbers by the point in the IMU frame. landmarks : (n, 3).
        Returns (n, m, 3) for the landmark and (n, m, 6) for the pose.
        """

    @abstractmethod
    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What a new landmark inherits: its error = G (pose error) + A (error of its triangulation in the IMU frame).

        points_imu : (n, 3). Returns G (n, 3, 6) and A (3, 3).
        """

    @abstractmethod
    def retract(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state, pose (4, 4) and landmarks (n, 3), after an error delta (3n+6,) has been estimated."""

    def retract_motion(self, world_T_imu: np.ndarray, values: np.ndarray, delta: np.ndarray) -> np.ndarray:
        """What a motion model estimates beyond the pose, (t,), after an error delta (6+t,), [pose, motion]: a sum."""
        return values + delta[6:]

    @abstractmethod
    def pose_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
        """(..., 6): the error of a pose when the truth is known."""

    @abstractmethod
    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            landmarks: np.ndarray) -> np.ndarray:
        """(n, 3): the error of each landmark when the truth is known."""

    @abstractmethod
    def world_landmark(self, landmarks: np.ndarray) -> np.ndarray:
        """(n, 3, 6): C with  m - m_hat = landmark error + C (pose error), metres in the world frame."""

    @abstractmethod
    def world_pose(self, world_T_imu: np.ndarray) -> np.ndarray:
        """(6, 6): pose error to [p - p_hat, rotation vector] in the world frame, to first order."""


class RightPerturbation(ErrorState):
    """The report's error: T = T_hat exp(epsilon^) in the body frame, m = m_hat + delta in the world frame.

    Source: report section 3.3.1; Barfoot, State Estimation for Robotics, chapter 8.
    """

    name = "right perturbation"

    def pose_transition(self, after: np.ndarray, increment: np.ndarray,
                        body_noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F = exp(-tau u_curly); B is the body's own noise. Source: report section 3.3.1."""
        return se3.adjoint(se3.inverse(increment)), body_noise

    def landmark_transition(self, landmarks: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Zeros: the motion of the car changes no landmark error."""
        return np.zeros((len(landmarks), 3, 6))

    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                  J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J R^T  and  -J [I, -s^],  s (n, 3) the points in the IMU frame.

        Source: report section 3.3.1 (the circled-dot form).
        """
        s = se3.transform(se3.inverse(world_T_imu), landmarks)
        return J @ world_T_imu[:3, :3].T, np.concatenate([-J, J @ se3.so3_hat(s)], axis=-1)

    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """G = R [I, -s^] and A = R,  s (n, 3) the points in the IMU frame."""
        R = world_T_imu[:3, :3]
        n = len(points_imu)
        return np.concatenate([np.broadcast_to(R, (n, 3, 3)), -R @ se3.so3_hat(points_imu)], axis=-1), R

    def retract(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """T exp(epsilon^) and m + delta."""
        n = len(landmarks)
        return world_T_imu @ se3.exp(delta[3 * n:]), landmarks + delta[:3 * n].reshape(n, 3)

    def pose_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
        """epsilon with T_true = T exp(epsilon^)."""
        return se3.log(se3.inverse(world_T_imu) @ true_world_T_imu)

    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            landmarks: np.ndarray) -> np.ndarray:
        """True minus estimated position."""
        return true_landmarks - landmarks

    def world_landmark(self, landmarks: np.ndarray) -> np.ndarray:
        """Zeros: the landmark error is already in world coordinates (metres)."""
        return np.zeros((len(landmarks), 3, 6))

    def world_pose(self, world_T_imu: np.ndarray) -> np.ndarray:
        """Position and rotation turned from the body into the world: diag(R, R)."""
        C = np.zeros((6, 6))
        C[:3, :3] = C[3:, 3:] = world_T_imu[:3, :3]
        return C


class RightInvariant(ErrorState):
    """The right-invariant error: one rotation x_R of the whole world, about the world's origin.

    R = exp(x_R) R_hat,  p = exp(x_R) p_hat + J_l(x_R) x_p,  m = exp(x_R) m_hat + J_l(x_R) x_m

    Position and landmarks turn together, so an error that no sensor can measure (a turn or a shift of car and map
    as one) has the same coordinates at every estimate: a change of the estimate cannot pass for information.
    Source: Barrau, Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015; Zhang et al., Convergence and
    consistency analysis for a 3-D invariant-EKF SLAM, 2017.
    """

    name = "right-invariant"
    role = "invariant"
    landmark_rows = ("x_m x", "x_m y", "x_m z")
    pose_rows = ("x_p x", "x_p y", "x_p z", "x_R x", "x_R y", "x_R z")

    def pose_transition(self, after: np.ndarray, increment: np.ndarray,
                        body_noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F = I, whatever the car does; an error of the twist enters through the adjoint of the pose."""
        return np.eye(6), se3.adjoint(after) @ body_noise

    def landmark_transition(self, landmarks: np.ndarray, B: np.ndarray) -> np.ndarray:
        """m^ B_R. The landmark stands still, but its error is expressed relative to the turned world."""
        return se3.so3_hat(landmarks) @ B[3:]

    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                  J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J R^T on the landmark and [-J R^T, 0] on the pose: rotation has dropped out."""
        H = J @ world_T_imu[:3, :3].T
        return H, np.concatenate([-H, np.zeros_like(H)], axis=-1)

    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """G = [I, 0]: a new landmark inherits the position error as it is. A = R."""
        n = len(points_imu)
        return np.broadcast_to(np.eye(3, 6), (n, 3, 6)), world_T_imu[:3, :3]

    def retract(self, world_T_imu: np.ndarray, landmarks: np.ndarray,
                delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The exponential of SE_{1+n}(3): one rotation, and its left Jacobian on every translation."""
        n = len(landmarks)
        x_R = delta[3 * n + 3:]
        turn, J = se3.so3_exp(x_R), se3.so3_left_jacobian(x_R)
        # The pose is one more point of this group: p turns and shifts exactly as a landmark does.
        points = np.concatenate([landmarks, world_T_imu[None, :3, 3]])
        points = points @ turn.T + delta[:3 * n + 3].reshape(n + 1, 3) @ J.T
        return se3.pose(turn @ world_T_imu[:3, :3], points[-1]), points[:-1]

    def pose_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
        """x with T_true = exp(x^) T."""
        return se3.log(true_world_T_imu @ se3.inverse(world_T_imu))

    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            landmarks: np.ndarray) -> np.ndarray:
        """x_m, from the definition above."""
        x_R = self.pose_difference(true_world_T_imu, world_T_imu)[3:]
        rest = true_landmarks - landmarks @ se3.so3_exp(x_R).T
        return rest @ se3.so3_left_jacobian_inverse(x_R).T

    def world_landmark(self, landmarks: np.ndarray) -> np.ndarray:
        """C = [0, -m^]. To first order m - m_hat = x_m - m^ x_R: what an ellipse on a map needs."""
        hat = se3.so3_hat(landmarks)
        return np.concatenate([np.zeros_like(hat), -hat], axis=-1)

    def world_pose(self, world_T_imu: np.ndarray) -> np.ndarray:
        """p - p_hat = x_p - p^ x_R; the rotation error is already in world coordinates."""
        C = np.eye(6)
        C[:3, 3:] = -se3.so3_hat(world_T_imu[:3, 3])
        return C


def world_landmark_covariance(belief: Belief, error_state: ErrorState) -> np.ndarray:
    """(n, 3, 3) m^2: covariance of each landmark's position in the world, whatever the filter calls an error.

    With m - m_hat = x_m + C x_pose it is P_mm + C P_pm + P_mp C^T + C P_pp C^T.
    """
    P_mm = belief.landmark_covariance
    C = error_state.world_landmark(belief.landmarks)
    if not C.any():
        return P_mm
    Ct = np.swapaxes(C, -1, -2)
    P_mp = belief.covariance[:3 * len(belief.ids), belief.pose].reshape(-1, 3, 6)
    cross = P_mp @ Ct
    return P_mm + cross + np.swapaxes(cross, -1, -2) + C @ belief.pose_covariance @ Ct


def to_right(error_state: ErrorState, world_T_imu: np.ndarray) -> np.ndarray:
    """(6, 6): an error of the pose to the right perturbation that moves it as far, to first order."""
    return RightPerturbation().world_pose(world_T_imu).T @ error_state.world_pose(world_T_imu)  # two rotations: .T


def right_pose_covariance(belief: Belief, error_state: ErrorState) -> np.ndarray:
    """(6, 6) covariance of the pose as a right perturbation T exp(epsilon^), to first order."""
    to = to_right(error_state, belief.world_T_imu)
    return to @ belief.pose_covariance @ to.T
