"""Cameras as they are, distorted and turned against each other, and the rectified pair that the filters work with.

Points are rectified, images never are: a tracker follows points in the images as they were taken.

Source: Fusiello, Trucco, Verri, A compact algorithm for rectification of stereo pairs (2000).

>>> import numpy as np
>>> lens = Lens(np.array([[450.0, 0, 370], [0, 450, 250], [0, 0, 1]]), (-0.28, 0.07, 0.0002, 0.00002))
>>> lens.rectify(lens.unrectify(np.array([700.0, 20.0]), lens.K), lens.K).round(3).tolist()
[700.0, 20.0]
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from . import se3
from .stereo import StereoCamera, bearing


@dataclass(frozen=True, eq=False)
class Lens:
    """One camera as it is: its own K (3, 3) px, its distortion, and how it is turned against the rectified camera.

    distortion : (4,), k1, k2, p1, p2, radial-tangential (OpenCV's, EuRoC's). rectified_R_cam : (3, 3).
    """

    K: np.ndarray
    distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0)
    rectified_R_cam: np.ndarray = field(default_factory=lambda: np.eye(3))

    def distorted(self, xy: np.ndarray) -> np.ndarray:
        """Points at depth one (..., 2) as the lens shows them. Source: Brown, Decentering distortion (1966)."""
        k1, k2, p1, p2 = np.asarray(self.distortion, float)
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = r2 * (k1 + k2 * r2)
        return xy + np.stack([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                              y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=-1)

    def rectify(self, points: np.ndarray, K: np.ndarray) -> np.ndarray:
        """Pixels of this camera (..., 2) as pixels of the rectified one, whose matrix is K."""
        seen = bearing(self.K, points)[..., :2]
        xy = seen
        for _ in range(20 if np.any(self.distortion) else 0):  # a fixed point: it changes slowly over the image
            xy = xy - (self.distorted(xy) - seen)
        ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1) @ self.rectified_R_cam.T
        return ray[..., :2] / ray[..., 2:] * np.diag(K)[:2] + K[:2, 2]

    def unrectify(self, pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
        """Pixels of the rectified camera (..., 2) as pixels of this one: the inverse of `rectify`, in closed form."""
        ray = bearing(K, pixels) @ self.rectified_R_cam
        return self.distorted(ray[..., :2] / ray[..., 2:]) * np.diag(self.K)[:2] + self.K[:2, 2]


@dataclass(frozen=True, eq=False)
class Rig:
    """Two lenses and the rectified pair that they are measured in. left, right : `Lens`. camera : `StereoCamera`."""

    left: Lens
    right: Lens
    camera: StereoCamera

    def measurements(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Pixels of both cameras, (n, 2) each, as rectified measurements (n, 4): u_left, v_left, u_right, v_right."""
        K = self.camera.K
        return np.concatenate([self.left.rectify(left, K), self.right.rectify(right, K)], axis=-1)


def rectified(K_left: np.ndarray, K_right: np.ndarray, left_T_right: np.ndarray, cam_T_imu: np.ndarray,
              distortion_left: ArrayLike = (0, 0, 0, 0), distortion_right: ArrayLike = (0, 0, 0, 0)) -> Rig:
    """The rig whose rectified cameras look the same way: x along the baseline, z near both cameras' own, one K.

    K_left, K_right (3, 3) px; left_T_right, cam_T_imu (4, 4), of the left camera before it is rectified. The new z axis
    is the mean of both, made orthogonal to x; the new K is the mean of both, with one focal length.
    """
    x = left_T_right[:3, 3] / np.linalg.norm(left_T_right[:3, 3])
    y = np.cross(left_T_right[:3, 2] + [0, 0, 1], x)
    y /= np.linalg.norm(y)
    rectified_R_left = np.stack([x, y, np.cross(x, y)])
    K = np.array((K_left + K_right) / 2)
    K[0, 0] = K[1, 1] = (K[0, 0] + K[1, 1]) / 2
    turn = se3.pose(rectified_R_left, np.zeros(3))
    camera = StereoCamera(K, float(np.linalg.norm(left_T_right[:3, 3])), turn @ cam_T_imu)
    return Rig(Lens(K_left, distortion_left, rectified_R_left),
               Lens(K_right, distortion_right, rectified_R_left @ left_T_right[:3, :3]), camera)
