"""`python -m vislam_edu track`: images to a recording that `run` takes."""

from pathlib import Path

from . import say
from .arguments import OptionError, keep, whole

_STORE_EVERY = 100  # pairs between two states written, from which an interrupted command goes on


def add_arguments(parser):
    """The options of `track`. parser : argparse.ArgumentParser."""
    parser.add_argument("images", nargs="+", type=Path, metavar="IMAGES",
                        help="a folder of KITTI's or EuRoC's layout, two folders (left, right), the course's "
                             "_imgs.npy, or two videos (these need imageio)")
    parser.add_argument("--calibration", nargs="+", type=Path, required=True, metavar="FILE",
                        help="KITTI's calib.txt or calib_cam_to_cam.txt, EuRoC's two yaml files (left, right), or a "
                             "recording of the course")
    imu = parser.add_mutually_exclusive_group(required=True)
    imu.add_argument("--imu", type=Path, metavar="FILE",
                     help="velocities: a recording of the course, or rows of time, linear and angular velocity")
    imu.add_argument("--accelerometer", type=Path, metavar="FILE",
                     help="gyro and accelerometer instead: csv of EuRoC (imu0/data.csv)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="npz file to write")
    parser.add_argument("--visible", type=whole(8, 2000), default=150, metavar="N",
                        help="tracks at a time, at most (default: 150)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def opencv_flow(image, other, points, guess=None):
    """`tracking.flow` by OpenCV: the same pyramids and the same checks, faster; patches only move."""
    import cv2
    import numpy as np

    images = [np.clip(levels[0], 0, 255).astype(np.uint8) for levels in (image, other)]
    points = np.float32(points).reshape(-1, 1, 2)
    if not len(points):
        return np.empty((0, 2)), np.empty(0, bool)
    start = points if guess is None else np.float32(guess).reshape(-1, 1, 2)
    found, ok, _ = cv2.calcOpticalFlowPyrLK(*images, points, start.copy(), winSize=(15, 15), maxLevel=5, flags=4)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(*images[::-1], found, points + found - start, winSize=(15, 15),
                                                maxLevel=5, flags=4)
    meet = np.linalg.norm((back - points)[:, 0], axis=1) < 0.3
    return found[:, 0].astype(float), meet & (ok[:, 0] > 0) & (ok_back[:, 0] > 0)


def run(arguments):
    """Track, and write the recording; returns the exit status."""
    from importlib.util import find_spec

    import numpy as np
    from tqdm import tqdm

    from .. import recordings, tracking
    from ..drive import DriveError
    from ..recordings import files, images

    if arguments.out.suffix != ".npz":
        raise OptionError(f"{arguments.out}: expected a name that ends in .npz")
    keep(arguments.out, "--out", *arguments.images, *arguments.calibration, arguments.imu, arguments.accelerometer)
    pairs = images.open_pairs(arguments.images)
    rig, make = images.open_calibration(arguments.calibration, pairs.first)
    if arguments.imu:
        imu_times, twists = images.open_imu(arguments.imu)
    elif pairs.times is None:
        raise DriveError(f"{arguments.images[0]}: no times beside the images, which --accelerometer needs")
    else:
        imu_times, twists = pairs.times, np.zeros((len(pairs), 6))
    times = imu_times[:len(pairs)] if pairs.times is None else pairs.times
    n = min(len(pairs), len(times))
    if n < 2:
        raise DriveError(f"{arguments.images[0]}: {n} pairs of images with a time, expected at least 2")
    twists = images.twists_at(times[:n], imu_times, twists)
    with files.made_folder(arguments.out.parent):
        state = arguments.out.with_suffix(".tracking.npz")
        frames = _stored(state, n)
        flow = opencv_flow if find_spec("cv2") else tracking.flow  # OpenCV where it is installed: the extra `tracks`
        first = max(0, len(frames) - 1)
        found = tracking.track((pairs[k] for k in range(first, n)), rig, visible=arguments.visible, flow=flow,
                               after=frames[-1] if frames else None)
        for frame in tqdm(found, total=n, initial=len(frames), unit="pair", disable=arguments.quiet):
            frames.append(frame)
            if len(frames) % _STORE_EVERY == 0:
                _store(state, frames)
        drive = make(frames, times[:n], twists, name=arguments.out.stem, source=f"images of {arguments.images[0].name}")
        if arguments.accelerometer:
            drive = recordings.load_imu(arguments.accelerometer, drive)
        recordings.save(drive, arguments.out)
        state.unlink(missing_ok=True)
    if not arguments.quiet:
        say(f"{n} pairs, {drive.n_landmarks} tracks; written to {arguments.out}")
    return 0


def _store(path, frames):
    import numpy as np

    from ..recordings import files

    with files.replacing(path) as file:
        np.savez(file, count=[len(frame.ids) for frame in frames], n_landmarks=[frame.n_landmarks for frame in frames],
                 ids=np.concatenate([frame.ids for frame in frames]),
                 left=np.concatenate([frame.left for frame in frames]),
                 right=np.concatenate([frame.right for frame in frames]),
                 pixels=np.concatenate([frame.pixels for frame in frames]))


def _stored(path, most):
    """Frames of an interrupted command, none where there is no file."""
    import numpy as np

    from ..drive import DriveError
    from ..recordings import files
    from ..tracking import Frame

    if not path.exists():
        return []
    with files.errors_name(path), files.open_fields(path) as fields:
        ends = np.cumsum(fields.numbers("count"))[:-1]
        if len(ends) + 1 > most:
            raise DriveError("is the state of a longer recording; delete it, or write to another name")
        ids, left, right, pixels = (np.split(fields.numbers(key), ends) for key in ("ids", "left", "right", "pixels"))
        return list(map(Frame, ids, left, right, pixels, fields.numbers("n_landmarks").tolist()))
