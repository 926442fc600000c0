"""`python -m vislam_edu`: run a recording from the shell.

Each subcommand is one entry of `COMMANDS`: a function that adds its arguments to a parser, and one that does
the work and returns the exit status. What a subcommand needs is imported when it runs.
"""

import argparse
import sys
from pathlib import Path
from typing import NoReturn

from .arguments import add_recording, number, read_recording, whole
from .drive import DriveError

BAD_INPUT, INTERRUPTED = 2, 130


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error here does."""

    def error(self, message) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (--help explains)\n")


# --- run --------------------------------------------------------------------------------------------------


def add_run(parser):
    add_recording(parser)
    parser.add_argument("--audit", action="store_true",
                        help="audit the recording first, apply the cures found (each is named), and run the filter for "
                             "real drives: right-invariant, twist and gyro bias estimated, the IMU's noise as "
                             "measured, measurements that must agree with each other")
    parser.add_argument("--causal", action="store_true",
                        help="with --audit: leave out the cures that need the whole drive")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR",
                        help="folder for figures, trajectories, result.npz and summary.json; made if missing")
    noise = parser.add_argument_group("noise, one standard deviation per sample and axis")
    noise.add_argument("--sigma-v", type=number(0), metavar="M/S", help="linear velocity (default: 0.5 m/s)")
    noise.add_argument("--sigma-omega", type=number(0), metavar="RAD/S",
                       help="angular velocity (default: 0.05 rad/s)")
    noise.add_argument("--sigma-px", type=number(0, low_allowed=False), metavar="PX",
                       help="each pixel coordinate (default: 0.7 px)")
    noise.add_argument("--report-noise", action="store_true",
                       help="the report's W and V where no other value is given (overconfident: try it)")
    joint = parser.add_argument_group("the joint filter")
    joint.add_argument("--error-state", choices=("right", "invariant"),
                       help="what an error is: the report's right perturbation, or the right-invariant error, which "
                            "does not believe it learned the heading (default: right; invariant with --audit)")
    joint.add_argument("--initialisation", choices=("correlated", "as-report"), default="correlated",
                       help="covariance of a new landmark: from its triangulation and the pose, or the "
                            "report's 2 I without correlation (default: correlated)")
    joint.add_argument("--gate", type=number(0, 1, low_allowed=False), default=0.99, metavar="P",
                       help="probability that a good measurement is believed; 1: no gate (default: 0.99)")
    joint.add_argument("--min-disparity", type=number(0), default=1.0, metavar="PX",
                       help="below it a landmark waits for a better view (default: 1 px)")
    joint.add_argument("--every", type=whole(1), default=1, metavar="N",
                       help="use one landmark in N; the report needs 10, this filter does not (default: 1)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no summary on the terminal")


def noise_from(arguments, base):
    """`base` with the values given on the command line in place of its own."""
    import dataclasses

    given = {key: getattr(arguments, key) for key in ("sigma_v", "sigma_omega", "sigma_px")}
    return dataclasses.replace(base, **{key: value for key, value in given.items() if value is not None})


def prepare(arguments):
    """The drive to run and the noise and motion model to run it with: as they are, or after an audit."""
    from . import motion, pipeline
    from .noise import Noise

    drive = read_recording(arguments)
    model: type[motion.ImuDriven | motion.TwistAndBias] = motion.ImuDriven
    base = Noise.from_report() if arguments.report_noise else Noise()
    if arguments.audit:
        from .audit import audit

        report = audit(drive)
        drive, model = report.cured(needs_future=not arguments.causal), motion.TwistAndBias
        if not arguments.report_noise:
            base = pipeline.noise_of_real_drive(report.noise)
        if not arguments.quiet:
            print(report, end="\n\n")
            print("\n".join(["applied:", *(f"    {cure}" for cure in drive.history)] if drive.history else
                            ["nothing to cure"]), end="\n\n")
    return drive.thin(arguments.every), noise_from(arguments, base), model


def run(arguments):
    from functools import partial

    from numpy.linalg import LinAlgError
    from tqdm import tqdm

    from . import consensus, outputs, pipeline, slam
    from .error_state import RightInvariant, RightPerturbation

    if arguments.causal and not arguments.audit:
        raise DriveError("run: --causal says which cures to apply, so it needs --audit")
    drive, noise, motion_model = prepare(arguments)
    invariant = (arguments.error_state or ("invariant" if arguments.audit else "right")) == "invariant"
    method = "invariant" if invariant else "report" if arguments.report_noise else "slam"
    measure = consensus.measure if arguments.audit else slam.correlated
    if arguments.initialisation == "as-report":
        measure = slam.as_report
    with outputs.appearing_in(arguments.out) as folder:
        try:
            result = pipeline.run(
                drive, noise, RightInvariant() if invariant else RightPerturbation(), motion_model=motion_model,
                method=method, measure=measure, gate=arguments.gate, min_disparity=arguments.min_disparity,
                progress=partial(tqdm, unit="frame", disable=arguments.quiet),
            )
        except LinAlgError as error:
            raise DriveError(f"{arguments.recording}: the filter broke down ({error}), a covariance is no "
                             "longer positive definite: give the sensors more noise") from None
        numbers = outputs.write(result, folder)
    if not arguments.quiet:
        print(outputs.table(numbers))
        print(f"written to {arguments.out}")
    for warning in numbers["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    return 0


# --- info -------------------------------------------------------------------------------------------------


def info(arguments):
    from . import outputs

    print(outputs.description(read_recording(arguments)))
    return 0


# --- simulate ---------------------------------------------------------------------------------------------


def add_simulate(parser):
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="npz file to write")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N",
                        help="of everything random (default: 0)")
    parser.add_argument("--frames", type=whole(2), default=500, metavar="N", help="at 10 Hz (default: 500)")
    parser.add_argument("--sigma-v", type=number(0), default=0.5, metavar="M/S", help="default: 0.5")
    parser.add_argument("--sigma-omega", type=number(0), default=0.05, metavar="RAD/S", help="default: 0.05")
    parser.add_argument("--sigma-px", type=number(0), default=0.7, metavar="PX", help="default: 0.7")
    parser.add_argument("--gyro-bias", type=number(), nargs=3, default=(0.0, 0.0, 0.0),
                        metavar=("X", "Y", "Z"),
                        help="rad/s, constant (default: none)")
    parser.add_argument("--outlier-share", type=number(0, 1), default=0.0, metavar="SHARE",
                        help="of the tracks, wrong on purpose (default: 0)")


def simulate(arguments):
    from . import recordings
    from .simulate import street_loop

    names = ("seed", "frames", "sigma_v", "sigma_omega", "sigma_px", "gyro_bias", "outlier_share")
    try:
        drive = street_loop(**{name: getattr(arguments, name) for name in names})
    except ValueError as error:
        raise DriveError(f"simulate: {error}") from None
    if arguments.out.suffix != ".npz":
        raise DriveError(f"{arguments.out}: expected a name that ends in .npz")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    recordings.save(drive, arguments.out)
    print(f"{drive.n_frames} frames, {drive.n_landmarks} landmarks written to {arguments.out}")
    return 0


# --- the table --------------------------------------------------------------------------------------------

COMMANDS = {
    "run": (add_run, run, "the report's pipeline over a recording: figures, trajectories, numbers"),
    "info": (add_recording, info, "what is in a recording"),
    "simulate": (add_simulate, simulate, "make a recording with ground truth: a street loop"),
}
# Modules that add their own arguments and do their own work, imported only when asked for: module, help.
MODULES = {
    "audit": ("audit", "hold a recording's sensors against each other, before it is filtered"),
    "consistency": ("consistency", "the filters over many simulated drives: are their covariances honest?"),
    "exercises": ("exercises.report", "grade submitted notebooks, list the mistakes that checks know"),
}
# Commands with a parser of their own get all that follows their name: module of this package, help.
FORWARDED = {
    "notebooks": ("execute", "run the notebooks and store their outputs"),
}


def module_command(argv):
    """Run one of `MODULES`: argv[0] is its name."""
    from importlib import import_module

    name, text = MODULES[argv[0]]
    module = import_module(f".{name}", __package__)
    command = Parser(prog=f"python -m vislam_edu {argv[0]}", description=text[0].upper() + text[1:] + ".")
    module.add_arguments(command)
    return module.run(command.parse_args(argv[1:]))


def parser():
    top = Parser(prog="python -m vislam_edu",
                 description="Visual-inertial SLAM with an extended Kalman filter.",
                 epilog="Exit status: 0 done, 2 bad input (one line on stderr says what), 130 interrupted.")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    for name, (add_arguments, work, text) in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        add_arguments(command)
        command.set_defaults(work=work)
    for name, (_, text) in (MODULES | FORWARDED).items():
        commands.add_parser(name, help=text, add_help=False)
    return top


def dispatch(argv):
    """Parse and do; returns the exit status, errors come out as exceptions."""
    if argv and argv[0] in MODULES:
        return module_command(argv)
    if argv and argv[0] in FORWARDED:
        from importlib import import_module

        return import_module(f".{FORWARDED[argv[0]][0]}", __package__).main(argv[1:])
    arguments = parser().parse_args(argv)
    return arguments.work(arguments)


def main(argv=None) -> int:
    """The command line. Returns the exit status; bad input is one line on stderr, never a traceback."""
    try:
        return dispatch(sys.argv[1:] if argv is None else list(argv))
    except DriveError as error:
        message = str(error)
    except OSError as error:
        message = f"{error.filename2 or error.filename or 'output'}: {error.strerror or error}"
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    print("vislam_edu: " + " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT


if __name__ == "__main__":
    raise SystemExit(main())
