"""Corrections of a recording, each a small named thing: `drive.apply(cure)` does it and the history says so.

A cure that `needs_future` uses a number or a choice that was fitted to the whole drive: fine for study, but a
filter that ran while the car drove could not have had it. Ending a track where its tracker fails needs no future.
Nor does the reading of a file (which axes, which sample, which way a translation points): it is a fact about how
the file was written, true from the first frame on, and no number of it is fitted.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .. import se3
from ..drive import Drive
from . import track_health


@dataclass(frozen=True)
class Cure:
    """A named correction. name : what the history will say. needs_future : see the module. function : does it."""

    name: str
    needs_future: bool
    function: Callable[[Drive], Drive]

    def __call__(self, drive: Drive) -> Drive:
        return self.function(drive)

def end_tracks(name: str, bad: Callable[[Drive], np.ndarray]) -> Cure:
    """Every track ends before its first bad observation; bad : gives (N,) bool of a drive. name : of the cure."""
    def function(drive):
        wrong, end = bad(drive), np.full(drive.n_landmarks, drive.n_frames)
        np.minimum.at(end, drive.landmark[wrong], drive.frame[wrong])
        return drive.keep_observations(drive.frame < end[drive.landmark])

    return Cure(name, False, function)


def end_tracks_at_copies() -> Cure:
    """Every track ends before its first copy (`track_health.copy_steps`); what it says later is stale.

    Measured against the ground truth of 0027.npz: the motion from tracks before their first copy is wrong by 0.02 m a
    step, after one copy by 0.07 m, after two by 0.09 m, with 80, 72 and 32 % of the pairs agreeing. So nothing is
    restarted.
    """
    return end_tracks("tracks ended before their first copy", track_health.copied)


def drop_tracks(drive: Drive, tracks) -> Cure:
    """Leave out these tracks (m,), landmark ids of `drive`.

    Other cures renumber the landmarks, so a track is known by where and when it was first seen. Needs the future: that
    a track is wrong shows over its life.
    """
    def births(drive):  # of each landmark the time and the left pixel of its first observation
        first = np.zeros((drive.n_landmarks, 3))
        seen = np.column_stack([drive.times[drive.frame], drive.pixels[:, :2]])
        first[drive.landmark[::-1]] = seen[::-1]  # of several writes to one row the last one stays
        return list(map(tuple, first.tolist()))

    born = births(drive)
    wrong = {born[landmark] for landmark in tracks}
    return Cure(f"{len(wrong)} outlier tracks dropped", True,
                lambda drive: drive.keep_landmarks(np.array([birth not in wrong for birth in births(drive)], bool)))


def use_imu_sample(sample: str) -> Cure:
    """Let sample "k", "k+1" or their "mean" drive the step from frame k to k+1."""
    return Cure(f"IMU sample {sample} drives step k -> k+1", False, lambda drive: drive.replace(imu_sample=sample))


def shift_imu(samples: int, sample: str) -> Cure:
    """Sample k becomes what sample k + samples was (ends repeat the last one), and is then read as `sample`."""
    def function(drive):
        source = np.clip(np.arange(drive.n_frames) + samples, 0, drive.n_frames - 1)
        return drive.replace(twists=drive.twists[source], imu_sample=sample)

    return Cure(f"IMU moved by {samples:+d} samples, sample {sample} drives step k -> k+1", False, function)


def turn_imu_axes(rotation) -> Cure:
    """Right-multiply `cam_T_imu` by this rotation (3, 3) of whole axes, such as diag(1, -1, -1)."""
    turn = se3.pose(rotation, np.zeros(3))
    return Cure(f"cam_T_imu right-multiplied by {describe_axes(rotation)}", False,
                lambda drive: drive.with_extrinsics(drive.camera.cam_T_imu @ turn))


def rotate_extrinsics(imu_R_imu) -> Cure:
    """Right-multiply the rotation of `cam_T_imu` by a small fitted one (3, 3), the camera staying where it is."""
    degrees = np.degrees(np.arccos(np.clip((np.trace(imu_R_imu) - 1) / 2, -1, 1)))
    return _camera_at(f"extrinsics rotated by {degrees:.2f} deg", True, lambda camera: camera.imu_T_cam[:3, 3],
                      imu_R_imu)


def swap_translation() -> Cure:
    """The translation t of `cam_T_imu` was the camera's position in the IMU frame: the map needs -R t instead."""
    return _camera_at("translation t of cam_T_imu replaced by -R t", False, lambda camera: camera.cam_T_imu[:3, 3])


def set_lever_arm(camera_in_imu) -> Cure:
    """The left camera sits at camera_in_imu (3,), m, in the IMU frame."""
    return _camera_at(f"camera put at {np.round(camera_in_imu, 2).tolist()} m in the IMU frame", True,
                      lambda camera: camera_in_imu)


def _camera_at(name: str, needs_future: bool, position: Callable, turn=None) -> Cure:
    """The camera at a position (3,) in the IMU frame, a function of the camera; R of cam_T_imu times turn (3, 3)."""
    def function(drive):
        R = drive.camera.cam_T_imu[:3, :3] if turn is None else drive.camera.cam_T_imu[:3, :3] @ turn
        return drive.with_extrinsics(se3.pose(R, -R @ position(drive.camera)))
    return Cure(name, needs_future, function)


def divide_imu(name: str, factors: np.ndarray, needs_future: bool) -> Cure:
    """Divide the IMU samples by factors (6,)."""
    return Cure(name, needs_future, lambda drive: drive.replace(twists=drive.twists / factors))


def describe_axes(rotation) -> str:
    """A rotation of whole axes in words: "diag(1, -1, -1)", or which old axis each new one is."""
    rotation = np.round(np.asarray(rotation)).astype(int)
    if np.array_equal(rotation, np.diag(np.diag(rotation))):
        return f"diag({', '.join(map(str, np.diag(rotation)))})"
    return str(rotation.tolist())
