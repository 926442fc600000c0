"""What a recording must be before it can be a `Drive`: each field's shape and values, and how the fields fit together.

The checks run in their order here, as a camera and then a `Drive` is made; a later one relies on what an earlier one
has found right.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .drive import Drive


class DriveError(ValueError):
    """A recording that cannot be used; the message names the field, where in it, and what is wrong."""


def _check_shape(name: str, value: np.ndarray, shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise DriveError(f"{name}: shape {value.shape}, expected {shape}")


def _check_finite(name: str, value: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(value))
    if bad.size:
        raise DriveError(f"{name}: {value[tuple(bad[0])]} at index {tuple(bad[0].tolist())}, "
                         f"expected finite numbers only")


LARGEST = {"times": 1e12, "twists": 1e4, "pixels": 1e7, "K": 1e6, "baseline": 1e3, "cam_T_imu": 1e3,
           "truth_world_T_cam": 1e9, "truth_landmarks": 1e9}  # far beyond any car, camera or clock: s, m/s, px, m


def _check_magnitude(name: str, value: np.ndarray | float) -> None:
    """Absolute values that no car has, and whose products overflow."""
    largest = np.nanmax(np.abs(value), initial=0.0)
    if largest > LARGEST[name]:
        raise DriveError(f"{name}: {largest:.3g}, expected absolute values up to {LARGEST[name]:g}")


def check_calibration(K: np.ndarray) -> None:
    """K of a camera. Raises ValueError."""
    if K.shape != (3, 3):
        raise ValueError(f"K must have shape (3, 3), got {K.shape}")
    fu, fv = K[0, 0], K[1, 1]
    pattern = np.array([[fu, 0.0, K[0, 2]], [0.0, fv, K[1, 2]], [0.0, 0.0, 1.0]])
    if not (np.isfinite(K).all() and fu > 0.0 and fv > 0.0 and np.array_equal(K, pattern)):
        raise ValueError(
            "K must be [[f_u, 0, c_u], [0, f_v, c_v], [0, 0, 1]] with positive focal lengths, "
            f"got {K.tolist()}"
        )


def check_extrinsics(T: np.ndarray) -> None:
    """cam_T_imu, a rigid motion. Raises ValueError."""
    if T.shape != (4, 4):
        raise ValueError(f"cam_T_imu must have shape (4, 4), got {T.shape}")
    if not np.isfinite(T).all():
        raise ValueError(f"cam_T_imu must be finite, got {T.tolist()}")
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"cam_T_imu must end with the row [0, 0, 0, 1], got {T[3].tolist()}: is it transposed?")
    R = T[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(R.T @ R - np.eye(3)).max()
    if not off <= 1e-5:
        raise ValueError(f"cam_T_imu must hold a rotation; it is off orthonormal by {off:.1e} (1e-5 allowed)")
    if np.linalg.det(R) < 0.0:
        raise ValueError("cam_T_imu must hold a rotation, but mirrors (determinant -1): one axis is flipped")


def check_imu(drive: Drive) -> None:
    """Times, IMU samples and calibration. Raises DriveError."""
    times = drive.times
    if times.ndim != 1:
        raise DriveError(f"times: shape {times.shape}, expected (T,)")
    if not times.size:
        raise DriveError("times: the recording is empty, it has no frame")
    _check_finite("times", times)
    stuck = np.flatnonzero(np.diff(times) <= 0)
    if stuck.size:
        k = stuck[0]
        raise DriveError(f"times: do not increase, frame {k} is at {times[k]} s "
                         f"and frame {k + 1} at {times[k + 1]} s")
    _check_shape("twists", drive.twists, (times.size, 6))
    _check_finite("twists", drive.twists)
    if drive.imu_sample not in ("k", "k+1", "mean"):
        raise DriveError(f"imu_sample: {drive.imu_sample!r}, expected 'k', 'k+1' or 'mean'")
    for name in ("times", "twists"):
        _check_magnitude(name, getattr(drive, name))
    for name in ("K", "baseline", "cam_T_imu"):
        _check_magnitude(name, getattr(drive.camera, name))


def check_observations(drive: Drive) -> None:
    """What is seen in which frame, and that no track has a gap. Raises DriveError."""
    start, landmark = drive.frame_start, drive.landmark
    _check_shape("frame_start", start, (drive.n_frames + 1,))
    if landmark.ndim != 1:
        raise DriveError(f"landmark: shape {landmark.shape}, expected (N,)")
    _check_shape("pixels", drive.pixels, (landmark.size, 4))
    _check_finite("pixels", drive.pixels)
    _check_magnitude("pixels", drive.pixels)
    if start[0] != 0 or start[-1] != landmark.size or (np.diff(start) < 0).any():
        raise DriveError(f"frame_start: must rise from 0 to the {landmark.size} observations, never falling")
    outside = np.flatnonzero((landmark < 0) | (landmark >= drive.n_landmarks))
    if outside.size:
        raise DriveError(f"landmark: {landmark[outside[0]]} at index {outside[0]}, "
                         f"expected 0 to {drive.n_landmarks - 1}")
    disorder = np.flatnonzero((np.diff(landmark) <= 0) & (np.diff(drive.frame) == 0))
    if disorder.size:
        raise DriveError(f"landmark: not ascending in frame {drive.frame[disorder[0]]}, index {disorder[0]}")
    length = drive.last_seen - drive.first_seen + 1
    torn = np.flatnonzero((drive.first_seen >= 0) & (np.bincount(landmark, minlength=length.size) != length))
    if torn.size:
        seen = drive.frame[landmark == torn[0]]
        gap = np.flatnonzero(np.diff(seen) > 1)[0]
        raise DriveError(f"features: landmark {torn[0]} is seen in frame {seen[gap]}, then not, and again in "
                         f"frame {seen[gap + 1]}; a track that comes back must be a new landmark")


def check_truth(drive: Drive) -> None:
    """True poses and landmarks, where there are any. Raises DriveError."""
    poses, landmarks = drive.truth_world_T_cam, drive.truth_landmarks
    if poses is not None:
        _check_shape("truth_world_T_cam", poses, (drive.n_frames, 4, 4))
        known = np.isfinite(poses).all(axis=(1, 2))
        broken = np.flatnonzero(~known & ~np.isnan(poses).all(axis=(1, 2)))
        if broken.size:
            raise DriveError(f"truth_world_T_cam: frame {broken[0]} is neither a pose nor all NaN")
        R = poses[known, :3, :3]
        rigid = (np.abs(R @ R.mT - np.eye(3)).max(axis=(1, 2)) < 1e-6) & (np.linalg.det(R) > 0)
        rigid &= (np.abs(poses[known, 3] - [0, 0, 0, 1]) < 1e-9).all(axis=1)
        if not rigid.all():
            bad = np.flatnonzero(known)[~rigid][0]
            raise DriveError(f"truth_world_T_cam: frame {bad} is not a rigid motion")
        _check_magnitude("truth_world_T_cam", poses)
    if landmarks is not None:
        if poses is None:
            raise DriveError("truth_landmarks: given without truth_world_T_cam, so their world is unknown")
        _check_shape("truth_landmarks", landmarks, (drive.n_landmarks, 3))
        if np.isinf(landmarks).any():
            bad = np.argwhere(np.isinf(landmarks))[0, 0]
            raise DriveError(f"truth_landmarks: landmark {bad} is at infinity")
        _check_magnitude("truth_landmarks", landmarks)
