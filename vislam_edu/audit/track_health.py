"""How healthy the tracks of a recording are, by the pixels alone: copies, impossible disparities, lengths."""

import numpy as np

from . import visual_odometry

_MIN_COMMON = 3  # tracks; one or two may agree by chance where pixels are whole numbers
_IMPOSSIBLE = 5.0  # standard deviations below zero


def copy_steps(drive) -> np.ndarray:
    """(T-1,) bool: steps k -> k+1 in which every common track has exactly the same four coordinates at both ends.

    Frame k + 1 is then a copy frame: the tracker copied its old pixels instead of looking. (A car that stands still
    before a noise-free camera looks the same.)
    """
    step, before, after = visual_odometry.pairs(drive)
    same = (drive.pixels[before] == drive.pixels[after]).all(axis=1)
    common = np.bincount(step, minlength=drive.n_frames - 1)
    return (common >= _MIN_COMMON) & (np.bincount(step, same, minlength=drive.n_frames - 1) == common)


def copied(drive) -> np.ndarray:
    """(N,) bool: observations that are copies of the frame before (`copy_steps`)."""
    step, _, after = visual_odometry.pairs(drive)
    return np.isin(np.arange(len(drive.landmark)), after[copy_steps(drive)[step]])


def frozen(drive) -> np.ndarray:
    """(N,) bool: observations with exactly the pixels of the frame before, although other tracks moved."""
    _, before, after = visual_odometry.pairs(drive)
    same = (drive.pixels[before] == drive.pixels[after]).all(axis=1)
    return np.isin(np.arange(len(drive.landmark)), after[same]) & ~copied(drive)


def disparity(drive) -> np.ndarray:
    """(N,) u_left - u_right, px."""
    return drive.pixels[:, 0] - drive.pixels[:, 2]


def behind_infinity(drive) -> np.ndarray:
    """(N,) bool: disparities below zero by more than five standard deviations of the noise that the rows show."""
    sigma = visual_odometry.row_noise(drive.pixels)
    return disparity(drive) < -max(_IMPOSSIBLE * 2**0.5 * sigma, 1e-6)


def lengths(drive) -> np.ndarray:
    """(M,) frames each track is seen in."""
    return np.bincount(drive.landmark, minlength=drive.n_landmarks)
