"""`python -m vislam_edu simulate`: make a recording with ground truth, a street loop."""

from pathlib import Path

from . import say
from .arguments import SIGMAS, OptionError, add_noise, number, whole


def add_arguments(parser):
    """The options of `simulate`. parser : argparse.ArgumentParser."""
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="npz file to write")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of everything random (default: 0)")
    parser.add_argument("--frames", type=whole(2, 100_000), default=500, metavar="N", help="at 10 Hz (default: 500)")
    add_noise(parser, perfect_pixels=True)
    parser.add_argument("--gyro-bias", type=number(), nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
                        help="rad/s, constant (default: none)")
    parser.add_argument("--outlier-share", type=number(0, 1), default=0.0, metavar="SHARE",
                        help="of the tracks, wrong on purpose (default: 0)")


def run(arguments):
    """Write the drive; returns the exit status."""
    from .. import recordings
    from ..recordings import files
    from ..simulate import street_loop

    names = ("seed", "frames", *SIGMAS, "gyro_bias", "outlier_share")
    try:
        drive = street_loop(**{name: getattr(arguments, name) for name in names})
    except ValueError as error:
        raise OptionError(f"simulate: {error}") from None
    if arguments.out.suffix != ".npz":
        raise OptionError(f"{arguments.out}: expected a name that ends in .npz")
    with files.made_folder(arguments.out.parent):
        recordings.save(drive, arguments.out)
    say(f"{drive.n_frames} frames, {drive.n_landmarks} landmarks written to {arguments.out}")
    return 0
