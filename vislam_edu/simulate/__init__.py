"""Drives with ground truth: a road, the sensors of a car on it, and faults planted in what they measure.

Here lives everything that makes a `Drive` instead of reading one. Nothing here estimates.
"""

from .drives import *  # noqa: F403 (each file's __all__ says what stands here too)
from .inertial import *  # noqa: F403
