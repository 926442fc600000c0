"""What an "error" is. A filter on SE(3) cannot subtract; each class here is one way to say true minus estimate.

`ErrorState` lists what the joint filter in `slam.py`, and those who judge it, ask; the answers are all that differs
between two filters. Errors are ordered [landmarks 3n, position 3, rotation 3]: landmarks before the pose, as in the
report.
"""

from typing import Protocol

import numpy as np
from scipy.linalg import block_diag

from . import se3


class ErrorState(Protocol):
    """The questions to a definition of the error. n landmarks, told in the world frame, m; errors in m and rad."""

    name: str

    def pose_transition(self, after, increment, body_noise):
        """How an error of the pose, and of the twist, becomes an error one step later.

        after : (4, 4) world_T_imu at the end of the step. increment : (4, 4), exp(tau u^), the step itself.
        body_noise : (6, 6), tau J_r(tau u), twist error to pose error in the body frame at the end of the step.
        Returns F (6, 6) and B (6, 6): pose error' = F pose error + B (error of the twist).
        """

    def landmark_transition(self, landmarks, B):
        """(n, 3, 6): error of the twist to error of each landmark, or None where it moves none."""

    def jacobians(self, world_T_imu, landmarks, J):
        """How an error changes what the cameras see: H of a measurement of each landmark, in two parts.

        J : (n, m, 3), derivative of the m numbers by the point in the IMU frame. landmarks : (n, 3).
        Returns (n, m, 3) for the landmark and (n, m, 6) for the pose.
        """

    def birth(self, world_T_imu, points_imu):
        """What a new landmark inherits: its error = G (pose error) + A (error of its triangulation in the IMU frame).

        points_imu : (n, 3). Returns G (n, 3, 6) and A (3, 3).
        """

    def retract(self, world_T_imu, landmarks, delta):
        """The state, pose and landmarks, after an error delta (3n+6,) has been estimated."""

    def pose_difference(self, true_world_T_imu, world_T_imu):
        """(..., 6): the error of a pose when the truth is known."""

    def landmark_difference(self, true_world_T_imu, world_T_imu, true_landmarks, landmarks):
        """(n, 3): the error of each landmark when the truth is known."""

    def world_landmark(self, landmarks):
        """(n, 3, 6): C with  m - m_hat = landmark error + C (pose error), metres in the world, or None for C = 0."""

    def world_pose(self, world_T_imu):
        """(6, 6): pose error to [p - p_hat, rotation vector] in the world frame, to first order."""


class RightPerturbation(ErrorState):
    """The report's error: T = T_hat exp(epsilon^) in the body frame, m = m_hat + delta in the world frame.

    Source: report section 3.3.1; Barfoot, State Estimation for Robotics, chapter 8.
    """

    name = "right perturbation"

    def pose_transition(self, after, increment, body_noise):
        """F = exp(-tau u_curly); the body's own noise is B. Source: report section 3.3.1."""
        return se3.adjoint(se3.inverse(increment)), body_noise

    def landmark_transition(self, landmarks, B):
        """A moving car moves no landmark: None."""
        return None

    def jacobians(self, world_T_imu, landmarks, J):
        """J R^T  and  -J [I, -s^],  s (n, 3) the points in the IMU frame.

        Source: report section 3.3.1 (the circled-dot form).
        """
        s = se3.transform(se3.inverse(world_T_imu), landmarks)
        return J @ world_T_imu[:3, :3].T, np.concatenate([-J, J @ se3.so3_hat(s)], axis=-1)

    def birth(self, world_T_imu, points_imu):
        """G = R [I, -s^] and A = R,  s (n, 3) the points in the IMU frame."""
        R = world_T_imu[:3, :3]
        n = len(points_imu)
        return np.concatenate([np.broadcast_to(R, (n, 3, 3)), -R @ se3.so3_hat(points_imu)], axis=-1), R

    def retract(self, world_T_imu, landmarks, delta):
        """T exp(epsilon^) and m + delta."""
        n = len(landmarks)
        return world_T_imu @ se3.exp(delta[3 * n:]), landmarks + delta[:3 * n].reshape(n, 3)

    def pose_difference(self, true_world_T_imu, world_T_imu):
        """epsilon with T_true = T exp(epsilon^)."""
        return se3.log(se3.inverse(world_T_imu) @ true_world_T_imu)

    def landmark_difference(self, true_world_T_imu, world_T_imu, true_landmarks, landmarks):
        """True minus estimated position."""
        return true_landmarks - landmarks

    def world_landmark(self, landmarks):
        """The landmark error is told in metres in the world already: None."""
        return None

    def world_pose(self, world_T_imu):
        """Position and rotation turned from the body into the world: diag(R, R)."""
        R = world_T_imu[:3, :3]
        return block_diag(R, R)


class RightInvariant(ErrorState):
    """The right-invariant error: one rotation x_R of the whole world, about the world's origin.

    R = exp(x_R) R_hat,  p = exp(x_R) p_hat + J_l(x_R) x_p,  m = exp(x_R) m_hat + J_l(x_R) x_m

    Position and landmarks turn together, so an error that no sensor can see (a turn or a shift of car and map as one)
    looks the same at every state: the filter cannot mistake its own changes of mind for information.
    Source: Barrau, Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015; Zhang et al., Convergence and
    consistency analysis for a 3-D invariant-EKF SLAM, 2017.
    """

    name = "right-invariant"

    def pose_transition(self, after, increment, body_noise):
        """F = I, whatever the car does; an error of the twist enters through the Adjoint of the pose."""
        return np.eye(6), se3.adjoint(after) @ body_noise

    def landmark_transition(self, landmarks, B):
        """m^ B_R. The landmark itself stays, but its error is told relative to the turned world."""
        return se3.so3_hat(landmarks) @ B[3:]

    def jacobians(self, world_T_imu, landmarks, J):
        """J R^T on the landmark and [-J R^T, 0] on the pose: rotation has dropped out."""
        H = J @ world_T_imu[:3, :3].T
        return H, np.concatenate([-H, np.zeros_like(H)], axis=-1)

    def birth(self, world_T_imu, points_imu):
        """G = [I, 0]: a new landmark inherits the position error as it is. A = R."""
        n = len(points_imu)
        return np.broadcast_to(np.eye(3, 6), (n, 3, 6)), world_T_imu[:3, :3]

    def retract(self, world_T_imu, landmarks, delta):
        """The exponential of SE_{1+n}(3): one rotation, and its left Jacobian on every translation."""
        n = len(landmarks)
        x_R = delta[3 * n + 3:]
        turn, J = se3.so3_exp(x_R), se3.so3_left_jacobian(x_R)
        # The pose is one more point of this group: p turns and shifts exactly as a landmark does.
        points = np.concatenate([landmarks, world_T_imu[None, :3, 3]])
        points = points @ turn.T + delta[:3 * n + 3].reshape(n + 1, 3) @ J.T
        return se3.pose(turn @ world_T_imu[:3, :3], points[-1]), points[:-1]

    def pose_difference(self, true_world_T_imu, world_T_imu):
        """x with T_true = exp(x^) T."""
        return se3.log(true_world_T_imu @ se3.inverse(world_T_imu))

    def landmark_difference(self, true_world_T_imu, world_T_imu, true_landmarks, landmarks):
        """x_m, from the definition above."""
        x_R = self.pose_difference(true_world_T_imu, world_T_imu)[3:]
        rest = true_landmarks - landmarks @ se3.so3_exp(x_R).T
        return rest @ se3.so3_left_jacobian_inverse(x_R).T

    def world_landmark(self, landmarks):
        """C = [0, -m^]. To first order m - m_hat = x_m - m^ x_R: what an ellipse on a map needs."""
        hat = se3.so3_hat(landmarks)
        return np.concatenate([np.zeros_like(hat), -hat], axis=-1)

    def world_pose(self, world_T_imu):
        """p - p_hat = x_p - p^ x_R, the rotation is told in the world frame already."""
        C = np.eye(6)
        C[:3, 3:] = -se3.so3_hat(world_T_imu[:3, 3])
        return C
