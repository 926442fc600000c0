"""What several commands of `python -m vislam_edu` take alike: numbers, checked as they are read, and a recording.

`number` and `whole` make functions for argparse's `type`.
"""

import argparse
import math
from pathlib import Path
from typing import Any


class OptionError(ValueError):
    """An option, or a combination of options, that cannot be used; the message says which and why."""


def number(low=-math.inf, high=math.inf, *, low_allowed=True):
    """A check for argparse: a finite number from low to high."""
    def check(text):
        value = float(text)  # argparse turns the ValueError of a word into its own message
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text} is not a finite number")
        if not low <= value <= high or (value == low and not low_allowed):
            above = "at least" if low_allowed else "above"
            upto = "" if math.isinf(high) else f" and at most {high:g}"
            raise argparse.ArgumentTypeError(f"{text} is not a number {above} {low:g}{upto}")
        return value

    check.__name__ = "number"
    return check


def whole(low, high=10**9):
    """A check for argparse: a whole number from low to high."""
    def check(text):
        value = int(text)
        if value < low:
            raise argparse.ArgumentTypeError(f"{text} is not a whole number of at least {low}")
        if value > high:
            raise argparse.ArgumentTypeError(f"{text[:40]} is more than {high}")
        return value

    check.__name__ = "whole number"
    return check


def add_recording(parser):
    """A recording, by path or name, and the poses to hold it against. parser : argparse.ArgumentParser."""
    parser.add_argument("recording", nargs="?", default="street_loop", metavar="RECORDING",
                        help="npz or npy file of a drive, or the name of one in data/ (default: street_loop)")
    parser.add_argument("--ground-truth", type=Path, metavar="FILE",
                        help="true poses of the left camera: KITTI (12 numbers a row) or TUM "
                             "(time x y z qx qy qz qw); or of the IMU: csv of EuRoC or TUM-VI")
    parser.add_argument("--accelerometer", type=Path, metavar="FILE",
                        help="gyro and accelerometer in the recording's clock: csv of EuRoC (imu0/data.csv)")
    parser.add_argument("--extrinsics", metavar="READING",
                        help="how to read extL_T_imu and extR_T_imu: imu_T_regular, optical_T_imu, imu_T_optical or "
                             "regular_T_imu (default: as the numbers say)")
    parser.add_argument("--from", type=whole(0), metavar="FRAME", dest="first", default=0,
                        help="first frame to use (default: 0)")
    parser.add_argument("--to", type=whole(1), metavar="FRAME", dest="stop",
                        help="frame to stop before (default: the end)")


SIGMAS = {"sigma_v": (0.5, "m/s", "linear velocity"), "sigma_omega": (0.05, "rad/s", "angular velocity"),
          "sigma_px": (0.7, "px", "each pixel coordinate")}  # as `Noise` has them, unit, of what


def add_noise(parser, *, preset=True, perfect_pixels=False):
    """One standard deviation per sample and axis of each sensor; None where not given, if there is no preset."""
    for name, (value, unit, what) in SIGMAS.items():
        check = number(0, 1e3 if preset else math.inf, low_allowed=perfect_pixels or name != "sigma_px")
        parser.add_argument(f"--{name.replace('_', '-')}", type=check, metavar=unit.upper(),
                            default=value if preset else None, help=f"{what} (default: {value} {unit})")


def sigmas(arguments) -> dict[str, Any]:
    """What `add_noise` was given, by the names that `Noise` has."""
    given = {name: getattr(arguments, name) for name in SIGMAS}
    return {name: value for name, value in given.items() if value is not None}


def read_recording(arguments):
    """The `Drive` that `add_recording` asked for. Raises DriveError when it cannot be used."""
    from .. import recordings  # here, or --help would load numpy and scipy first

    drive = recordings.load(arguments.recording, arguments.extrinsics)
    if arguments.accelerometer is not None:
        drive = recordings.load_imu(arguments.accelerometer, drive)
    if arguments.ground_truth is not None:
        drive = recordings.load_ground_truth(arguments.ground_truth, drive)
    if (arguments.first, arguments.stop) != (0, None):
        drive = drive.slice(arguments.first, arguments.stop)
    return drive


def keep(target: Path, option: str, *inputs: str | Path | None) -> None:
    """Raises OptionError when what an option writes would take the place of a file that is read."""
    from .. import recordings

    read = [Path(name) if Path(name).exists() else recordings.find(name) for name in inputs if name]
    if target.exists() and any(path and target.samefile(path) for path in read):
        raise OptionError(f"{option}: {target} would be written over, which is read; take another name")


def ground_truth_doubts(arguments, drive) -> list[str]:
    """What speaks against the file given with --ground-truth: a sentence, or none."""
    from ..audit import ground_truth_checks

    doubt = ground_truth_checks.doubt(drive) if arguments.ground_truth is not None else None
    return [] if doubt is None else [f"{arguments.ground_truth}: {doubt}"]
