"""Recordings on disk: every layout the course has published, the package's own, and ground truth."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .. import se3
from ..drive import LARGEST, Drive, DriveError
from ..imu import ImuNoise
from ..inertial import ImuSamples
from ..stereo import StereoCamera
from . import extrinsics as mounting
from . import files, shipped
from .features import drive_from_features, drive_from_pieces

_FORMAT = "vislam_edu drive 1"
_LARGEST_TEXT = 64 << 20  # bytes of a ground truth file: a hundred thousand poses take 25 MB


def load(name, extrinsics: str | None = None) -> Drive:
    """Read a recording, given its path, or the name of a file of `find` (with or without .npz or .npy).

    Layouts are those of data/README.md, told apart by their keys, and what `save` writes. Extrinsics are taken as their
    key says: a_T_b maps b coordinates to a coordinates. Only `extL_T_imu` and `extR_T_imu` are read in four ways, and
    the numbers decide (`extrinsics.mounted`), unless `extrinsics` names one of its `READINGS`. Rotations with only a
    few digits are projected to SO(3); pixels of cameras that are not parallel, or have two K, are rectified; a landmark
    that comes back after a gap becomes a new one. Whether the numbers agree is for `audit` to find out.
    Raises DriveError (a ValueError) naming the file, the field and what is wrong with it.
    """
    path = _resolved(name)
    with files.errors_name(path), files.open_fields(path) as fields:
        newest = "v_t" in fields or "extL_T_imu" in fields
        if extrinsics is not None and not newest:
            raise DriveError("extrinsics: can be chosen only for a file with extL_T_imu and extR_T_imu")
        if "format" in fields:
            return _own_drive(fields)
        if "cam_imgs_L" in fields:
            raise DriveError("holds images, not a recording; `vislam_edu track` makes tracks from them")
        name = {"name": path.stem, "source": f"UCSD ECE276A, {path.name}"}
        times, twists = imu_of(fields)
        if newest:
            return _pickled_layout(times, twists, fields, name, extrinsics)
        return _dense_drive(times, twists, fields, camera_of(fields), name)


def save(drive, path):
    """Write a drive, truth and history included, as a plain npz that `load` reads back bit for bit.

    The file appears complete or not at all.
    """
    camera = drive.camera
    fields = {"format": _FORMAT, "K": camera.K, "baseline": camera.baseline, "cam_T_imu": camera.cam_T_imu,
              "n_landmarks": drive.n_landmarks, "history": np.array(drive.history, dtype=str)}
    fields |= {key: getattr(drive, key) for key in (*_OWN_ARRAYS, *_OWN_TEXTS)}
    fields |= {key: getattr(drive, key) for key in _OWN_OPTIONAL if getattr(drive, key) is not None}
    if drive.imu is not None:
        fields |= {f"imu_{key}": getattr(drive.imu, key) for key in _OWN_IMU}
        fields["imu_noise"] = np.array(astuple(drive.imu.noise))
    with files.replacing(path) as file:
        np.savez_compressed(file, **fields)


def folders() -> list[Path]:
    """Where `find` looks, in this order: the package's own data/, the working directory."""
    return [shipped.ROOT / "data", Path.cwd()]


def find(name) -> Path | None:
    """The file of that name (with or without .npz or .npy) in one of `folders()`, or None."""
    candidates = (folder / f"{name}{suffix}" for folder in folders() for suffix in ("", ".npz", ".npy"))
    return next((path for path in candidates if path.is_file()), None)


def _resolved(name) -> Path:
    """The path itself where something is there, else the file of that name."""
    if (found := Path(name) if Path(name).exists() else find(name)) is None:
        raise DriveError(f"{name}: no such file, and none of that name in "
                         + ", ".join(map(str, dict.fromkeys(folders()))))
    return found


def load_ground_truth(path, drive) -> Drive:
    """The drive with the true poses of its left camera, `world_T_cam`, from a text file.

    KITTI: 12 numbers a row, the upper 3 x 4 of the pose. Row k belongs to frame k, so slice a drive after
    this, not before; there may be fewer rows than frames.
    TUM: `time x y z qx qy qz qw` a row. A frame takes the row nearest in time if it is within half a frame.
    EuRoC, TUM-VI: rows with commas, `time [ns], x, y, z, qw, qx, qy, qz` and perhaps velocity and biases (8 or 17
    numbers): poses of the IMU, from which those of the camera are made.
    Times are absolute, or count from the drive's start when absolute ones would not overlap the drive. Lines that start
    with # are skipped, frames without a row get NaN. Whether the poses can be those of this drive is for
    `audit.ground_truth_checks.doubt` to find out. Raises DriveError naming the file and the line or row.
    """
    path = Path(path)
    with files.errors_name(path):
        rows, commas = rows_of_numbers(path)
        body_T_cam = np.eye(4) if drive.left_T_cam is None else drive.left_T_cam
        if commas and rows.shape[1] in (8, 17):
            rows, body_T_cam = rows[:, [0, 1, 2, 3, 5, 6, 7, 4]] / [1e9, *[1] * 7], drive.camera.imu_T_cam
        if rows.shape[1] not in (8, 12):
            raise DriveError(f"{rows.shape[1]} numbers a row, expected 12 (KITTI), 8 (TUM), or 8 or 17 with commas "
                             "(csv of EuRoC and TUM-VI)")
        poses = (_tum_poses if rows.shape[1] == 8 else _kitti_poses)(rows, drive)
        return drive.replace(truth_world_T_cam=poses @ body_T_cam, truth_landmarks=None)


def load_imu(path, drive) -> Drive:
    """The drive with the samples of a gyro and an accelerometer from a text file in EuRoC's layout (imu0/data.csv).

    A row is `time in ns, gyro x y z in rad/s, accelerometer x y z in m/s^2`, with commas; lines that start with # are
    skipped. The times are those of the drive's clock. EuRoC's samples are values at an instant: the mean of two
    neighbours takes the place of each, as a sample here lasts until the next one.
    Raises DriveError naming the file and the line.
    """
    path = Path(path)
    with files.errors_name(path):
        rows = rows_of_numbers(path)[0]
        if rows.shape[1] != 7:
            raise DriveError(f"{rows.shape[1]} numbers a row, expected 7 (EuRoC: time in ns, gyro, accelerometer)")
        values = np.concatenate([(rows[:-1, 1:] + rows[1:, 1:]) / 2, rows[-1:, 1:]])
        return drive.replace(imu=ImuSamples(rows[:, 0] / 1e9, values[:, :3], values[:, 3:]))


def save_kitti(path, poses):
    """Write poses (T, 4, 4) as KITTI text: 12 numbers a row, the upper 3 x 4 of each."""
    _write_rows(path, _finite_poses(poses)[:, :3].reshape(-1, 12))


def save_tum(path, times, poses):
    """Write times (T,) s and poses (T, 4, 4) as TUM text: `time x y z qx qy qz qw` a row."""
    poses, times = _finite_poses(poses), np.asarray(times, dtype=float)
    if times.shape != poses.shape[:1]:
        raise ValueError(f"times: shape {times.shape}, expected ({len(poses)},) for {len(poses)} poses")
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    _write_rows(path, np.column_stack([times, poses[:, :3, 3], quaternions]), first="%.9f")


_OWN_ARRAYS = ("times", "twists", "frame_start", "landmark", "pixels")
_OWN_TEXTS = ("name", "source", "imu_sample")
_OWN_IMU = ("times", "gyro", "accelerometer")
_OWN_OPTIONAL = ("truth_world_T_cam", "truth_landmarks", "left_T_cam")


def imu_of(fields):
    """Times (T,) and twists (T, 6) of a recording in one of the course's layouts."""
    times = _times(fields, fields.key("time_stamps", "timestamps"))
    keys = ("linear_velocity", "v_t"), ("angular_velocity", "rotational_velocity", "w_t")
    return times, np.hstack([_samples(fields, fields.key(*names), len(times)) for names in keys])


def camera_of(fields):
    """The camera of a recording whose file holds one K, its pixels being rectified."""
    key = fields.key("imu_T_cam", "cam_T_imu")
    extrinsic = _rigid(key, fields.numbers(key))
    return _camera(fields.numbers("K"), fields.number(fields.key("b", "baseline")),
                   se3.inverse(extrinsic) if key == "imu_T_cam" else extrinsic)


def _pickled_layout(times, twists, fields, name, extrinsics):
    cameras = [_camera(fields.numbers(key), 1.0, np.eye(4), key) for key in ("K_l", "K_r")]
    left, right = (_rigid(key, fields.numbers(key)) for key in ("extL_T_imu", "extR_T_imu"))
    drive = _dense_drive(times, twists, fields, cameras[0], name)
    return mounting.mounted(drive, cameras[1].K, left, right, extrinsics)


def _own_drive(fields):
    if fields.text("format") != _FORMAT:
        raise DriveError(f"format: {fields.text('format')!r}, expected {_FORMAT!r}")
    camera = _camera(fields.numbers("K"), fields.number("baseline"), fields.numbers("cam_T_imu"))
    values = {key: fields.numbers(key) for key in _OWN_ARRAYS}
    values |= {key: fields.numbers(key) for key in _OWN_OPTIONAL if key in fields}
    if "left_T_cam" in values:
        _rigid("left_T_cam", values["left_T_cam"])
    values |= {key: files.shown(fields.text(key)) for key in _OWN_TEXTS}
    count = fields.number("n_landmarks")
    if not (0 <= count <= 1e7 and count == int(count)):
        raise DriveError(f"n_landmarks: {count}, expected a whole number from 0 to 10,000,000")
    values["n_landmarks"] = int(count)
    if "imu_times" in fields:
        noise = fields.numbers("imu_noise")
        if noise.shape != (4,) or not (np.isfinite(noise) & (noise >= 0)).all():
            raise DriveError(f"imu_noise: {noise.tolist()}, expected four numbers >= 0: densities and walks")
        times, gyro, accelerometer = (fields.numbers(f"imu_{key}") for key in _OWN_IMU)
        values["imu"] = ImuSamples(times, gyro, accelerometer, ImuNoise(*noise.tolist()))
    history = fields.text("history")
    if not isinstance(history, list) or not all(isinstance(line, str) for line in history):
        raise DriveError("history: expected a list of sentences")
    return Drive(camera=camera, history=tuple(map(files.shown, history)), **values)


def _dense_drive(times, twists, fields, camera, name):
    if "features" not in fields or fields.empty("features"):
        raise DriveError("features: missing, so there are no tracks; if the recording has images only, "
                         "`vislam_edu track` makes tracks from them")
    in_pieces = fields.pieces("features")
    drive = (drive_from_pieces(times, twists, in_pieces[0], in_pieces[1], camera, **name) if in_pieces else
             drive_from_features(times, twists, fields.numbers("features"), camera, **name))
    if not drive.landmark.size:
        raise DriveError("features: the recording is empty, no landmark is seen in any frame; if it has images, "
                         "`vislam_edu track` makes tracks from them")
    return drive


def _times(fields, key):
    times = fields.numbers(key)
    if times.size not in times.shape:
        raise DriveError(f"{key}: shape {times.shape}, expected (T,) or (1, T)")
    single, times = times.dtype.itemsize < 8, times.ravel().astype(float)
    largest = np.abs(times).max(initial=0.0)
    if largest > LARGEST["times"]:
        raise DriveError(f"{key}: {largest:.3g}, expected seconds; milliseconds or nanoseconds must be divided first")
    if single and (np.diff(times) <= 0).any():
        raise DriveError(f"{key}: do not increase; they are stored in less than 64 bits, which keep {largest:.4g} s "
                         f"only to {np.spacing(np.float32(largest)):.2g} s: store float64, or seconds since the start")
    return times


def _samples(fields, key, n_frames):
    """A velocity as (T, 3), stored either way round."""
    value = fields.numbers(key)
    if value.shape == (3, n_frames):
        value = value.T
    if value.shape != (n_frames, 3):
        raise DriveError(f"{key}: shape {value.shape}, expected (3, {n_frames}) or ({n_frames}, 3) "
                         f"for {n_frames} frames")
    if not np.isfinite(value).all():
        frame, axis = np.argwhere(~np.isfinite(value))[0]
        raise DriveError(f"{key}: {value[frame, axis]} in frame {frame} on the {'xyz'[axis]} axis")
    return value


def _rigid(name, T):
    """T (..., 4, 4) with its rotations projected to SO(3)."""
    if T.shape[-2:] != (4, 4):
        raise DriveError(f"{name}: shape {T.shape}, expected (4, 4)")
    with np.errstate(over="ignore"):
        T = np.asarray(T, float)  # numpy inverts no half or long floats
    R = T[..., :3, :3]
    near = np.isfinite(T).all(axis=(-2, -1)) & (np.abs(T[..., 3, :] - [0, 0, 0, 1]).max(axis=-1) < 1e-6)
    near &= se3.is_rotation(R, 1e-3)
    if not near.all():
        where = f" row {np.flatnonzero(~near)[0]}" if T.ndim > 2 else ""
        raise DriveError(f"{name}{where}: not a rigid motion (rotation, translation, [0, 0, 0, 1] below)")
    return se3.pose(Rotation.from_matrix(R).as_matrix(), T[..., :3, 3])


def _camera(K, baseline, cam_T_imu, key="K"):
    try:
        return StereoCamera(K, baseline, cam_T_imu)
    except ValueError as error:
        raise DriveError(str(error) if key == "K" else f"{key}: {error}") from None


def rows_of_numbers(path):
    """The numbers of a text file (n, m), and whether commas separate them."""
    rows, commas = [], False
    with files.open_regular(path) as file:
        text = file.read(_LARGEST_TEXT + 1)
    if len(text) > _LARGEST_TEXT:
        raise DriveError(f"more than {_LARGEST_TEXT >> 20} MB, expected one row of text a frame")
    for number, line in enumerate(text.decode("utf-8-sig").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            rows.append([float(word) for word in line.replace(",", " ").split()])
        except ValueError:
            raise DriveError(f"line {number}: {line.strip()[:60]!r} is not a row of numbers") from None
        if len(rows[-1]) != len(rows[0]) or not np.isfinite(rows[-1]).all():
            raise DriveError(f"line {number}: expected {len(rows[0])} finite numbers, as in the first row")
        commas |= "," in line
    if not rows:
        raise DriveError("no row of numbers in it")
    return np.array(rows), commas


def _kitti_poses(rows, drive):
    if len(rows) > drive.n_frames:
        raise DriveError(f"{len(rows)} poses for a drive of {drive.n_frames} frames: they belong to another "
                         f"drive or to this one before it was sliced")
    poses = np.full((drive.n_frames, 4, 4), np.nan)
    last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(rows), 1, 4))
    poses[:len(rows)] = _rigid("pose", np.concatenate([rows.reshape(-1, 3, 4), last], axis=1))
    return poses


def _tum_poses(rows, drive):
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    norms = np.linalg.norm(rows[:, 4:], axis=1)
    if (np.abs(norms - 1) > 1e-2).any():
        row = rows[np.argmax(np.abs(norms - 1) > 1e-2)]
        raise DriveError(f"time {row[0]}: quaternion {row[4:].tolist()} is not of length 1")
    times = drive.times
    if rows[-1, 0] < times[0] or rows[0, 0] > times[-1]:
        times = times - times[0]
    nearest = np.interp(times, rows[:, 0], np.arange(len(rows))).round().astype(int)
    half_frame = np.median(drive.taus) / 2 if drive.n_frames > 1 else 0.0
    matched = np.abs(rows[nearest, 0] - times) <= half_frame
    if not matched.any():
        raise DriveError(f"no row within half a frame ({half_frame:.3f} s) of any frame; the rows run from "
                         f"{rows[0, 0]} to {rows[-1, 0]} s, the drive from {times[0]} to {times[-1]} s")
    found = rows[nearest[matched]]
    poses = np.full((drive.n_frames, 4, 4), np.nan)
    poses[matched] = se3.pose(Rotation.from_quat(found[:, 4:]).as_matrix(), found[:, 1:4])
    return poses


def _finite_poses(poses):
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ValueError(f"poses: shape {poses.shape}, expected (T, 4, 4)")
    if not np.isfinite(poses).all():
        raise ValueError(f"poses: pose {np.argwhere(~np.isfinite(poses))[0, 0]} is not finite")
    return poses


def _write_rows(path, rows, first="%.12e"):
    with files.replacing(path) as file:
        np.savetxt(file, rows, fmt=[first] + ["%.12e"] * (rows.shape[1] - 1))
