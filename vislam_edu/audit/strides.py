"""Slow drives: from frame to frame the tracks move by hardly more than their noise, over a stride of frames they do."""

import numpy as np

from .. import se3
from ..drive import Drive

ENOUGH = 10.0  # times the pixel noise, median motion of the tracks over a step that is to be compared with the IMU
_LEAST_STEPS, _LEAST_LOOKS = 60, 3  # that are left of the drive and of the median track


def stride(drive: Drive, motions) -> int:
    """Over how many frames the tracks move enough. motions : the drive's `visual_odometry.FrameMotions`."""
    flow = np.linalg.norm((drive.pixels[motions.after] - drive.pixels[motions.before])[:, :2], axis=1)
    if not len(flow):
        return 1
    wanted = np.ceil(ENOUGH * motions.sigma_px / max(np.median(flow), 1e-9))
    length = np.median(drive.last_seen - drive.first_seen + 1)
    return int(np.clip(min(wanted, drive.n_frames // _LEAST_STEPS, length // _LEAST_LOOKS), 1, None))


def thin(drive: Drive, every: int) -> Drive:
    """Every so many frames of a drive, its IMU samples the constant twists that lead from one to the next."""
    if every == 1:
        return drive
    poses = se3.chain(np.eye(4), se3.exp(drive.step_twists * drive.taus[:, None]))
    kept, times, seen = poses[::every], drive.times[::every], drive.frame % every == 0
    twists = se3.log(se3.inverse(kept[:-1]) @ kept[1:]) / np.diff(times)[:, None]
    return Drive(times=times, twists=np.vstack([twists, twists[-1:]]), camera=drive.camera, imu_sample="k",
                 frame_start=np.r_[0, np.cumsum(drive.visible[::every])], landmark=drive.landmark[seen],
                 pixels=drive.pixels[seen], n_landmarks=drive.n_landmarks)
