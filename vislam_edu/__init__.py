"""Visual-inertial SLAM with an extended Kalman filter, written to be read. `vislam_edu.course` stands on it.

Conventions, the same in every file and every notebook:

poses           `world_T_imu` (4, 4) maps IMU coordinates to world coordinates; `a_T_b @ b_T_c = a_T_c`
frames          world; imu (body: x forward, y left, z up); cam (left optical: x right, y down, z forward)
extrinsics      `cam_T_imu`, whichever way a file stores it
twist           `[v, omega]`, translation first, m/s and rad/s, shape (..., 6)
pixels          `[u_left, v_left, u_right, v_right]`, px
not seen        NaN inside the package, -1 in files
perturbation    right, `T = T_mean exp(epsilon^)`, unless a name says `invariant`
noise           `sigma_v` m/s and `sigma_omega` rad/s per IMU sample (so W = tau^2 diag(...)), `sigma_px` px
joint state     landmarks first, then pose: covariance (3n+6, 3n+6)
arrays          everything broadcasts over leading axes

The names to import from here, in the order of the notebooks:

load                    a recording as a `Drive`, by path or by the name of an embedded one
Drive                   one recording: IMU samples, tracked landmarks, calibration, truth
Noise                   W, V and Sigma_0
StereoCamera            projection, triangulation, Jacobians
RightPerturbation       the report's error of a pose and a map
RightInvariant          the error that cannot observe what no sensor measures
InverseDepth            the same, with landmarks whose error is Gaussian at any distance
se3                     SO(3) and SE(3): exp, log, adjoint, Jacobians
stereo                  the camera model
noise                   standard deviations and covariances of the sensors
drive                   recordings in memory
belief                  what a filter believes and what it saw: Belief, Innovation, Step
kalman                  the Gaussian algebra of a Kalman filter
odometry                the pose: from the IMU alone, and on a known map
mapping                 the map on known poses
ekf_slam                the joint filter, plain
inverse_depth           the joint filter with landmarks of inverse depth, plain
metrics                 ATE, KITTI drift, NIS, NEES
error_state             what an error is
motion                  the joint belief, and how it moves
window_slam             the joint filter over the landmarks in view, fast
robust                  weights and slipping landmarks for real tracks
smoother                the final estimate of every landmark
normal_equations        least squares by blocks: what `batch` solves
batch                   the whole drive at once: least squares over poses and landmarks
association             which landmarks are the same place, and closing the loop
imu                     a real IMU: gravity, biases, preintegration
inertial                the joint filter with a real IMU
inertial_batch          the whole drive at once with a real IMU
lens                    distorted cameras, and the rectified pair
tracking                from images to tracks
recordings              room: files
simulate                room: drives with ground truth
plots                   room: still pictures
audit                   room: a recording's sensors compared with each other
studies                 room: filters over whole drives
widgets                 room: explorer and panels

A name is loaded when it is first used, so importing the package costs nothing and changes nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .drive import Drive
    from .error_state import InverseDepth, RightInvariant, RightPerturbation
    from .noise import Noise
    from .recordings import load
    from .stereo import StereoCamera

__version__ = "0.3.0"
__all__ = [
    "Drive", "InverseDepth", "Noise", "RightInvariant", "RightPerturbation", "StereoCamera", "association", "audit",
    "batch", "belief", "drive", "ekf_slam", "error_state", "imu", "inertial", "inertial_batch", "inverse_depth",
    "kalman", "lens", "load", "mapping", "metrics", "motion", "noise", "normal_equations", "odometry", "plots",
    "recordings", "robust", "se3", "simulate", "smoother", "stereo", "studies", "tracking", "widgets", "window_slam"]

_DEFINED_IN = {"load": "recordings", "Drive": "drive", "Noise": "noise", "StereoCamera": "stereo",
               "RightPerturbation": "error_state", "RightInvariant": "error_state", "InverseDepth": "error_state"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _DEFINED_IN:
        return getattr(import_module(f".{_DEFINED_IN[name]}", __name__), name)
    return import_module(f".{name}", __name__)


def __dir__() -> list[str]:
    return __all__
