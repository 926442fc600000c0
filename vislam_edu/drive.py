"""`Drive`: one recording of a vehicle with an IMU and a stereo camera.

A drive holds what was measured (body twists and the pixels of tracked landmarks), the calibration, and the truth where
there is one. It is not a filter's state and knows nothing about estimation. `recordings` reads and writes it.

A landmark is in view in a dozen of a thousand frames, so the dense (4, M, T) array of the course's files is
almost empty (dataset 10: 1.3 GB). Inside, only what was seen is kept: one row per observation, by frame.

>>> from vislam_edu import load
>>> drive = load("first_steps")
>>> drive.n_frames, drive.n_landmarks, drive.observed(0)[1].shape
(60, 42, (14, 4))
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import se3
from .stereo import StereoCamera

if TYPE_CHECKING:
    from .inertial import ImuSamples


class DriveError(ValueError):
    """A recording that cannot be used; the message names the field, where in it, and what is wrong."""


@dataclass(frozen=True, eq=False)
class Drive:
    """One recording, validated and read-only; T frames, M landmarks, N observations.

    times           (T,) s, increasing; any start
    twists          (T, 6) raw IMU samples [v, omega] in the IMU frame, m/s and rad/s
    camera          calibration
    frame_start     (T+1,) rows frame_start[k]:frame_start[k+1] of the next two belong to frame k
    landmark        (N,) which landmark, in [0, M), ascending within a frame
    pixels          (N, 4) [u_left, v_left, u_right, v_right], px
    n_landmarks     M
    imu_sample      which sample drives the step from k to k+1: "k", "k+1" or "mean" of both
    truth_world_T_cam   (T, 4, 4) left camera poses in any world frame, NaN where there is none; or None
    truth_landmarks     (M, 3) m in that same world frame, NaN where there is none; or None
    left_T_cam      (4, 4) rectified left camera in the frame of the left camera as it was mounted, or None: the same
    history         what has been done to the recording, oldest first
    imu             samples of an accelerometer and a gyro at their own rate, in the same clock; or None

    A track has no gaps: once a landmark is out of view it never returns.
    Raises DriveError (a ValueError) when a field breaks any of this.
    """

    times: np.ndarray
    twists: np.ndarray
    camera: StereoCamera
    frame_start: np.ndarray
    landmark: np.ndarray
    pixels: np.ndarray
    n_landmarks: int
    name: str = ""
    source: str = ""
    imu_sample: str = "k"
    truth_world_T_cam: np.ndarray | None = None
    truth_landmarks: np.ndarray | None = None
    left_T_cam: np.ndarray | None = None
    history: tuple[str, ...] = ()
    imu: ImuSamples | None = None

    def __post_init__(self) -> None:
        for field in ("times", "twists", "pixels", "truth_world_T_cam", "truth_landmarks", "left_T_cam"):
            self._freeze(field, float)
        for field in ("frame_start", "landmark"):
            self._freeze(field, int)
        object.__setattr__(self, "history", tuple(self.history))
        if not isinstance(self.camera, StereoCamera):
            raise DriveError(f"camera: {type(self.camera).__name__}, expected a StereoCamera")
        _check_imu(self)
        _check_observations(self)
        _check_truth(self)

    def _freeze(self, field: str, dtype: type) -> None:
        value = getattr(self, field)
        if value is None and field.startswith(("truth", "left")):
            return
        try:
            if dtype is int and not (np.less(np.abs(np.asarray(value, float)), 2.0**53).all()
                                         and np.array_equal(value, np.round(value))):  # a cast would hide it
                raise ValueError("expected whole numbers")
            value = np.array(value, dtype=dtype)
        except (TypeError, ValueError) as error:
            raise DriveError(f"{field}: {error}") from None
        value.flags.writeable = False
        object.__setattr__(self, field, value)

    @property
    def n_frames(self) -> int:
        return len(self.times)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return float(self.times[-1] - self.times[0])

    @property
    def taus(self) -> np.ndarray:
        """(T-1,) s, `tau_k = t_{k+1} - t_k`."""
        return np.diff(self.times)

    @property
    def step_twists(self) -> np.ndarray:
        """(T-1, 6) twist taken for the step from frame k to k+1, by `imu_sample`."""
        before, after = self.twists[:-1], self.twists[1:]
        return {"k": before, "k+1": after, "mean": (before + after) / 2}[self.imu_sample]

    def observed(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Landmarks in view in frame k: ids (n,), ascending, and pixels (n, 4)."""
        if not 0 <= k < self.n_frames:
            raise IndexError(f"frame {k} of a drive with frames 0 to {self.n_frames - 1}")
        rows = slice(self.frame_start[k], self.frame_start[k + 1])
        return self.landmark[rows], self.pixels[rows]

    @property
    def features(self) -> np.ndarray:
        """Dense (4, M, T) array, NaN where not seen: 32 M T bytes, so for small drives only."""
        dense = np.full((4, self.n_landmarks, self.n_frames), np.nan)
        dense[:, self.landmark, self.frame] = self.pixels.T
        return dense

    @cached_property
    def frame(self) -> np.ndarray:
        """(N,) frame of each observation."""
        return np.repeat(np.arange(self.n_frames), self.visible)

    @property
    def visible(self) -> np.ndarray:
        """(T,) number of landmarks in view."""
        return np.diff(self.frame_start)

    @cached_property
    def first_seen(self) -> np.ndarray:
        """(M,) frame in which each landmark is first seen, -1 when never."""
        first = np.full(self.n_landmarks, -1)
        first[self.landmark[::-1]] = self.frame[::-1]  # of several writes to one place the last one stays
        return first

    @cached_property
    def last_seen(self) -> np.ndarray:
        """(M,) frame in which each landmark is last seen, -1 when never."""
        last = np.full(self.n_landmarks, -1)
        last[self.landmark] = self.frame
        return last

    @property
    def has_truth(self) -> bool:
        """Whether the true pose of some frame is known."""
        return self.truth_world_T_cam is not None and bool(np.isfinite(self.truth_world_T_cam[:, 0, 0]).any())

    @property
    def has_true_landmarks(self) -> bool:
        """Whether true landmarks are known, in a world whose place is known too."""
        return self.has_truth and self.truth_landmarks is not None

    @cached_property
    def true_world_T_imu(self) -> np.ndarray:
        """(T, 4, 4) true IMU poses, NaN in frames whose pose is unknown; the world is the IMU frame at frame 0.

        Where frame 0 has no truth, the world is the IMU frame at the first frame that has. With an accelerometer it is
        the world of the truth, which has z up.
        Raises DriveError where no true pose is known; `has_truth` asks.
        """
        return self._world_T_truth_world @ self.truth_world_T_cam @ self.camera.cam_T_imu

    @cached_property
    def true_landmarks(self) -> np.ndarray:
        """(M, 3) true landmarks, m, in the same world as `true_world_T_imu`.

        Raises DriveError where none are known; `has_true_landmarks` asks.
        """
        if self.truth_landmarks is None:
            raise DriveError(f"{self.name or 'this drive'} has no true landmarks (truth_landmarks is None)")
        return se3.transform(self._world_T_truth_world, self.truth_landmarks)

    @cached_property
    def _world_T_truth_world(self) -> np.ndarray:
        if self.truth_world_T_cam is None or not self.has_truth:
            raise DriveError(f"{self.name or 'this drive'} has no ground truth: no true pose of any frame is known")
        if self.imu is not None:
            return np.eye(4)
        first = np.flatnonzero(np.isfinite(self.truth_world_T_cam[:, 0, 0]))[0]
        return se3.inverse(self.truth_world_T_cam[first] @ self.camera.cam_T_imu)

    def replace(self, **fields: Any) -> Drive:
        """A validated copy with these fields changed."""
        return dataclasses.replace(self, **fields)

    def with_extrinsics(self, cam_T_imu: np.ndarray) -> Drive:
        """A copy whose camera sits elsewhere on the body. cam_T_imu : (4, 4)."""
        return self.replace(camera=dataclasses.replace(self.camera, cam_T_imu=cam_T_imu))

    def apply(self, cure: Any) -> Drive:
        """The drive after a cure (`cures`), a function from a drive to a drive with a `name`; the history says so."""
        return cure(self).replace(history=(*self.history, cure.name))

    def slice(self, start: int, stop: int | None = None) -> Drive:
        """Frames start to stop (excluded), counted as Python does; landmarks never seen there are dropped."""
        start, stop, _ = slice(start, stop).indices(self.n_frames)
        if start >= stop:
            raise DriveError(f"slice: no frame from {start} to {stop} in a drive of {self.n_frames} frames")
        first, end = self.frame_start[[start, stop]]
        truth = self.truth_world_T_cam
        part = self.replace(times=self.times[start:stop], twists=self.twists[start:stop],
                            frame_start=self.frame_start[start:stop + 1] - first,
                            landmark=self.landmark[first:end], pixels=self.pixels[first:end],
                            truth_world_T_cam=None if truth is None else truth[start:stop])
        return part.keep_landmarks(part.first_seen >= 0)

    def subsample(self, every: int = 10) -> Drive:
        """Every `every`-th landmark only (the report, section 4, keeps one in ten)."""
        if every != int(every) or every < 1:
            raise ValueError(f"every: {every}, expected a whole number of at least 1")
        return self.keep_landmarks(np.arange(self.n_landmarks) % int(every) == 0)

    def keep_landmarks(self, mask: np.ndarray) -> Drive:
        """Only the landmarks where mask (M,) is True, renumbered without gaps in their old order."""
        mask = _mask(mask, self.n_landmarks, "landmarks")
        rows = mask[self.landmark]
        truth = None if self.truth_landmarks is None else self.truth_landmarks[mask]
        return self.replace(frame_start=np.concatenate([[0], np.cumsum(rows)])[self.frame_start],
                            landmark=(np.cumsum(mask) - 1)[self.landmark[rows]], pixels=self.pixels[rows],
                            n_landmarks=int(mask.sum()), truth_landmarks=truth)

    def keep_observations(self, mask: np.ndarray) -> Drive:
        """Only the observations where mask (N,) is True; landmarks left without any are dropped.

        Raises DriveError when that would tear a gap into a track.
        """
        mask = _mask(mask, len(self.landmark), "observations")
        part = self.replace(frame_start=np.concatenate([[0], np.cumsum(mask)])[self.frame_start],
                            landmark=self.landmark[mask], pixels=self.pixels[mask])
        return part.keep_landmarks(part.first_seen >= 0)


def _mask(mask: np.ndarray, size: int, what: str) -> np.ndarray:
    mask = np.asarray(mask)
    if mask.dtype != bool or mask.shape != (size,):
        raise ValueError(f"mask: {mask.dtype} of shape {mask.shape}, expected bool ({size},), "
                         f"one for each of the {what}")
    return mask


# --- what a recording must be: each check relies on what an earlier one has found right ---------------------

LARGEST = {"times": 1e12, "twists": 1e4, "pixels": 1e7, "K": 1e6, "baseline": 1e3, "cam_T_imu": 1e3,
           "truth_world_T_cam": 1e9, "truth_landmarks": 1e9}  # far beyond any car, camera or clock: s, m/s, px, m
SHORTEST, SMALLEST = 1e-9, 1e-6  # s between frames; m, px of baseline and focal length: divided by, they overflow


def _check_shape(name: str, value: np.ndarray, shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise DriveError(f"{name}: shape {value.shape}, expected {shape}")


def _check_finite(name: str, value: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(value))
    if bad.size:
        raise DriveError(f"{name}: {value[tuple(bad[0])]} at index {tuple(bad[0].tolist())}, "
                         f"expected finite numbers only")


def _check_magnitude(name: str, value: np.ndarray | float) -> None:
    """Absolute values that no car has, and whose products overflow."""
    largest = np.nanmax(np.abs(value), initial=0.0)
    if largest > LARGEST[name]:
        raise DriveError(f"{name}: {largest:.3g}, expected absolute values up to {LARGEST[name]:g}")


def _check_imu(drive: Drive) -> None:
    """Times, IMU samples and calibration. Raises DriveError."""
    times = drive.times
    if times.ndim != 1:
        raise DriveError(f"times: shape {times.shape}, expected (T,)")
    if not times.size:
        raise DriveError("times: the recording is empty, it has no frame")
    _check_finite("times", times)
    stuck = np.flatnonzero(np.diff(times) < SHORTEST)
    if stuck.size:
        k = stuck[0]
        raise DriveError(f"times: do not increase, frame {k} is at {times[k]} s "
                         f"and frame {k + 1} at {times[k + 1]} s; expected steps of at least {SHORTEST:g} s")
    _check_shape("twists", drive.twists, (times.size, 6))
    _check_finite("twists", drive.twists)
    if drive.imu_sample not in ("k", "k+1", "mean"):
        raise DriveError(f"imu_sample: {drive.imu_sample!r}, expected 'k', 'k+1' or 'mean'")
    for name in ("times", "twists"):
        _check_magnitude(name, getattr(drive, name))
    for name in ("K", "baseline", "cam_T_imu"):
        _check_magnitude(name, getattr(drive.camera, name))
    for name, value in (("baseline", drive.camera.baseline), ("K", np.diag(drive.camera.K).min())):
        if value < SMALLEST:
            raise DriveError(f"{name}: {value:.3g}, expected at least {SMALLEST:g}")


def _check_observations(drive: Drive) -> None:
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


def _check_truth(drive: Drive) -> None:
    """True poses and landmarks, where there are any. Raises DriveError."""
    poses, landmarks = drive.truth_world_T_cam, drive.truth_landmarks
    if poses is not None:
        _check_shape("truth_world_T_cam", poses, (drive.n_frames, 4, 4))
        known = np.isfinite(poses).all(axis=(1, 2))
        broken = np.flatnonzero(~known & ~np.isnan(poses).all(axis=(1, 2)))
        if broken.size:
            raise DriveError(f"truth_world_T_cam: frame {broken[0]} is neither a pose nor all NaN")
        R = poses[known, :3, :3]
        rigid = se3.is_rotation(R, 1e-6)
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
