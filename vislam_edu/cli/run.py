"""`python -m vislam_edu run`: the report's pipeline over a recording, and what it leaves in a folder."""

import sys
from pathlib import Path

from . import say
from .arguments import (
    OptionError,
    add_noise,
    add_recording,
    ground_truth_doubts,
    keep,
    number,
    read_recording,
    sigmas,
    whole,
)

ERROR_STATES = {"inverse-depth": "InverseDepth", "cartesian": "RightInvariant", "right": "RightPerturbation",
                "invariant": "RightInvariant"}  # of the option: the class of `error_state`, which is imported late


def add_arguments(parser):
    """The options of `run`. parser : argparse.ArgumentParser."""
    add_recording(parser)
    parser.add_argument("--audit", action="store_true",
                        help="audit the recording first, apply the cures found (each is named), and run the filter for "
                             "real drives: twist and gyro bias estimated, the IMU's noise as "
                             "measured, robust weights, tracks that slip, lengths by the IMU's speed")
    parser.add_argument("--causal", action="store_true",
                        help="with --audit: leave out the cures that need the whole drive")
    parser.add_argument("--force", action="store_true",
                        help="with --audit: filter also a file that is certainly read wrongly, and apply cures that "
                             "move dead reckoning by more than its sensors can be wrong by")
    parser.add_argument("--calibration", action="store_true",
                        help="run the joint filter again with each lens parameter turned by one standard deviation, in "
                             "parallel, and add what moves to the covariance of the path")
    lens = parser.add_mutually_exclusive_group()
    lens.add_argument("--lens", action="store_true",
                      help="with --audit: estimate from the whole drive what the lenses are off by, print it, write it "
                           "to DIR/lens.json, and run the filter on corrected pixels")
    lens.add_argument("--lens-from", type=Path, metavar="FILE",
                      help="correct the pixels by a lens.json that another drive of the same cameras has left")
    parser.add_argument("--batch", action="store_true",
                        help="estimate the whole drive at once as well, by least squares (with --audit: robust, with "
                             "the gyro's bias and the scale of the speed)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR",
                        help="folder for figures, trajectories, result.npz and summary.json; made if missing")
    noise = parser.add_argument_group("noise, one standard deviation per sample and axis")
    add_noise(noise, preset=False)
    noise.add_argument("--imu-noise", type=number(0, low_allowed=False), nargs=4,
                       metavar=("GYRO", "ACC", "GYRO_WALK", "ACC_WALK"),
                       help="of gyro and accelerometer, see imu.ImuNoise: their densities, rad/s and m/s^2 per root "
                            "Hz, and the walks of their biases (default: as in the file, else those of an ADIS16448)")
    noise.add_argument("--report-noise", action="store_true",
                       help="the report's W and V where no other value is given (overconfident: try it)")
    joint = parser.add_argument_group("the joint filter")
    joint.add_argument("--error-state", choices=ERROR_STATES,
                       help="what an error is: right-invariant with landmarks of inverse depth, or with points "
                            "(cartesian, also called invariant), or the report's right perturbation, which believes "
                            "that it learned the heading (default: inverse-depth; cartesian with --audit; right with "
                            "--initialisation as-report)")
    joint.add_argument("--initialisation", choices=("correlated", "as-report"), default="correlated",
                       help="covariance of a new landmark: from its triangulation and the pose, or the "
                            "report's 2 I without correlation (default: correlated)")
    joint.add_argument("--gate", type=number(0, 1, low_allowed=False), default=0.99, metavar="P",
                       help="probability that a good measurement is believed; 1: no gate (default: 0.99)")
    joint.add_argument("--min-disparity", type=number(0), default=1.0, metavar="PX",
                       help="below it a landmark waits for a better view, but for inverse-depth (default: 1 px)")
    joint.add_argument("--every", type=whole(1), default=1, metavar="N",
                       help="use one landmark in N; the report needs 10, this filter does not (default: 1)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no summary on the terminal")


def prepare(arguments):
    """The drive to run, the noise to run it with, options of the joint filter, and warnings: as is, or after an audit.

    Raises DriveError where the audit is certain that the file is read wrongly and `--force` is not given.
    """
    import dataclasses

    from .. import inertial, robust
    from ..drive import DriveError
    from ..imu import ImuNoise
    from ..noise import Noise
    from ..studies import pipeline, run_warnings, scale

    drive, options, warnings = read_recording(arguments), {}, []
    base = Noise.from_report() if arguments.report_noise else Noise()
    if drive.imu is not None and arguments.audit:
        raise OptionError("run: --audit judges an IMU that gives velocities: not with an accelerometer")
    if arguments.imu_noise:
        samples = inertial.samples_of(drive)
        drive = drive.replace(imu=dataclasses.replace(samples, noise=ImuNoise(*arguments.imu_noise)))
    if arguments.audit:
        from ..audit import audit

        report = audit(drive)
        if report.refusal and not arguments.force:
            raise DriveError(f"{arguments.recording}: {report.refusal}; correct the file, or take the one that "
                             "`audit --cured FILE` writes (--force filters all the same)")
        if report.too_far and not arguments.force:
            warnings.append(report.too_far)
        drive = report.cured(needs_future=not (arguments.causal or warnings))
        options = {"motion_model": robust.RealDrive, "process_frame": robust.process_frame}
        if not run_warnings.has_few_tracks(drive):
            options["metre"] = scale.of_the_imu
        if not arguments.report_noise:
            base = pipeline.noise_of_real_drive(report.noise)
        if not arguments.quiet:
            say(report, end="\n\n")
            done = "".join(f"\n    {cure}" for cure in drive.history)
            say(f"applied:{done}" if done else "nothing to cure", end="\n\n")
            if "metre" in options:
                say(scale.EXPLAINED, end="\n\n")
    else:
        warnings = run_warnings.of_recording(drive)
    return drive.subsample(arguments.every), dataclasses.replace(base, **sigmas(arguments)), options, warnings


def error_state_of(arguments):
    """The `ErrorState` asked for, or what suits the run. Raises OptionError where the initialisation forbids it."""
    from .. import error_state

    as_report = arguments.initialisation == "as-report"
    default = "right" if as_report else "cartesian" if arguments.audit else "inverse-depth"
    name = arguments.error_state or default
    if as_report and name == "inverse-depth":
        raise OptionError("run: --initialisation as-report gives a landmark 2 m^2 per axis, which an inverse depth "
                          "does not have: take --error-state right or cartesian")
    return getattr(error_state, ERROR_STATES[name])()


def correct_lens(arguments, drive, noise):
    """The drive with its pixels corrected, the `LensErrors` that did it, and warnings of its estimate."""
    from ..studies import lens_errors, pipeline, run_warnings

    if arguments.lens_from:
        found, warnings = lens_errors.load(arguments.lens_from), []
    else:
        found, smoothed = lens_errors.estimate(pipeline.batch_of_real_drive(drive, noise, scale_sigma=0.05))
        warnings = [f"lens: {warning}" for warning in run_warnings.of_batch(smoothed)]
    if not arguments.quiet:
        say(found, end="\n\n")
    return found.corrected(drive), found, warnings


def batch_problem(arguments, drive, noise):
    """What `--batch` minimises. Raises OptionError or DriveError where nothing can be minimised."""
    from .. import batch, inertial, inertial_batch
    from ..drive import DriveError
    from ..studies import pipeline

    try:
        if drive.imu is not None:
            return inertial_batch.Problem(drive, noise, begin=inertial.initial(drive, noise))
        return (pipeline.batch_of_real_drive(drive, noise, scale_sigma=0.05) if arguments.audit
                else batch.Problem(drive, noise))
    except DriveError as error:
        raise DriveError(f"{arguments.recording}: {error}; leave out --batch") from None
    except ValueError as error:
        raise OptionError(f"run --batch: {error}") from None


def _on_all_cores():
    """Context in which the runs of `--calibration` share the cores; joblib is imported for it alone."""
    import joblib

    return joblib.parallel_config(n_jobs=-1)


def run(arguments):
    """Run the filters and write their results; returns the exit status."""
    import dataclasses
    from contextlib import nullcontext
    from functools import partial

    from numpy.linalg import LinAlgError
    from tqdm import tqdm

    from .. import window_slam
    from ..drive import DriveError
    from ..studies import pipeline, run_warnings
    from . import outputs

    if (arguments.causal or arguments.force) and not arguments.audit:
        raise OptionError("run: --causal and --force say which cures to apply, so they need --audit")
    if arguments.lens and (arguments.causal or not arguments.audit):
        raise OptionError("run: --lens needs --audit and the whole drive, so not --causal; --lens-from needs neither")
    keep(arguments.out / "result.npz", "--out", arguments.recording)
    error_state = error_state_of(arguments)
    drive, noise, options, warnings = prepare(arguments)
    method = "report" if error_state.role == "slam" and arguments.report_noise else error_state.role
    found = None
    if arguments.lens or arguments.lens_from:
        drive, found, doubts = correct_lens(arguments, drive, noise)
        warnings = [*warnings, *doubts]
    problem = batch_problem(arguments, drive, noise) if arguments.batch else None
    if arguments.initialisation == "as-report":
        options["process_frame"] = window_slam.as_report
    with outputs.appearing_in(arguments.out) as folder:
        try:
            with _on_all_cores() if arguments.calibration else nullcontext():
                result = pipeline.run_pipeline(
                    drive, noise, error_state, method=method, gate=arguments.gate,
                    min_disparity=arguments.min_disparity, consider_calibration=arguments.calibration,
                    lens_px=found and found.sigma_px,
                    progress=partial(tqdm, disable=arguments.quiet), **options)
        except LinAlgError as error:
            raise DriveError(f"{arguments.recording}: the filter broke down ({error}), "
                             f"{run_warnings.likely_reason(drive, noise)}") from None
        if unusable := run_warnings.unusable(result):
            raise DriveError(f"{arguments.recording}: not finite, or with a covariance that is not positive definite: "
                             f"{', '.join(unusable)}; {run_warnings.likely_reason(drive, noise)}")
        smoothed = None
        if problem:
            problem = dataclasses.replace(problem, drive=result.drive)  # whose truth may be in another world by now
            smoothed = pipeline.run_batch(problem, result.slam.trajectory.world_T_imu)
        numbers = outputs.write(result, folder, smoothed, found, [*ground_truth_doubts(arguments, drive), *warnings])
    if not arguments.quiet:
        say(outputs.table(numbers))
        say(f"written to {arguments.out}")
    for warning in numbers["warnings"]:
        say(f"warning: {warning}", file=sys.stderr)
    return 0
