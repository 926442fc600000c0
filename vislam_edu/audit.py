"""A recording is audited before it is filtered: its sensors are held against each other, and against what is possible.

    report = audit(drive)
    print(report)
    drive = drive.apply(report["copy frames"].cure)     # one cure, or all of them: report.cured()

The checks stand in `track_checks` and `imu_checks`; the cameras' own frame-to-frame motion (`visual_odometry`) is the
yardstick for the IMU (`imu_timing`, `imu_alignment`). A finding has to pass twice: a drive without the fault would look
as bad less than once in 10,000 times, and the fault is large enough to matter. Nothing is corrected silently: inside,
later checks see the drive with earlier cures applied (a flipped axis would hide the bias), outside the drive is what it
was.
"""

import json
import sys
from pathlib import Path

from . import (
    imu_alignment,
    imu_checks,
    imu_timing,
    measured_noise,
    recordings,
    track_checks,
    track_health,
    visual_odometry,
)
from .arguments import add_recording, read_recording
from .audit_report import Report
from .drive import Drive


def audit(drive: Drive) -> Report:
    """Judge a recording. Works on any drive; what cannot be judged (an IMU without usable cameras) is left out."""
    copy_steps = track_health.copy_steps(drive)
    findings = [*track_checks.copy_frames(drive, copy_steps), *track_checks.frozen(drive),
                *track_checks.behind_infinity(drive), *track_checks.row_offset(drive),
                *track_checks.missing_frames(drive)]
    cured = _apply(drive, findings)
    motions = visual_odometry.estimate(cured)
    findings += track_checks.outlier_tracks(cured, motions)
    facts = track_checks.facts(drive, cured, motions)
    try:
        timing = imu_timing.estimate(cured, motions)
        findings += imu_checks.mistimed(cured, timing)
        in_time = _apply(drive, findings)
        signs = imu_alignment.correlation_by_extrinsics(in_time, motions)
        alignment = imu_alignment.align(in_time, motions)
    except imu_alignment.TooFewSteps as reason:
        facts["IMU"] = f"not judged: {reason}"
        timing, signs, alignment, noise = None, None, None, None
    else:
        mirrored, alignment = imu_checks.mirrored_axis(in_time, motions, alignment)
        findings += mirrored
        for check in (imu_checks.turned_axes, imu_checks.misalignment, imu_checks.lever_arm, imu_checks.scales,
                      imu_checks.gyro_bias):
            findings += check(_apply(drive, findings), alignment)
        noise = measured_noise.from_alignment(in_time, alignment, motions)
        facts |= imu_checks.facts(timing, alignment)
    return Report(drive=drive, findings=tuple(findings), facts=facts, signs=signs, alignment=alignment, noise=noise,
                  timing=timing, motions=motions, copy_steps=copy_steps)


def _apply(drive, findings):
    for finding in findings:
        if finding.cure:
            drive = drive.apply(finding.cure)
    return drive


# --- command line -----------------------------------------------------------------------------------------


def add_arguments(parser):
    """What `python -m vislam_edu audit` takes. parser : argparse.ArgumentParser."""
    add_recording(parser)
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write the figure here (png, pdf, svg)")
    parser.add_argument("--cured", type=Path, metavar="FILE", help="write the drive with all cures applied (npz)")
    parser.add_argument("--causal", action="store_true",
                        help="with --cured: leave out the cures that need the whole drive")


def run(arguments) -> int:
    """Audit the recording asked for and print what was found; returns the exit status."""
    report = audit(read_recording(arguments))
    print(json.dumps(report.to_dict(), indent=2) if arguments.json else report)
    if arguments.figure:
        report.figure().savefig(arguments.figure, dpi=150)
        print(f"figure: {arguments.figure}", file=sys.stderr)
    if arguments.cured:
        recordings.save(report.cured(needs_future=not arguments.causal), arguments.cured)
        print(f"cured drive: {arguments.cured}", file=sys.stderr)
    return 0
