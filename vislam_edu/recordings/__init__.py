"""Recordings on disk: every layout the course has published, the package's own, and ground truth.

Here lives what turns bytes into a validated `Drive` and back, without running anything that a file contains, and the
one way in which the package writes files (whole or not at all). What a recording means is not known here.
"""

from .layouts import find, load, load_ground_truth, load_imu, save, save_kitti, save_tum

__all__ = ["find", "load", "load_ground_truth", "load_imu", "save", "save_kitti", "save_tum"]
