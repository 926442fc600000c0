"""Random poses, landmarks and covariances that the exercises of several chapters are tried on."""

import numpy as np

from ... import se3
from ...stereo import StereoCamera

K = np.array([[700.0, 0.0, 600.0], [0.0, 720.0, 180.0], [0.0, 0.0, 1.0]])  # px
BASELINE = 0.5  # m

# The optical axis (z) looks along the body's x axis, tilted a little, a metre ahead of the IMU.
_IMU_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
IMU_T_CAM = se3.pose(_IMU_R_CAM @ se3.so3_exp(np.array([0.05, -0.02, 0.03])), np.array([1.0, 0.2, 0.4]))
CAMERA = StereoCamera(K, BASELINE, se3.inverse(IMU_T_CAM))


def random_calibration(rng):
    """K (3, 3), px: focal lengths and principal point of their own."""
    f_u, f_v = rng.uniform(500.0, 900.0, size=2)
    return np.array([[f_u, 0.0, rng.uniform(500.0, 700.0)], [0.0, f_v, rng.uniform(150.0, 250.0)], [0.0, 0.0, 1.0]])


def random_camera(rng):
    """A stereo camera with calibration, baseline (m) and extrinsics of its own."""
    imu_T_cam = IMU_T_CAM @ se3.exp(0.1 * rng.normal(size=6))
    return StereoCamera(random_calibration(rng), rng.uniform(0.3, 0.8), se3.inverse(imu_T_cam))


def random_pose(rng, spread=5.0):
    """world_T_imu (4, 4), anywhere within a few metres, turned any way."""
    return se3.pose(se3.so3_exp(rng.normal(size=3)), spread * rng.normal(size=3))


def random_points_cam(rng, n):
    """(n, 3) m in front of the camera."""
    depth = rng.uniform(4.0, 15.0, size=n)
    return np.stack([depth * rng.uniform(-0.6, 0.6, n), depth * rng.uniform(-0.3, 0.3, n), depth], axis=-1)


def random_landmarks(rng, world_T_imu, n, camera=CAMERA):
    """(n, 3) m in the world, in front of the camera of that pose."""
    return camera.to_world(world_T_imu, random_points_cam(rng, n))


def random_covariance(rng, n, sigma=0.1):
    """(n, n), every variable correlated with every other; standard deviations about sigma."""
    A = rng.normal(size=(n, n))
    return sigma**2 * (A @ A.T / n + 0.1 * np.eye(n))


def perturbed(rng, world_T_imu, size=0.02):
    """The pose a little off: by about `size` metres and radians."""
    return world_T_imu @ se3.exp(size * rng.normal(size=6))
