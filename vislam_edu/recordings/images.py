"""Images of a stereo camera, its calibration and its IMU on disk: KITTI's, EuRoC's and the course's layouts.

Images are read one by one, when they are asked for. Nothing that a file contains is run.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from .. import lens, se3
from ..drive import Drive, DriveError
from ..stereo import StereoCamera
from . import extrinsics, files, layouts

Pair = tuple[np.ndarray, np.ndarray]
_FOLDERS = (("image_0", "image_1"), ("image_2", "image_3"), ("image_00", "image_01"), ("image_02", "image_03"),
            ("mav0/cam0", "mav0/cam1"), ("cam0", "cam1"), ("left", "right"))  # the images in them, or in their data/
_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff"}


class Pairs:
    """Left and right images by number, grey (colours are averaged), (h, w), and their times, (n,) s, if files say them.

    readers : of each pair, two functions that read its images. first : KITTI's number of the left camera.
    """

    def __init__(self, readers: Sequence[tuple[Callable, Callable]], times: np.ndarray | None, first: int = 0) -> None:
        self.readers, self.times, self.first = readers, times, first

    def __len__(self) -> int:
        return len(self.readers)

    def __getitem__(self, k: int) -> Pair:
        images = (reader() for reader in self.readers[k])
        left, right = (image if image.ndim == 2 else image[..., :3].mean(axis=-1) for image in images)
        if left.shape != right.shape:
            raise DriveError(f"pair {k}: left image {left.shape}, right image {right.shape}, expected one size")
        return left, right


def open_pairs(paths: Sequence[Path]) -> Pairs:
    """Pairs of images: one folder that holds both cameras' (KITTI, EuRoC), two folders, or the course's _imgs.npy.

    Raises DriveError naming the path and what is wrong.
    """
    path = Path(paths[0])
    with files.errors_name(path):
        if len(paths) == 1 and path.is_file():
            if path.suffix.lower() in (".mp4", ".avi", ".mkv", ".mov"):
                raise DriveError("a video of one camera; give both, left and right, or folders of images")
            return _course(path)
        if len(paths) > 2:
            raise DriveError(f"one of {len(paths)} paths; expected one folder, or two, left and right")
        if len(paths) == 2 and path.is_file():
            return _videos(*map(Path, paths))
        if len(paths) == 1:
            found = [pair for pair in _FOLDERS if all((path / side).is_dir() for side in pair)]
            if path.is_dir() and not found:
                raise DriveError("expected a folder with " + ", or ".join(map(" and ".join, _FOLDERS)))
            paths = [path / side for side in found[0]] if found else [path, path]
        folders = [inner if (inner := Path(one) / "data").is_dir() else Path(one) for one in paths]
        left, right = ({file.stem: file for file in sorted(folder.iterdir()) if file.suffix.lower() in _SUFFIXES}
                       for folder in folders)
        names = [name for name in left if name in right]
        if not names:
            raise DriveError(f"no image of {folders[0]} has one of the same name in {folders[1]}")
        return Pairs([(_reader(left[name]), _reader(right[name])) for name in names], _times(folders[0], names),
                     2 if Path(paths[0]).name in ("image_2", "image_02") else 0)


def _reader(path: Path) -> Callable[[], np.ndarray]:
    def read() -> np.ndarray:
        with files.errors_name(path), Image.open(path) as image:
            return np.asarray(image.convert("L") if image.mode not in ("L", "I;16", "I") else image)
    return read


def _times(folder: Path, names: list[str]) -> np.ndarray | None:
    """From names of nanoseconds (EuRoC), a times.txt in or above the folder, or dates in timestamps.txt (KITTI)."""
    if all(name.isdigit() and len(name) > 12 for name in names):
        return np.array([int(name) for name in names]) / 1e9
    for path in (folder / "times.txt", folder.parent / "times.txt"):
        if path.is_file():
            return layouts.rows_of_numbers(path)[0][:len(names), 0]
    dates = folder.parent / "timestamps.txt"
    if dates.is_file():
        try:
            lines = dates.read_text(encoding="utf-8").split("\n")
            return np.array([line.strip() for line in lines[:len(names)]], "datetime64[ns]").astype(np.int64) / 1e9
        except ValueError:
            raise DriveError(f"{dates.name}: expected a date and a time in each line") from None
    return None


def _course(path: Path) -> Pairs:
    fields = files.fields_of(files.open_regular(path))  # stays open: images are read when they are asked for
    left, right = (fields.arrays(key) for key in ("cam_imgs_L", "cam_imgs_R"))
    return Pairs([(one.read, other.read) for one, other in zip(left, right)], None)


def _videos(left: Path, right: Path) -> Pairs:
    try:
        import imageio.v3 as iio  # type: ignore[import-not-found]
    except ImportError:
        raise DriveError("reading videos needs an optional package: python -m pip install 'imageio[pyav]'; or unpack "
                         "them into two folders of images") from None
    one, other = (iio.imopen(path, "r", plugin="pyav") for path in (left, right))  # stay open: no frame is read twice
    n = min(one.properties().shape[0], other.properties().shape[0])
    return Pairs([(partial(one.read, index=k), partial(other.read, index=k)) for k in range(n)], None)


def open_calibration(paths: Sequence[Path], first: int = 0) -> tuple[lens.Rig, Callable[..., Drive]]:
    """A rig to track with, and a function `make(frames, times, twists, **fields)` that makes the `Drive`.

    paths : two of EuRoC's yaml files, left and right; KITTI's calib.txt or calib_cam_to_cam.txt, whose IMU is then
    taken to sit in the camera (x forward, y left, z up); or a recording of the course. first : see `Pairs`.
    """
    path = Path(paths[0])
    with files.errors_name(path):
        if len(paths) == 2:
            (K0, d0, T0), (K1, d1, T1) = (_yaml(Path(one)) for one in paths)
            rig = lens.rectified(K0, K1, se3.inverse(T0) @ T1, se3.inverse(T0), d0, d1)
            said = "tracked from images, points undistorted and rectified"
        elif path.suffix == ".txt":
            rig = _kitti(path, first)
            said = "tracked from images; the IMU is taken to sit in the left camera, x forward, y left, z up"
        elif path.suffix in (".yaml", ".yml"):
            raise DriveError("the yaml of one camera; give two, left and right")
        else:
            return _course_calibration(path)
    return rig, _maker(rig, said)


def _maker(rig: lens.Rig, said: str) -> Callable[..., Drive]:
    """A function that makes the `Drive` of frames tracked with the rig. said : what its history says."""
    from .. import tracking

    def make(frames, times, twists, **fields) -> Drive:
        fields |= tracking.as_fields(frames)
        return Drive(times=times, twists=twists, camera=rig.camera, history=(said,), **fields)
    return make


def _course_calibration(path: Path) -> tuple[lens.Rig, Callable[..., Drive]]:
    from .. import tracking

    with files.open_fields(path) as fields:
        if "K_l" not in fields:
            camera = layouts.camera_of(fields)
            rig = lens.Rig(lens.Lens(camera.K), lens.Lens(camera.K), camera)
            return rig, _maker(rig, "tracked from images")
        K, K_right, left, right = (fields.numbers(key) for key in ("K_l", "K_r", "extL_T_imu", "extR_T_imu"))
    imu_T_left, left_T_right = next(iter(extrinsics.fitting(left, right).values()))
    rig = lens.rectified(K, K_right, left_T_right, se3.inverse(imu_T_left))

    def make(frames, times, twists, **more) -> Drive:
        fields = tracking.as_fields(frames) | {"pixels": np.concatenate([np.hstack([f.left, f.right]) for f in frames])}
        drive = Drive(times=times, twists=twists, camera=StereoCamera(K, 1.0, np.eye(4)), **fields, **more)
        return extrinsics.mounted(drive.replace(history=("tracked from images",)), K_right, left, right)
    return rig, make


def _kitti(path: Path, first: int) -> lens.Rig:
    rows: dict[str | int, list[str]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        key, _, numbers = line.rpartition(":")
        rows[key or len(rows)] = numbers.split()
    try:
        left, right = (np.array(rows.get(f"P{n}") or rows.get(f"P_rect_{n:02}") or rows[n], float).reshape(3, 4)
                       for n in (first, first + 1))
    except (KeyError, ValueError):
        raise DriveError("expected KITTI's calib.txt or calib_cam_to_cam.txt, where P0 and P1 (of colour images P2 and "
                         "P3) have 12 numbers each") from None
    K = left[:, :3]
    cam_T_imu = se3.inverse(extrinsics.REGULAR_T_OPTICAL)
    return lens.Rig(lens.Lens(K), lens.Lens(right[:, :3]),
                    StereoCamera(K, float((left[0, 3] - right[0, 3]) / K[0, 0]), cam_T_imu))


def _yaml(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K (3, 3), distortion (4,) and body_T_cam (4, 4) of EuRoC's sensor.yaml."""
    with files.errors_name(path):
        text = path.read_text(encoding="utf-8")
        found = {key: re.search(rf"^\s*{key}:\s*\[([^\]]*)\]", text, re.MULTILINE)
                 for key in ("intrinsics", "distortion_coefficients", "data")}
        if missing := [key for key, match in found.items() if match is None]:
            raise DriveError(f"{missing[0]}: missing; expected a camera's yaml as EuRoC has it")
        if "radial" not in text:
            raise DriveError("distortion_model: expected radial-tangential")
        focal, distortion, T = (np.array(match[1].split(","), float) for match in found.values() if match)
        return np.array([[focal[0], 0, focal[2]], [0, focal[1], focal[3]], [0, 0, 1.0]]), distortion, T.reshape(4, 4)


def open_imu(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) s and twists (T, 6): a recording of the course, or a text file of rows t, v (3), omega (3).

    Raises DriveError also for a file of accelerations (EuRoC's imu0): a `Drive` needs velocities.
    """
    path = Path(path)
    with files.errors_name(path):
        if path.suffix in (".npy", ".npz"):
            with files.open_fields(path) as fields:
                if "twists" in fields:
                    return fields.numbers("times").astype(float), fields.numbers("twists")
                return layouts.imu_of(fields)
        rows, _ = layouts.rows_of_numbers(path)
        if rows.shape[1] != 7:
            raise DriveError(f"{rows.shape[1]} numbers a row, expected 7: time, linear velocity, angular velocity")
        if abs(np.linalg.norm(np.median(rows[:, 4:], axis=0)) - 9.8) < 1:
            raise DriveError("holds gyro and accelerometer (9.8 m/s^2 in the last three columns); expected rows of "
                             "time, linear velocity, angular velocity")
        return rows[:, 0] / (1e9 if rows[0, 0] > 1e14 else 1.0), rows[:, 1:]


def twists_at(frames: np.ndarray, times: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """(T, 6): the samples at the images' times (T,), where the IMU has those, else their mean until the next image."""
    nearest = np.abs(times - frames[:, None]).argmin(axis=1) if len(times) < 1e5 else np.searchsorted(times, frames)
    nearest = nearest.clip(0, len(times) - 1)
    spacing = np.median(np.diff(times))
    if spacing > 0.5 * np.median(np.diff(frames)):
        if np.abs(times[nearest] - frames).max() > spacing:
            raise DriveError("the IMU's samples and the images are not of the same time")
        return twists[nearest]
    so_far = np.vstack([np.zeros(6), np.cumsum((twists[1:] + twists[:-1]) / 2 * np.diff(times)[:, None], axis=0)])
    at = np.stack([np.interp(frames, times, column) for column in so_far.T], axis=-1)
    mean = np.diff(at, axis=0) / np.diff(frames)[:, None]
    return np.vstack([mean, mean[-1:]])
