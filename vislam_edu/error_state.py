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
from typing import Any

import numpy as np

from . import se3, stereo
from .belief import FARTHEST, Belief, homogeneous
from .stereo import StereoCamera

Pair = tuple[np.ndarray, np.ndarray]
Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


class ErrorState(ABC):
    """Interface that every error state implements. Errors in m and rad, but for landmarks of inverse depth.

    points : n landmarks as `Belief.points` holds them, (n, *point_shape); `WorldPoints` are (n, 3), m, world frame.
    role : key of `plots.style.COLOURS` that such a filter is drawn with.
    landmark_rows, pose_rows : names of the three rows of a landmark and of the six of the pose.
    iterated : whether a frame is worth a second linearisation, at the step that the cameras say was made.
    """

    name: str
    role = "slam"
    iterated = False
    point_shape: tuple[int, ...] = (3,)
    landmark_rows = ("x", "y", "z")
    pose_rows = ("forward", "left", "up", "roll", "pitch", "yaw")

    @abstractmethod
    def pose_transition(self, after: np.ndarray, increment: np.ndarray, body_noise: np.ndarray) -> Pair:
        """How an error of the pose, and of the twist, becomes an error one step later.

        after : (4, 4) world_T_imu at the end of the step. increment : (4, 4), exp(tau u^), the step itself.
        body_noise : (6, 6), tau J_r(tau u), twist error to pose error in the body frame at the end of the step.
        Returns F (6, 6) and B (6, 6): pose error' = F pose error + B (error of the twist).
        """

    @abstractmethod
    def landmark_transition(self, points: np.ndarray, B: np.ndarray) -> np.ndarray:
        """(n, 3, 6): error of the twist to error of each landmark; zeros where it moves none."""

    @abstractmethod
    def measure(self, camera: StereoCamera, world_T_imu: np.ndarray, points: np.ndarray) -> Triple:
        """Where the camera sees each landmark, and how an error changes its pixels [u_left, v, u_right].

        Returns q (n, 4), homogeneous in the camera frame, as `StereoCamera.project_homogeneous` takes it, and H in two
        parts, (n, 3, 3) px per error of the landmark and (n, 3, 6) px per error of the pose.
        """

    @abstractmethod
    def mean_shift(self, predicted: np.ndarray, explained: np.ndarray) -> np.ndarray:
        """(n, 4) px: how far the mean of the pixels lies from the pixels of the mean; see `stereo.second_order`."""

    @abstractmethod
    def triangulate(self, camera: StereoCamera, world_T_imu: np.ndarray, pixels: np.ndarray, sigma_px: float,
                    min_disparity: float) -> Triple:
        """New landmarks from pixels (n, 4): points (n, ...), their own covariances (n, 3, 3), and ok (n,) bool.

        sigma_px : px. min_disparity : px. The covariance is that of the pixels alone, for a known pose. Where not ok,
        a landmark has to wait, and its numbers mean nothing.
        """

    @abstractmethod
    def inherited(self, world_T_imu: np.ndarray, points: np.ndarray) -> np.ndarray:
        """G (n, 3, 6): what the error of a new landmark takes over from the error of the pose that saw it."""

    @abstractmethod
    def retract(self, world_T_imu: np.ndarray, points: np.ndarray, delta: np.ndarray) -> Pair:
        """The state, pose (4, 4) and points, after an error delta (3n+6,) has been estimated."""

    @abstractmethod
    def shifted(self, points: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """The points after a shift (n, 3) of y, see `world_landmark`."""

    @abstractmethod
    def pose_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
        """(..., 6): the error of a pose when the truth is known."""

    @abstractmethod
    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            points: np.ndarray) -> np.ndarray:
        """(n, 3): the error of each landmark when the truth is known; true_landmarks : (n, 3), m, world."""

    @abstractmethod
    def world_landmark(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 6): C with  y - y_hat = landmark error + C (pose error), y in coordinates that stand still.

        For `WorldPoints` these are metres in the world frame.
        """

    @abstractmethod
    def metres(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 3): D with  m - m_hat = D (y - y_hat), metres in the world frame, to first order."""

    @abstractmethod
    def world_pose(self, world_T_imu: np.ndarray) -> np.ndarray:
        """(6, 6): pose error to [p - p_hat, rotation vector] in the world frame, to first order."""


class WorldPoints(ErrorState):
    """An error state whose landmarks are points of the world, m; `jacobians` and `birth` say what differs."""

    @abstractmethod
    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray, J: np.ndarray) -> Pair:
        """How an error changes what the cameras measure: H of a measurement of each landmark, in two parts.

        J : (n, m, 3), derivative of the m numbers by the point in the IMU frame. landmarks : (n, 3).
        Returns (n, m, 3) for the landmark and (n, m, 6) for the pose.
        """

    @abstractmethod
    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> Pair:
        """What a new landmark inherits: its error = G (pose error) + A (error of its triangulation in the IMU frame).

        points_imu : (n, 3). Returns G (n, 3, 6) and A (3, 3).
        """

    def measure(self, camera: StereoCamera, world_T_imu: np.ndarray, points: np.ndarray) -> Triple:
        """`jacobians` with the J of the camera; see `ErrorState.measure`."""
        points_cam = camera.to_cam(world_T_imu, points)
        J = camera.measurement_jacobian(points_cam)[:, stereo.ROWS]
        q = np.concatenate([points_cam, np.ones((len(points), 1))], axis=-1)
        return q, *self.jacobians(world_T_imu, points, J)

    def mean_shift(self, predicted: np.ndarray, explained: np.ndarray) -> np.ndarray:
        """Pixels are a curved function of the point: `stereo.second_order`."""
        return stereo.second_order(predicted, explained)

    def triangulate(self, camera: StereoCamera, world_T_imu: np.ndarray, pixels: np.ndarray, sigma_px: float,
                    min_disparity: float) -> Triple:
        """Points (n, 3), m, of a disparity above min_disparity, and A C A^T, C in the IMU frame."""
        points_cam, ok = camera.triangulate(pixels, min_disparity)
        A = self.birth(world_T_imu, se3.transform(camera.imu_T_cam, points_cam))[1] @ camera.imu_T_cam[:3, :3]
        C = A @ camera.triangulation_covariance(points_cam, sigma_px) @ A.T
        return camera.to_world(world_T_imu, points_cam), (C + C.mT) / 2, ok

    def inherited(self, world_T_imu: np.ndarray, points: np.ndarray) -> np.ndarray:
        """G of `birth`."""
        return self.birth(world_T_imu, se3.transform(se3.inverse(world_T_imu), points))[0]

    def shifted(self, points: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """The sum."""
        return points + shift

    def metres(self, points: np.ndarray) -> np.ndarray:
        """The identity."""
        return np.broadcast_to(np.eye(3), (len(points), 3, 3))


class RightPerturbation(WorldPoints):
    """The report's error: T = T_hat exp(epsilon^) in the body frame, m = m_hat + delta in the world frame.

    Source: report section 3.3.1; Barfoot, State Estimation for Robotics, chapter 8.
    """

    name = "right perturbation"

    def pose_transition(self, after: np.ndarray, increment: np.ndarray, body_noise: np.ndarray) -> Pair:
        """F = exp(-tau u_curly); B is the body's own noise. Source: report section 3.3.1."""
        return se3.adjoint(se3.inverse(increment)), body_noise

    def landmark_transition(self, landmarks: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Zeros: the motion of the car changes no landmark error."""
        return np.zeros((len(landmarks), 3, 6))

    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray, J: np.ndarray) -> Pair:
        """J R^T  and  -J [I, -s^],  s (n, 3) the points in the IMU frame.

        Source: report section 3.3.1 (the circled-dot form).
        """
        s = se3.transform(se3.inverse(world_T_imu), landmarks)
        return J @ world_T_imu[:3, :3].T, np.concatenate([-J, J @ se3.so3_hat(s)], axis=-1)

    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> Pair:
        """G = R [I, -s^] and A = R,  s (n, 3) the points in the IMU frame."""
        R = world_T_imu[:3, :3]
        n = len(points_imu)
        return np.concatenate([np.broadcast_to(R, (n, 3, 3)), -R @ se3.so3_hat(points_imu)], axis=-1), R

    def retract(self, world_T_imu: np.ndarray, landmarks: np.ndarray, delta: np.ndarray) -> Pair:
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


class InvariantPose(ErrorState):
    """The pose's part of the right-invariant error: R = exp(x_R) R_hat,  p = exp(x_R) p_hat + J_l(x_R) x_p."""

    role = "invariant"
    pose_rows = ("x_p x", "x_p y", "x_p z", "x_R x", "x_R y", "x_R z")

    def pose_transition(self, after: np.ndarray, increment: np.ndarray, body_noise: np.ndarray) -> Pair:
        """F = I, whatever the car does; an error of the twist enters through the adjoint of the pose."""
        return np.eye(6), se3.adjoint(after) @ body_noise

    def pose_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
        """x with T_true = exp(x^) T."""
        return se3.log(true_world_T_imu @ se3.inverse(world_T_imu))

    def world_pose(self, world_T_imu: np.ndarray) -> np.ndarray:
        """p - p_hat = x_p - p^ x_R; the rotation error is already in world coordinates."""
        C = np.eye(6)
        C[:3, 3:] = -se3.so3_hat(world_T_imu[:3, 3])
        return C


class RightInvariant(InvariantPose, WorldPoints):
    """The right-invariant error: one rotation x_R of the whole world, about the world's origin.

    R = exp(x_R) R_hat,  p = exp(x_R) p_hat + J_l(x_R) x_p,  m = exp(x_R) m_hat + J_l(x_R) x_m

    Position and landmarks turn together, so an error that no sensor can measure (a turn or a shift of car and map
    as one) has the same coordinates at every estimate: a change of the estimate cannot pass for information.
    Source: Barrau, Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015; Zhang et al., Convergence and
    consistency analysis for a 3-D invariant-EKF SLAM, 2017.
    """

    name = "right-invariant"
    landmark_rows = ("x_m x", "x_m y", "x_m z")

    def landmark_transition(self, landmarks: np.ndarray, B: np.ndarray) -> np.ndarray:
        """m^ B_R. The landmark stands still, but its error is expressed relative to the turned world."""
        return se3.so3_hat(landmarks) @ B[3:]

    def jacobians(self, world_T_imu: np.ndarray, landmarks: np.ndarray, J: np.ndarray) -> Pair:
        """J R^T on the landmark and [-J R^T, 0] on the pose: rotation has dropped out."""
        H = J @ world_T_imu[:3, :3].T
        return H, np.concatenate([-H, np.zeros_like(H)], axis=-1)

    def birth(self, world_T_imu: np.ndarray, points_imu: np.ndarray) -> Pair:
        """G = [I, 0]: a new landmark inherits the position error as it is. A = R."""
        n = len(points_imu)
        return np.broadcast_to(np.eye(3, 6), (n, 3, 6)), world_T_imu[:3, :3]

    def retract(self, world_T_imu: np.ndarray, landmarks: np.ndarray, delta: np.ndarray) -> Pair:
        """The exponential of SE_{1+n}(3): one rotation, and its left Jacobian on every translation."""
        n = len(landmarks)
        x_R = delta[3 * n + 3:]
        turn, J = se3.so3_exp(x_R), se3.so3_left_jacobian(x_R)
        # The pose is one more point of this group: p turns and shifts exactly as a landmark does.
        points = np.concatenate([landmarks, world_T_imu[None, :3, 3]])
        points = points @ turn.T + delta[:3 * n + 3].reshape(n + 1, 3) @ J.T
        return se3.pose(turn @ world_T_imu[:3, :3], points[-1]), points[:-1]

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


class InverseDepth(InvariantPose):
    """Relative inverse depth: y = (a, b, rho) in the camera that saw the landmark first, and that camera's pose.

    A point is (n, 3, 5): the chart [R_c, C], (3, 4), world_T_cam of that camera as now estimated, and y. The landmark
    stands in the direction (a, b, 1) of the chart at inverse depth rho, 1/m, which may be zero or negative: the world
    point is M / rho with M = R_c (a, b, 1) + rho C. Errors: that of the pose as in `RightInvariant`,

    [R_c, C] = exp(x^) [R_c, C]_hat,  y = y_hat + eta

    so that eta is relative to the pose: pixels depend on eta alone, neither a shift nor a turn of everything can be
    learnt. y is linear in the pixels of the first view: it is born Gaussian, whatever the disparity, and uncorrelated.
    Source: Civera, Davison, Montiel, Inverse depth parametrization for monocular SLAM, 2008, for (a, b, rho).
    """

    name = "relative inverse depth, right-invariant"
    iterated = True  # a step moves the chart of every landmark, and y is a curved function of that
    point_shape = (3, 5)
    landmark_rows = ("a", "b", "ρ")

    def landmark_transition(self, points: np.ndarray, B: np.ndarray) -> np.ndarray:
        """E (M^ B_R - rho B_p): the landmark stands still while its chart moves with the error of the pose."""
        M, rho = homogeneous(points)
        return _rho_inverse_D(points) @ (se3.so3_hat(M) @ B[3:] - rho[:, None, None] * B[:3])

    def measure(self, camera: StereoCamera, world_T_imu: np.ndarray, points: np.ndarray) -> Triple:
        """H of the pose is zero, all six columns. Nothing is divided by rho."""
        cam_T_world = camera.cam_T_imu @ se3.inverse(world_T_imu)
        chart, y = cam_T_world[:3, :3] @ points[..., :4], points[..., 4]
        chart[..., 3] += cam_T_world[:3, 3]
        q_of_y = np.zeros((len(points), 4, 3))
        q_of_y[:, :3], q_of_y[:, 3, 2] = chart[..., [0, 1, 3]], 1
        q = np.matvec(q_of_y, y)
        q[:, :3] += chart[..., 2]
        H = camera.homogeneous_jacobian(q)[:, stereo.ROWS] @ q_of_y
        return q, H, np.zeros((len(points), 3, 6))

    def mean_shift(self, predicted: np.ndarray, explained: np.ndarray) -> np.ndarray:
        """Zeros: stereo pixels are linear in y where it was born, and nearly so later."""
        return np.zeros_like(predicted)

    def triangulate(self, camera: StereoCamera, world_T_imu: np.ndarray, pixels: np.ndarray, sigma_px: float,
                    min_disparity: float) -> Triple:
        """y of the pixels, every landmark at once: min_disparity is not used."""
        A, offset = camera.inverse_depth_of_pixels
        points = np.empty((len(pixels), 3, 5))
        points[..., :4], points[..., 4] = (world_T_imu @ camera.imu_T_cam)[:3], pixels @ A.T + offset
        covariance = np.broadcast_to(sigma_px**2 * A @ A.T, (len(pixels), 3, 3))
        return points, covariance, np.ones(len(pixels), dtype=bool)

    def inherited(self, world_T_imu: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Zeros: motion makes the correlation, not birth."""
        return np.zeros((len(points), 3, 6))

    def retract(self, world_T_imu: np.ndarray, points: np.ndarray, delta: np.ndarray) -> Pair:
        """Pose and charts move by exp(x^), y by eta."""
        n = len(points)
        move, moved = se3.exp(delta[3 * n:]), self.shifted(points, delta[:3 * n].reshape(n, 3))
        moved[..., :4] = move[:3, :3] @ moved[..., :4]
        moved[..., 3] += move[:3, 3]
        return move @ world_T_imu, moved

    def shifted(self, points: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """y + shift, charts as they are."""
        moved = points.copy()
        moved[..., 4] += shift
        return moved

    def landmark_difference(self, true_world_T_imu: np.ndarray, world_T_imu: np.ndarray, true_landmarks: np.ndarray,
                            points: np.ndarray) -> np.ndarray:
        """eta, from the definition above: y of the true landmark in the true chart, minus y."""
        move = true_world_T_imu @ se3.inverse(world_T_imu)
        in_chart = np.matvec(points[..., :3].mT, se3.transform(se3.inverse(move), true_landmarks) - points[..., 3])
        return np.append(in_chart[:, :2], np.ones((len(points), 1)), axis=1) / in_chart[:, 2:] - points[..., 4]

    def world_landmark(self, points: np.ndarray) -> np.ndarray:
        """C = E [rho I, -M^]: y in a chart that stands still."""
        M, rho = homogeneous(points)
        shift = np.multiply.outer(rho, np.eye(3))
        return _rho_inverse_D(points) @ np.concatenate([shift, -se3.so3_hat(M)], axis=-1)

    def metres(self, points: np.ndarray) -> np.ndarray:
        """D = R_c d/dy (a, b, 1) / rho, with rho at least 1 / `FARTHEST`."""
        depth = 1 / np.maximum(points[:, 2, 4], 1 / FARTHEST)
        D = np.zeros((len(points), 3, 3))
        D[:, 0, 0] = D[:, 1, 1] = depth
        D[:, :2, 2], D[:, 2, 2] = -points[:, :2, 4] * depth[:, None] ** 2, -depth**2
        return points[..., :3] @ D


def fitting(belief: Any) -> ErrorState:
    """`InverseDepth()` for a belief whose landmarks have charts, else `RightPerturbation()`, the report's."""
    return InverseDepth() if np.ndim(getattr(belief, "points", 0)) == 3 else RightPerturbation()


def _rho_inverse_D(points: np.ndarray) -> np.ndarray:
    """E (n, 3, 3) with D^-1 = rho E: the derivative of y by the position of the landmark, divided by rho."""
    E = np.zeros((len(points), 3, 3))
    E[:, 0, 0] = E[:, 1, 1] = 1
    E[:, :, 2] = -points[..., 4]
    return E @ points[..., :3].mT


def world_landmark_covariance(belief: Belief, error_state: ErrorState) -> np.ndarray:
    """(n, 3, 3) m^2: covariance of each landmark's position in the world, whatever the filter calls an error.

    With m - m_hat = D (x_m + C x_pose) it is D (P_mm + C P_pm + P_mp C^T + C P_pp C^T) D^T.
    """
    P, C, D = belief.landmark_covariance, error_state.world_landmark(belief.points), error_state.metres(belief.points)
    if C.any():
        cross = belief.covariance[:3 * len(belief.ids), belief.pose].reshape(-1, 3, 6) @ C.mT
        P = P + cross + cross.mT + C @ belief.pose_covariance @ C.mT
    return D @ P @ D.mT


def to_right(error_state: ErrorState, world_T_imu: np.ndarray) -> np.ndarray:
    """(6, 6): an error of the pose to the right perturbation that moves it as far, to first order."""
    return RightPerturbation().world_pose(world_T_imu).T @ error_state.world_pose(world_T_imu)  # two rotations: .T


def right_pose_covariance(belief: Belief, error_state: ErrorState) -> np.ndarray:
    """(6, 6) covariance of the pose as a right perturbation T exp(epsilon^), to first order."""
    to = to_right(error_state, belief.world_T_imu)
    return to @ belief.pose_covariance @ to.T
