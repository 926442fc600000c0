"""Drives with ground truth: a road, the sensors of a car on it, and faults planted in what they measure.

Here lives everything that makes a `Drive` instead of reading one. Nothing here estimates.
"""

from .drives import (
                     IMAGE_SIZE,
                     add_noise,
                     along,
                     first_steps,
                     kitti_camera,
                     perfect_street_loop,
                     places,
                     returning_loop,
                     street_loop,
                     street_loop_data,
)
from .inertial import SmoothPath, inertial_loop, measure, perfect_samples

__all__ = ["IMAGE_SIZE", "SmoothPath", "add_noise", "along", "first_steps", "inertial_loop", "kitti_camera", "measure",
           "perfect_samples", "perfect_street_loop", "places", "returning_loop", "street_loop", "street_loop_data"]
