"""Where the two cameras of the course's newest recordings sit, and their pixels as those of parallel cameras.

`extL_T_imu` and `extR_T_imu` are read in four ways by those who use the files. The numbers decide: the right camera
must sit on the +x axis of the left one's optical frame; where several readings put it there, the one counts by which
the IMU explains best how the tracks move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import lens, se3
from ..drive import Drive, DriveError
from ..stereo import StereoCamera

# a_T_b maps b coordinates to a. regular: x forward, y left, z up; optical: x right, y down, z forward.
READINGS = ("imu_T_regular", "optical_T_imu", "imu_T_optical", "regular_T_imu")  # those met most often first
REGULAR_T_OPTICAL = se3.pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))

_OFF_AXIS = 0.2  # of the baseline; what the right camera may lie off the left one's x axis
_TURNED = np.radians(8.0)  # between the two cameras
_STRIDE = 0.3  # s over which tracks are followed, so that a slow robot's motion shows beside the pixels' noise
_LOOKS, _MIN_PAIRS = 200, 50  # strides looked at; fewer pairs of observations than this tell nothing


def mounted(drive: Drive, K_right: np.ndarray, left: np.ndarray, right: np.ndarray, forced: str | None = None) -> Drive:
    """The drive with both cameras where the extrinsics put them, its pixels rectified where they are not yet.

    drive : with the left camera's K; its baseline and mounting do not count. left, right : (4, 4), `extL_T_imu` and
    `extR_T_imu`. forced : one of `READINGS`; otherwise the numbers decide. `history` says what was taken and why.
    Raises DriveError where no reading, or not the one asked for, fits.
    """
    if forced is not None and forced not in READINGS:
        raise DriveError(f"extrinsics: {forced!r}, expected one of {', '.join(READINGS)}")
    made = {reading: _with_camera(drive, K_right, *cameras)
            for reading, cameras in fitting(left, right, [forced] if forced else READINGS).items()}
    errors = {reading: prediction_error(one) for reading, one in made.items()}
    best = min(made, key=lambda reading: np.nan_to_num(errors[reading][0], nan=np.inf))
    moved, still = errors[best]
    if not forced and moved > 1.5 * still:
        raise DriveError(f"extL_T_imu, extR_T_imu: read as {best}, the only way to put the right camera on the left "
                         f"one's +x axis, tracks move as if the IMU were wrong ({moved:.1f} px off in {_STRIDE} s, "
                         f"{still:.1f} px without motion); swapped cameras? --extrinsics {best} reads it all the same")
    why = ("as asked for" if forced else "the only reading with the right camera on the left one's +x axis"
           if len(made) == 1 else f"of {' and '.join(made)} the one that moves tracks best")
    if np.isfinite(moved):
        why += f"; the IMU moves tracks to within {moved:.1f} px in {_STRIDE} s, no motion to {still:.1f} px"
    drive = made[best]
    return drive.replace(history=(f"extrinsics read as {best}: {why}", *drive.history))


def fitting(left: np.ndarray, right: np.ndarray, readings: Sequence[str] = READINGS
            ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """imu_T_left and left_T_right by each reading that puts the right camera on the left one's +x axis.

    Raises DriveError where none does.
    """
    both = {}
    for reading in readings:
        imu_T_eyes = se3.inverse([left, right]) if reading.endswith("_T_imu") else np.stack([left, right])
        imu_T_left, imu_T_right = imu_T_eyes @ REGULAR_T_OPTICAL if "regular" in reading else imu_T_eyes
        both[reading] = imu_T_left, se3.inverse(imu_T_left) @ imu_T_right
    if found := {reading: pair for reading, pair in both.items() if _beside(pair[1])}:
        return found
    where = "; ".join(f"{reading}: {T[:3, 3].round(3).tolist()} m, turned by {_angle(T):.1f} degrees"
                      for reading, (_, T) in both.items())
    raise DriveError("extL_T_imu, extR_T_imu: no reading puts the right camera on the left one's +x axis and "
                     f"parallel to it ({where}); are left and right swapped?")


def prediction_error(drive: Drive) -> tuple[float, float]:
    """Median distance, px, between tracks and where the IMU moves them in 0.3 s, and the same for no motion.

    NaN where there are fewer than 50 pairs of observations.
    """
    camera, n = drive.camera, max(1, round(_STRIDE / np.median(drive.taus))) if drive.n_frames > 1 else 1
    twists = se3.exp(drive.step_twists * drive.taus[:, None])
    moved, still = [], []
    for k in np.unique(np.linspace(0, max(0, drive.n_frames - 1 - n), _LOOKS).astype(int)):
        stop = min(k + n, drive.n_frames - 1)
        (was, before), (now, after) = drive.observed(k), drive.observed(stop)
        _, i, j = np.intersect1d(was, now, assume_unique=True, return_indices=True)
        points, seen = camera.triangulate(before[i])
        imu_T_imu = se3.chain(np.eye(4), twists[k:stop])[-1]
        predicted, ahead = camera.project(se3.transform(camera.cam_T_imu @ se3.inverse(imu_T_imu) @ camera.imu_T_cam,
                                                        points))
        moved.append(np.where(ahead, np.linalg.norm(predicted - after[j], axis=-1), np.inf)[seen])
        still.append(np.linalg.norm(before[i] - after[j], axis=-1)[seen])
    if sum(map(len, still)) < _MIN_PAIRS:
        return np.nan, np.nan
    return float(np.median(np.concatenate(moved))), float(np.median(np.concatenate(still)))


def _with_camera(drive: Drive, K_right: np.ndarray, imu_T_left: np.ndarray, left_T_right: np.ndarray) -> Drive:
    """Pixels are rectified unless one K and rows that agree say that they are already."""
    K = drive.camera.K
    rig = lens.rectified(K, K_right, left_T_right, se3.inverse(imu_T_left))
    pixels = rig.measurements(drive.pixels[:, :2], drive.pixels[:, 2:])
    one_K = np.allclose(K, K_right, rtol=1e-3)
    if one_K and not _row_difference(pixels) < _row_difference(drive.pixels) / 2:
        return drive.replace(camera=StereoCamera(K, left_T_right[0, 3], se3.inverse(imu_T_left)))
    left_T_cam = se3.pose(rig.left.rectified_R_cam.T, np.zeros(3))
    said = (f"pixels rectified: cameras turned against each other by {_angle(left_T_right):.2f} degrees, "
            f"{'one K' if one_K else 'two K, now their mean'}; the left camera turned by {_angle(left_T_cam):.2f}")
    return drive.replace(camera=rig.camera, pixels=pixels, left_T_cam=left_T_cam, history=(*drive.history, said))


def _beside(left_T_right: np.ndarray) -> bool:
    baseline, *off = left_T_right[:3, 3]
    return baseline > 0 and np.hypot(*off) <= _OFF_AXIS * baseline and _angle(left_T_right) <= np.degrees(_TURNED)


def _angle(T: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(se3.so3_log(T[:3, :3]))))


def _row_difference(pixels: np.ndarray) -> float:
    return float(np.median(np.abs(pixels[:, 1] - pixels[:, 3])))
