"""The stereo camera: from points to pixels and back, and how both react to a small change.

A rectified pair of pinhole cameras. A pixel measurement is `[u_left, v_left, u_right, v_right]`, px, shape (..., 4);
points in the camera frame are those of the left camera (x right, y down, z forward), m. The right camera sits
`baseline` metres along x. There is no lens distortion here: the pixels of a recording must be rectified.

v_left and v_right share one model, so the four rows of a measurement carry three numbers.

Points that no camera can see (at or behind the image plane, disparity not positive, NaN) come back as a False
in a mask beside a finite placeholder, `PLACEHOLDER`: a point one metre along the optical axis.

Source: report section 3.2.

>>> from vislam_edu import load
>>> camera = load("first_steps").camera
>>> camera.triangulate(camera.project([1.0, 0.5, 10.0])[0])[0].round(6).tolist()
[1.0, 0.5, 10.0]
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from . import se3
from .se3 import checked

PLACEHOLDER = np.array([0.0, 0.0, 1.0])
PLACEHOLDER.setflags(write=False)

# v_left and v_right of a rectified pair measure the same number. Their mean carries all that they say about the state
# and has half the variance; their difference is pure noise, of no use but to the gate. So four rows become three.
ROWS = [0, 1, 2]  # of a Jacobian with four rows: u_left, v, u_right
ROW_VARIANCE = np.array([1.0, 0.5, 1.0])  # in units of sigma_px^2
FOUR_FROM_THREE = [0, 1, 2, 1]

_MIN_DEPTH = 0.1  # m; nothing on the road comes nearer, and a Jacobian grows with 1 / depth squared
_MIN_DISPARITY = 1e-9  # px; far below what any tracker resolves, far enough from zero that no depth overflows
_MIN_PARALLAX = 1e-9  # rad; two bearings that differ by less are parallel to rounding


def reduce_rows(pixels: np.ndarray) -> np.ndarray:
    """(..., 4) stereo measurements to the (..., 3) numbers [u_left, mean v, u_right] that carry information, px."""
    return np.stack([pixels[..., 0], (pixels[..., 1] + pixels[..., 3]) / 2, pixels[..., 2]], axis=-1)


def pi(q: np.ndarray) -> np.ndarray:
    """Projection `q / q_3` of homogeneous coordinates. q (..., 4), its depth q_3 not zero; returns (..., 4).

    Source: report section 3.2.2.
    """
    q = checked(q, (4,), "q")
    return q / q[..., 2:3]


def dpi_dq(q: np.ndarray) -> np.ndarray:
    """Derivative of `pi`. q (..., 4) with q_3 not zero; returns (..., 4, 4). Source: report section 3.2.2."""
    q = checked(q, (4,), "q")
    per_depth = 1.0 / q[..., 2]
    derivative = np.zeros(q.shape + (4,))
    for row in (0, 1, 3):
        derivative[..., row, row] = per_depth
        derivative[..., row, 2] = -q[..., row] * per_depth**2
    return derivative


def bearing(K: ArrayLike, uv: ArrayLike) -> np.ndarray:
    """Bearing `K^-1 [u, v, 1]`: the direction to a pixel, scaled to depth one.

    K (3, 3) px; uv (..., 2) px, of one camera. Returns (..., 3), in that camera's frame.
    """
    K, uv = checked(K, (3, 3), "K"), checked(uv, (2,), "uv")
    homogeneous = np.concatenate([uv, np.ones(uv.shape[:-1] + (1,))], axis=-1)
    return np.matvec(np.linalg.inv(K), homogeneous)


def triangulate_bearings(z1: ArrayLike, z2: ArrayLike, R: ArrayLike, p: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Point seen along two bearings from two cameras in general position: the report's closed form.

    z1, z2 : (..., 3), bearings `K^-1 [u, v, 1]` (third entry 1) in camera 1 and in camera 2.
    R, p : (..., 3, 3) and (..., 3) m, the pose of camera 2 in the frame of camera 1.
    Returns (points, ok): points (..., 3), m, in the frame of camera 1, and ok (...), which is False where the
    bearings are parallel or meet behind either camera.

    With depths l1 and l2, `l1 R^T z1 - R^T p = l2 z2`. The third row gives l2; put into the others it leaves
    `l1 a = b`, solved by least squares as `l1 = a^T b / a^T a`. The point lies on the first bearing: the
    second one decides the depth only.

    For a rectified pair (R = I, p = [baseline, 0, 0]) this is the disparity form, `StereoCamera.triangulate`,
    exactly when v_left == v_right. A vertical disparity dv shortens the depth here, by 1 / (1 + (dv/du)^2) in
    units of the focal lengths, whereas `triangulate` leaves the depth and averages the rows.
    Source: report section 3.2.1.
    """
    z1, seen1 = _finite(checked(z1, (3,), "z1"))
    z2, seen2 = _finite(checked(z2, (3,), "z2"))
    R, p = checked(R, (3, 3), "R"), checked(p, (3,), "p")
    Rt = np.swapaxes(R, -1, -2)
    z1_in_2, p_in_2 = np.matvec(Rt, z1), np.matvec(Rt, p)
    a = z1_in_2 - z1_in_2[..., 2:] * z2
    b = p_in_2 - p_in_2[..., 2:] * z2
    aa = np.sum(a * a, axis=-1)
    apart = aa > _MIN_PARALLAX**2
    depth1 = np.sum(a * b, axis=-1) / np.where(apart, aa, 1.0)
    depth2 = depth1 * z1_in_2[..., 2] - p_in_2[..., 2]
    ok = seen1 & seen2 & apart & (depth1 > _MIN_DEPTH) & (depth2 > _MIN_DEPTH)
    return np.where(ok[..., None], depth1[..., None] * z1, PLACEHOLDER), ok


def second_order(predicted: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """How far the mean of the pixels lies from the pixels of the mean, for an uncertain point: tr(h'' C) / 2.

    predicted (..., 4), px: the pixels of the mean. explained (..., 3, 3), px^2: the covariance of [u_left, v, u_right]
    that the uncertainty C of the point makes, to first order. Returns (..., 4), px.

    For u_left the term is f / z^2 (x / z C_zz - C_xz), C in the camera frame. To first order the depth changes by
    -z / d per pixel of disparity d, so for every row it is the row's covariance with the disparity, divided by d.
    Source: Bar-Shalom, Li, Kirubarajan, section 10.3.2 (the second-order EKF's predicted measurement).
    """
    disparity = predicted[..., 0] - predicted[..., 2]
    with_disparity = explained[..., 0, :] - explained[..., 2, :]
    return with_disparity[..., FOUR_FROM_THREE] / disparity[..., None]


def check_calibration(K: np.ndarray) -> None:
    """K of a camera. Raises ValueError."""
    if K.shape != (3, 3):
        raise ValueError(f"K must have shape (3, 3), got {K.shape}")
    fu, fv = K[0, 0], K[1, 1]
    pattern = np.array([[fu, 0.0, K[0, 2]], [0.0, fv, K[1, 2]], [0.0, 0.0, 1.0]])
    if not (np.isfinite(K).all() and fu > 0.0 and fv > 0.0 and np.array_equal(K, pattern)):
        raise ValueError("K must be [[f_u, 0, c_u], [0, f_v, c_v], [0, 0, 1]] with positive focal lengths, "
                         f"got {K.tolist()}")


def check_extrinsics(T: np.ndarray) -> None:
    """cam_T_imu, a rigid motion. Raises ValueError."""
    if T.shape != (4, 4):
        raise ValueError(f"cam_T_imu must have shape (4, 4), got {T.shape}")
    if not np.isfinite(T).all():
        raise ValueError(f"cam_T_imu must be finite, got {T.tolist()}")
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"cam_T_imu must end with the row [0, 0, 0, 1], got {T[3].tolist()}: is it transposed?")
    R = T[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(R.T @ R - np.eye(3)).max()
    if not off <= 1e-5:
        raise ValueError(f"cam_T_imu must hold a rotation; it is off orthonormal by {off:.1e} (1e-5 allowed)")
    if np.linalg.det(R) < 0.0:
        raise ValueError("cam_T_imu must hold a rotation, but mirrors (determinant -1): one axis is flipped")


@dataclass(frozen=True, eq=False)
class StereoCamera:
    """A rectified stereo pair and where it sits on the body.

    K : (3, 3), px, of both cameras, `[[f_u, 0, c_u], [0, f_v, c_v], [0, 0, 1]]`.
    baseline : m, from the left camera to the right one.
    cam_T_imu : (4, 4), maps IMU coordinates to the left camera.

    Raises ValueError that names the field and what is wrong with it. The arrays are copies and read-only.
    """

    K: np.ndarray
    baseline: float
    cam_T_imu: np.ndarray

    def __post_init__(self) -> None:
        K, cam_T_imu = _read_only(self.K, "K"), _read_only(self.cam_T_imu, "cam_T_imu")
        baseline = _read_only(self.baseline, "baseline")
        check_calibration(K)
        if not (baseline.size == 1 and np.isfinite(baseline).all() and (baseline > 0.0).all()):
            raise ValueError(f"baseline must be one positive length in metres, got {self.baseline}")
        check_extrinsics(cam_T_imu)
        for field, value in (("K", K), ("baseline", baseline.item()), ("cam_T_imu", cam_T_imu)):
            object.__setattr__(self, field, value)

    @cached_property
    def imu_T_cam(self) -> np.ndarray:
        """Pose of the left camera in the IMU frame, (4, 4), read-only."""
        return _read_only(se3.inverse(self.cam_T_imu), "imu_T_cam")

    @cached_property
    def K_s(self) -> np.ndarray:
        """Stereo calibration matrix (4, 4), read-only: `pixels = K_s @ pi(q)`. Source: report 3.2.2."""
        (fu, _, cu), (_, fv, cv), _ = self.K
        rows = [[fu, 0, cu, 0], [0, fv, cv, 0], [fu, 0, cu, -fu * self.baseline], [0, fv, cv, 0]]
        return _read_only(rows, "K_s")

    @cached_property
    def inverse_depth_of_pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """A (3, 4) and offset (3,), read-only: (a, b, rho) = A pixels + offset, the point is (a, b, 1) / rho.

        a = (u_left - c_u) / f_u, b = (v - c_v) / f_v with the mean v of both rows, rho = (u_left - u_right) / (f_u b).
        """
        (fu, _, cu), (_, fv, cv), _ = self.K
        per_disparity = 1 / (fu * self.baseline)
        A = [[1 / fu, 0, 0, 0], [0, 0.5 / fv, 0, 0.5 / fv], [per_disparity, 0, -per_disparity, 0]]
        return _read_only(A, "A"), _read_only([-cu / fu, -cv / fv, 0], "offset")

    # Frames

    def to_cam(self, world_T_imu: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        """World to camera frame. world_T_imu (..., 4, 4), landmarks (..., 3), m; returns (..., 3), m."""
        return se3.transform(self.cam_T_imu @ se3.inverse(world_T_imu), landmarks)

    def to_world(self, world_T_imu: np.ndarray, points_cam: np.ndarray) -> np.ndarray:
        """Camera to world frame. world_T_imu (..., 4, 4), points_cam (..., 3), m; returns (..., 3), m."""
        return se3.transform(checked(world_T_imu, (4, 4), "world_T_imu") @ self.imu_T_cam, points_cam)

    # Points to pixels

    def project(self, points_cam: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Pixels of points in the camera frame: `K_s pi(q)`.

        points_cam (..., 3), m. Returns (pixels, in_front): pixels (..., 4), px, always finite, and in_front
        (...), False where the point is not in front of the camera and the pixels are those of `PLACEHOLDER`.
        Pixels may lie outside the image: the camera does not know its size.
        """
        q, in_front = _homogeneous(points_cam)
        return np.matvec(self.K_s, pi(q)), in_front

    def project_homogeneous(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `project`, of points (..., 4) [x, y, z, rho] at [x, y, z] / rho, 1/m; rho may be zero or negative."""
        q, in_front = _seen(checked(q, (4,), "q"))
        return np.matvec(self.K_s, pi(q)), in_front

    def homogeneous_jacobian(self, q: np.ndarray) -> np.ndarray:
        """Derivative (..., 4, 4) of the pixels by q (..., 4) of `project_homogeneous`: `K_s dpi/dq`."""
        return self.K_s @ dpi_dq(_seen(q)[0])

    def projection_jacobian(self, points_cam: np.ndarray) -> np.ndarray:
        """Derivative of the pixels by the homogeneous point, `K_s dpi/dq`.

        points_cam (..., 3), m, in the camera frame. Returns (..., 4, 4); the first three columns are px/m.
        This Jacobian and those below are finite everywhere, but where `project` says that a point is not in
        front they belong to `PLACEHOLDER` and must not be used.
        """
        q, _ = _homogeneous(points_cam)
        return self.K_s @ dpi_dq(q)

    def measurement_jacobian(self, points_cam: np.ndarray) -> np.ndarray:
        """Derivative of the pixels by the point in the IMU frame: `J = K_s dpi/dq cam_T_imu P^T`.

        points_cam (..., 3), m, in the camera frame, where the derivative is taken. Returns (..., 4, 3), px/m.
        """
        return self.projection_jacobian(points_cam) @ self.cam_T_imu[:, :3]

    # The observation model h(T, m)

    def observe(self, world_T_imu: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation model `h(T, m) = K_s pi(cam_T_imu T^-1 m)`.

        world_T_imu (..., 4, 4); landmarks (..., 3), m, world frame. Returns (pixels, in_front) as `project` does.
        Source: report section 3.2.2, with T^-1 of the same time where it writes T_{t-1}.
        """
        return self.project(self.to_cam(world_T_imu, landmarks))

    def landmark_jacobian(self, world_T_imu: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        """Derivative of `observe` by the landmark, `J R^T`: (..., 4, 3), px/m. Arguments as for `observe`.

        Source: report section 3.2.2, with the inverse pose where it writes T_{t-1}.
        """
        J = self.measurement_jacobian(self.to_cam(world_T_imu, landmarks))
        Rt = np.swapaxes(np.asarray(world_T_imu)[..., :3, :3], -1, -2)
        return J @ Rt

    def pose_jacobian(self, world_T_imu: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        """Derivative of `observe` by the right perturbation eps of `T exp(eps^)`, at eps = 0.

        `-K_s dpi/dq cam_T_imu odot(s)` with s = T^-1 m, which is `-J [I, -s^]`. Arguments as for `observe`.
        Returns (..., 4, 6), px per [m, rad], columns ordered [v, omega]. Source: report section 3.3.1.
        """
        s = se3.transform(se3.inverse(world_T_imu), landmarks)
        J = self.projection_jacobian(se3.transform(self.cam_T_imu, s)) @ self.cam_T_imu
        return -J @ se3.odot(s)

    # Pixels to points

    def triangulate(self, pixels: np.ndarray, min_disparity: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Point of a pixel measurement, from the disparity `d = u_left - u_right`: depth `f_u baseline / d`.

        pixels (..., 4), px. Returns (points_cam, ok): points_cam (..., 3), m, in the camera frame, always finite, and
        ok (...), False where d <= min_disparity (px) or a pixel is NaN; the point is then `PLACEHOLDER`.

        This is the maximum likelihood point for equal noise on all four pixels: u_left and u_right fix x and
        z, and the mean of v_left and v_right fixes y. Without noise it inverts `project`.
        """
        pixels, seen = _finite(checked(pixels, (4,), "pixels"))
        u_left, v_left, u_right, v_right = np.moveaxis(pixels, -1, 0)
        disparity = u_left - u_right
        ok = seen & (disparity > max(min_disparity, _MIN_DISPARITY))
        depth = self.K[0, 0] * self.baseline / np.where(ok, disparity, 1.0)
        rays = bearing(self.K, np.stack([u_left, 0.5 * (v_left + v_right)], axis=-1))
        return np.where(ok[..., None], depth[..., None] * rays, PLACEHOLDER), ok

    def triangulation_covariance(self, points_cam: np.ndarray, sigma_px: float) -> np.ndarray:
        """Covariance of a triangulated point, `(H^T V^-1 H)^-1` with V = sigma_px^2 I, to first order.

        points_cam (..., 3), m, in the camera frame, in front of it; sigma_px > 0, px, of each coordinate.
        Returns (..., 3, 3), m^2, in the camera frame. The depth entry grows with depth to the fourth power.
        """
        if not sigma_px > 0.0:
            raise ValueError(f"sigma_px must be positive, got {sigma_px}")
        H = self.projection_jacobian(points_cam)[..., :3]
        return sigma_px**2 * np.linalg.inv(np.swapaxes(H, -1, -2) @ H)


def _homogeneous(points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Homogeneous coordinates (..., 4) of points (..., 3), placeholders where not in front, and the mask."""
    points = checked(points, (3,), "points")
    return _seen(np.concatenate([points, np.ones(points.shape[:-1] + (1,))], axis=-1))


def _seen(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Homogeneous points (..., 4) with placeholders where not in front, and the mask (...)."""
    in_front = np.isfinite(q).all(axis=-1) & (q[..., 2] > _MIN_DEPTH * np.maximum(q[..., 3], _MIN_DEPTH))
    return np.where(in_front[..., None], q, np.append(PLACEHOLDER, 1.0)), in_front


def _finite(values) -> tuple[np.ndarray, np.ndarray]:
    """Values (..., n) with zeros where a row holds NaN or infinity, and the mask (...) of finite rows."""
    finite = np.isfinite(values).all(axis=-1)
    return np.where(finite[..., None], values, 0.0), finite


def _read_only(value: ArrayLike, name: str) -> np.ndarray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}") from error
    array.setflags(write=False)
    return array
