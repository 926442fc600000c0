"""A recording is audited before it is filtered: its sensors are held against each other, and against what is possible.

    report = audit(drive)
    print(report)
    drive = drive.apply(report["copy frames"].cure)     # one cure, or all of them: report.cured()

The checks stand in `track_checks`, `calibration_checks` and `imu_checks`; the cameras' own frame-to-frame motion
(`visual_odometry`) is the yardstick for the IMU (`imu_timing`, `imu_alignment`). Where they find something, `whole`
asks whether one wrong reading of the file explains it all. A finding has to pass twice: a drive
without the fault would look as bad less than once in 10,000 times, and the fault is large enough to matter. Nothing
is corrected silently: inside, later checks see the drive with earlier cures applied (a flipped axis would hide the
bias), outside the drive is what it was.
"""

from dataclasses import replace

from ..drive import Drive
from . import (
    calibration_checks,
    imu_alignment,
    imu_checks,
    imu_timing,
    measured_noise,
    track_checks,
    track_health,
    visual_odometry,
    whole,
)
from .report import Report


def audit(drive: Drive) -> Report:
    """Judge a recording. Works on any drive; what cannot be judged (an IMU without usable cameras) is named."""
    certain = list(whole.certain(drive))
    report = _judge(_apply(drive, certain))
    if report.alignment is None or report.findings:
        report = whole.explained(report, _judge)
    if report.alignment is None and len(report.drive.landmark):
        readings = whole.readings(report.cured(), report.noise.noise)
        report = replace(report, findings=(*report.findings, *readings))
    return replace(report, drive=drive, findings=(*certain, *report.findings))


def _judge(drive: Drive) -> Report:
    """The checks of the single sensors, one after the other."""
    copy_steps = track_health.copy_steps(drive)
    findings = track_checks.without_motion(drive)
    cured = _apply(drive, findings)
    motions = visual_odometry.estimate(cured)
    findings += track_checks.outlier_tracks(cured, motions)
    agreeing = _apply(drive, findings)
    halves = calibration_checks.halves_by_place(agreeing), calibration_checks.halves_at_random(agreeing)
    findings += [*calibration_checks.row_saddle(agreeing), *calibration_checks.split_halves(*halves)]
    facts = track_checks.facts(drive, cured, motions) | calibration_checks.facts(agreeing, *halves)
    unjudged = ""
    try:
        every, timing = visual_odometry.stride(cured, motions), None
        if every == 1:
            timing = imu_timing.estimate(cured, motions)
            findings += imu_checks.mistimed(cured, timing)
        else:
            unjudged = f"IMU timing (tracks move enough over {every} frames only)"
        in_time = _apply(drive, findings)
        compared = visual_odometry.thin(in_time, every)
        seen = visual_odometry.estimate(compared) if every > 1 else motions
        alignment = imu_alignment.align(compared, seen)
        signs = imu_alignment.correlation_by_extrinsics(compared, seen)
    except imu_alignment.TooFewSteps as reason:
        unjudged = f"IMU, extrinsics, scale ({reason})"
        timing, signs, alignment = None, None, None
        noise = measured_noise.from_samples(cured)
        facts["IMU noise by second differences [m/s, rad/s]"] = [noise.noise.sigma_v, noise.noise.sigma_omega]
    else:
        mirrored, alignment = imu_checks.mirrored_axis(compared, seen, alignment)
        findings += mirrored
        for check in (imu_checks.turned_axes, imu_checks.misalignment, imu_checks.lever_arm,
                      imu_checks.scale_conflict, imu_checks.gyro_scale, imu_checks.gyro_bias):
            findings += check(_apply(drive, findings), alignment)
        noise = measured_noise.from_alignment(in_time, alignment, motions, every)
        alignment = replace(alignment, steps=every * alignment.steps)
        facts |= imu_checks.facts(timing, alignment)
    return Report(drive=drive, findings=tuple(findings), facts=facts, signs=signs, alignment=alignment, noise=noise,
                  timing=timing, motions=motions, copy_steps=copy_steps, unjudged=unjudged)


def _apply(drive, findings):
    for finding in findings:
        if finding.cure:
            drive = drive.apply(finding.cure)
    return drive
