"""A recording is audited before it is filtered: its sensors are held against each other, and against what is possible.

    report = audit(drive)
    print(report)
    drive = drive.apply(report["copy frames"].cure)     # one cure, or all of them: report.cured()

The cameras' own frame-to-frame motion (`visual_odometry`) is the yardstick for the IMU (`imu_alignment`). A finding has
to pass twice: a drive without the fault would look as bad less than once in 10,000 times, and the fault is large enough
to matter. Nothing is corrected silently: inside, later checks see the drive with earlier cures applied (a flipped axis
would hide the bias), outside the drive is what it was.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2, norm, poisson

from . import cures, imu_alignment, measured_noise, recordings, se3, track_health, visual_odometry
from .audit_report import AXES, Finding, Report
from .drive import Drive
from .imu_alignment import GYRO_BIAS, GYRO_SCALE, LEVER_ARM, ROTATION, SPEED_SCALE, Alignment

SIGNIFICANCE = 1e-4  # a clean drive is accused of each fault less often than this
FITS = 0.01  # the right explanation is turned down this often

# What matters: below, a filter would not notice
MIN_BEHIND_INFINITY = 5e-4  # share of the observations
MIN_ROW_OFFSET = 0.5  # px
MIN_OUTLIER_TRACKS = 0.01  # share of the tracks
MIN_OUTLIER_NOISE = 0.5  # px: a track that noise of this size explains does little harm
MIN_OFFSET = 0.3  # samples
MIN_LEVER_ARM = 0.1  # m
MIN_MISALIGNMENT = np.radians(2.0)
MIN_SCALE = 0.02  # of the speed; twice that of the gyro
MIN_GYRO_BIAS = 1e-3  # rad/s: 3 degrees of heading a minute


def audit(drive: Drive) -> Report:
    """Judge a recording. Works on any drive; what cannot be judged (an IMU without usable cameras) is left out."""
    copy_steps = track_health.copy_steps(drive)
    findings = [*_copy_frames(drive, copy_steps), *_frozen(drive), *_behind_infinity(drive), *_row_offset(drive),
                *_missing_frames(drive)]
    cured = _apply(drive, findings)
    motions = visual_odometry.estimate(cured)
    findings += _outlier_tracks(cured, motions)
    facts = _facts(drive, cured, motions)
    try:
        timing = imu_alignment.timing(cured, motions)
        findings += _timing(cured, timing)
        in_time = _apply(drive, findings)
        signs = _correlation_by_extrinsics(in_time, motions)
        alignment = imu_alignment.align(in_time, motions)
    except imu_alignment.TooFewSteps as reason:
        facts["IMU"] = f"not judged: {reason}"
        timing, signs, alignment, noise = None, None, None, None
    else:
        alignment = _mirrored(in_time, motions, alignment, findings)
        for check in (_axes, _misalignment, _lever_arm, _scales, _gyro_bias):
            findings += check(_apply(drive, findings), alignment)
        noise = measured_noise.from_alignment(in_time, alignment, motions)
        facts |= _alignment_facts(timing, alignment)
    return Report(drive=drive, findings=tuple(findings), facts=facts, signs=signs, alignment=alignment, noise=noise,
                  timing=timing, motions=motions, copy_steps=copy_steps)


def _apply(drive, findings):
    for finding in findings:
        if finding.cure:
            drive = drive.apply(finding.cure)
    return drive


def _chance(p):
    """A p-value that underflowed is still not the zero of a certain thing."""
    return float(np.clip(p, 1e-300, 1.0))


# --- tracks -----------------------------------------------------------------------------------------------


def _copy_frames(drive, copy_steps):
    count = int(copy_steps.sum())
    if count:
        share = track_health.copied(drive).mean()
        cure = cures.end_tracks_at_copies()
        yield Finding(
            "copy frames", count, "frames", 0.0,
            f"at {count} frames every track seen there and one frame before has exactly its old pixels "
            f"({share:.1%} of all observations are such copies)",
            cure, "end each track before its first copy; what it says later is stale",
        )  # fmt: skip


def _frozen(drive):
    bad = track_health.frozen(drive)
    if bad.any():
        yield Finding(
            "frozen tracks", int(bad.sum()), "observations", 0.0,
            f"{bad.sum()} observations have exactly the pixels of the frame before while other tracks move",
            cures.end_tracks_at_frozen(), "end each track before it freezes",
        )  # fmt: skip


def _behind_infinity(drive):
    bad = track_health.behind_infinity(drive)
    p = float(poisson.sf(bad.sum() - 1, len(bad) * norm.sf(5)))
    if p < SIGNIFICANCE and bad.mean() > MIN_BEHIND_INFINITY:
        yield Finding(
            "behind infinity", int(bad.sum()), "observations", _chance(p),
            f"{bad.sum()} disparities ({bad.mean():.2%}) are below zero by more than noise explains, "
            f"down to {track_health.disparity(drive).min():.1f} px: left and right show different things",
            cures.end_tracks_behind_infinity(), "end each track before its first impossible disparity",
        )  # fmt: skip


def _row_offset(drive):
    difference = drive.pixels[:, 1] - drive.pixels[:, 3]
    if not difference.size:
        return
    offset = float(np.median(difference))
    error = 1.2533 * 2**0.5 * visual_odometry.row_noise(drive.pixels) / len(difference) ** 0.5  # of a median
    p = 2 * norm.sf(abs(offset) / max(error, 1e-12))
    if p < SIGNIFICANCE and abs(offset) > MIN_ROW_OFFSET:
        yield Finding(
            "row offset", offset, "px", _chance(p),
            f"v_left - v_right is {offset:+.2f} px in the middle: the pair is not rectified",
            cures.level_rows(offset), f"add {offset:.2f} px to v_right",
        )  # fmt: skip


def _missing_frames(drive):
    usual = np.median(drive.taus) if drive.n_frames > 1 else 1.0
    missing = int((np.round(drive.taus / usual) - 1).clip(min=0).sum())
    if missing:
        yield Finding(
            "missing frames", missing, "frames", 0.0,
            f"steps of up to {drive.taus.max():.3f} s where {usual:.3f} s is usual: about {missing} frames are missing",
            None, "trust the filter less over such a step; the IMU sample is held for all of it",
        )  # fmt: skip


def _outlier_tracks(drive, motions):
    known = motions.ok[motions.step]
    landmark = drive.landmark[motions.before]
    distance = np.sqrt(motions.mahalanobis2) * min(1.0, motions.sigma_px / MIN_OUTLIER_NOISE)
    off = known & (distance**2 > chi2.ppf(visual_odometry.INLIER_PROBABILITY, 3))
    pairs, wrong = (np.bincount(landmark[rows], minlength=drive.n_landmarks) for rows in (known, off))
    judged = pairs >= 2
    outliers = judged & (wrong > pairs / 2)
    # Two pairs of two, or three of four ...: the likeliest innocent way is two of two
    by_chance = (1 - visual_odometry.INLIER_PROBABILITY) ** 2
    p = float(binom.sf(outliers.sum() - 1, max(judged.sum(), 1), by_chance))
    share = outliers.sum() / max(judged.sum(), 1)
    if p < SIGNIFICANCE and share > MIN_OUTLIER_TRACKS:
        flow = np.abs(drive.pixels[motions.after] - drive.pixels[motions.before]).max(axis=1)
        still = off & (flow < 3 * motions.sigma_px)
        stuck = outliers & (np.bincount(landmark[still], minlength=drive.n_landmarks) > pairs / 2)
        text = f"{outliers.sum()} of {judged.sum()} tracks ({share:.1%}) contradict the others most of the time"
        if stuck.any():
            text += f"; {stuck.sum()} of them stand still in the image when they should move"
        yield Finding(
            "outlier tracks", float(share), "share of the tracks", _chance(p), text,
            cures.drop_tracks(drive, np.flatnonzero(outliers)), "drop them, or rely on the filter's gate",
        )  # fmt: skip


def _facts(drive, cured, motions):
    disparity, lengths = track_health.disparity(drive), track_health.lengths(drive)
    facts = {
        "tracks in view (least, mean, most)": [int(drive.visible.min()), float(drive.visible.mean()),
                                               int(drive.visible.max())],
        "track length in frames (median, longest)": [float(np.median(lengths)) if lengths.size else 0.0,
                                                     int(lengths.max(initial=0))],
        "disparities at or below 0 px": int((disparity <= 0).sum()),
        "disparities below 1 px": int((disparity < 1).sum()),
        "noise of v_left - v_right per coordinate [px]": visual_odometry.row_noise(drive.pixels),
        "steps whose motion the cameras know": f"{motions.ok.mean():.1%}" if motions.ok.size else "none",
    }
    if len(cured.landmark) < len(drive.landmark):
        facts["observations left after the cures of tracks"] = f"{len(cured.landmark) / len(drive.landmark):.1%}"
    if motions.ok.any():
        wrong = ~motions.inlier[motions.ok[motions.step]]
        facts["pairs of observations that contradict their step's motion"] = f"{wrong.mean():.1%}"
    return facts


# --- IMU --------------------------------------------------------------------------------------------------

_READINGS = {"k": 0.0, "mean": -0.5, "k+1": -1.0}  # which step k + s sample k is read for


def _timing(drive, timing):
    """Which reading of the samples fits: a whole offset, or where none does one between two."""
    claimed = _READINGS[drive.imu_sample]
    offset, error = timing.peak
    p = timing.p_value(claimed)
    if p >= SIGNIFICANCE or abs(offset - claimed) <= MIN_OFFSET:
        return
    fits = float(timing.best)
    if timing.p_value(fits) < SIGNIFICANCE and abs(offset - fits) > MIN_OFFSET:
        fits = float(np.floor(offset)) + 0.5
    reading = next((name for name, s in _READINGS.items() if s == fits), None)
    if reading == drive.imu_sample:
        return
    if reading:
        cure, advice = cures.use_imu_sample(reading), f'read it so: imu_sample="{reading}"'
    else:
        samples = int(np.floor(-fits))
        cure = cures.shift_imu(samples, "k" if fits % 1 == 0 else "mean")
        advice = f"move the IMU by {samples:+d} samples"
    late = (claimed - offset) * float(np.median(drive.taus))
    yield Finding(
        "IMU timing", late, "s", _chance(p),
        f'IMU sample k fits the motion over step k{fits:+g} best (k{offset:+.2f} +- {error:.2f}), but '
        f'"{drive.imu_sample}" is claimed: it is {abs(late):.3f} s {"late" if late > 0 else "early"}',
        cure, advice,
    )  # fmt: skip


def _correlation_by_extrinsics(drive, motions):
    """(6,) correlation of each IMU axis with the cameras' motion seen through the file's extrinsics."""
    steps = np.flatnonzero(imu_alignment.usable_steps(motions))
    expected = np.matvec(se3.Adjoint(drive.camera.imu_T_cam), motions.twists[steps])
    return imu_alignment.correlation(drive.step_twists[steps], expected)


def _mirrored(drive, motions, alignment, findings):
    """A gyro axis with the wrong sign, which no rotation explains. Returns the alignment of what is right then.

    A car that drives ahead cannot tell one mirrored axis from another one and a half turn of the IMU; the reading that
    needs no turn is taken.
    """
    trials = []
    for axis in range(3):
        cure = cures.reverse_gyro_axis(axis)
        mirrored = imu_alignment.align(drive.apply(cure), motions)
        cost = [imu_alignment.cost(fit, mirrored.variance) for fit in (alignment, mirrored)]
        z2 = imu_alignment.evidence((cost[0] - cost[1]) / 2, 4 * imu_alignment.camera_noise(mirrored))
        straight = np.array_equal(_turn(drive, mirrored), np.eye(3))
        trials.append((z2, straight, axis, cure, mirrored))
    threshold = chi2.isf(SIGNIFICANCE / 3, 1)
    most = max(z2 for z2, *_ in trials)
    if most <= threshold:
        return alignment
    likely = [trial for trial in trials if trial[0] > most - threshold]
    z2, _, axis, cure, mirrored = max(likely, key=lambda trial: (trial[1], trial[0]))
    findings.append(Finding(
        "mirrored axis", axis, "axis of the gyro", _chance(3 * chi2.sf(z2, 1)),
        f"{AXES[3 + axis]} has the wrong sign: no rotation of the IMU explains it",
        cure, f"reverse {AXES[3 + axis]}",
    ))  # fmt: skip
    return mirrored


def _turn(drive, alignment):
    """The rotation of whole axes from the extrinsics' IMU frame to that of the samples, nearest to the fitted one."""
    samples_R_extrinsics = alignment.imu_R_cam @ drive.camera.cam_T_imu[:3, :3]
    group = Rotation.create_group("O").as_matrix().round()
    return group[np.argmax(np.einsum("gij,ij->g", group, samples_R_extrinsics))]


def _axes(drive, alignment: Alignment):
    """The IMU frame of the samples against the one of the extrinsics: rotations of whole axes."""
    turn = _turn(drive, alignment)
    if np.array_equal(turn, np.eye(3)):
        return
    p = imu_alignment.mounting_p_value(alignment, drive.camera.imu_T_cam[:3, :3])
    if p < SIGNIFICANCE:
        name = cures.describe_axes(turn)
        flipped = " and ".join("xyz"[i] for i in range(3) if turn[i, i] < 0) if (np.diag(turn) != 0).all() else ""
        yield Finding(
            "IMU axes", turn.astype(int).tolist(), "rotation", _chance(p),
            f"the samples are in another frame than the extrinsics: {name}"
            + (f", the {flipped} axes are flipped" if flipped else ""),
            cures.turn_imu_axes(turn.T), f"right-multiply cam_T_imu by {cures.describe_axes(turn.T)}",
        )  # fmt: skip


def _shrunk(deviation, covariance, prior):
    """The deviation, as far as it is known: what the drive hardly tells of (prior sigma) stays near zero."""
    prior = prior**2 * np.eye(len(deviation))
    return prior @ np.linalg.solve(prior + covariance, deviation)


def _misalignment(drive, alignment):
    turn = se3.so3_log(alignment.imu_R_cam @ drive.camera.cam_T_imu[:3, :3])
    known = _shrunk(turn, alignment.covariance[ROTATION, ROTATION], prior=0.1)
    angle = float(np.linalg.norm(known))
    if angle <= MIN_MISALIGNMENT:
        return
    # Two tests, because a large angle that the drive hardly tells of is far from linear
    p = max(alignment.p_value(ROTATION, turn),
            imu_alignment.mounting_p_value(alignment, drive.camera.imu_T_cam[:3, :3]))
    if p < SIGNIFICANCE:
        yield Finding(
            "misalignment", np.degrees(known).tolist(), "deg", _chance(p),
            f"the extrinsics are rotated by {np.degrees(angle):.1f} deg against what cameras and IMU agree on "
            f"(about the IMU's axes: {_list(np.degrees(known), 1)} deg)",
            cures.rotate_extrinsics(se3.so3_exp(-known)), "rotate the extrinsics by the fitted angle",
        )  # fmt: skip


def _lever_arm(drive, alignment):
    """Where the camera sits.

    A speed that is told in the body frame of another moment within the step looks like a lever arm of v times that
    time, along the way the car goes: up to half a step either way, so tau^2 / 12 of v v^T is not known.
    """
    speed = np.median(alignment.measured[:, :3], axis=0) * np.median(drive.taus)
    covariance = alignment.covariance[LEVER_ARM, LEVER_ARM] + np.outer(speed, speed) / 12

    def p_value(camera):
        deviation = alignment.camera_in_imu - camera.imu_T_cam[:3, 3]
        return float(chi2.sf(deviation @ np.linalg.solve(covariance, deviation), 3))

    given = drive.camera.imu_T_cam[:3, 3]
    p, known = p_value(drive.camera), _shrunk(alignment.camera_in_imu - given, covariance, prior=1.0)
    if p >= SIGNIFICANCE or np.linalg.norm(known) < MIN_LEVER_ARM:
        return
    text = (f"the turns put the camera at {_list(alignment.camera_in_imu, 2)} +- "
            f"{_list(np.sqrt(np.diag(covariance)), 2)} m in the IMU frame, the extrinsics at {_list(given, 2)} m")
    swap = cures.swap_translation()
    if p_value(swap(drive).camera) >= FITS:
        cure, advice = swap, "replace the translation t of cam_T_imu by -R t"
        text += "; its translation t is the camera's position in the IMU frame, where the map needs -R t"
    else:
        cure = cures.set_lever_arm(given + known)
        advice = f"put the camera at {_list(given + known, 2)} m, as far as the turns tell"
    yield Finding("lever arm", known.tolist(), "m", _chance(p), text, cure, advice)


def _scales(drive, alignment):
    for block, what, columns, least, scale in (
        (SPEED_SCALE, "speed", slice(0, 3), MIN_SCALE, alignment.speed_scale),
        (GYRO_SCALE, "gyro", slice(3, 6), 2 * MIN_SCALE, alignment.gyro_scale),
    ):
        p = alignment.p_value(block, scale - 1)
        if p < SIGNIFICANCE and abs(scale - 1) > least:
            factors = np.ones(6)
            factors[columns] = scale
            yield Finding(
                f"{what} scale", scale, "IMU / cameras", _chance(p),
                f"the IMU's {what} is {scale:.3f} times the cameras'",
                cures.scale_imu(factors, f"{what} divided by {scale:.4f}"),
                f"divide the {what} by {scale:.3f}, if the baseline is to be trusted more",
            )  # fmt: skip


def _gyro_bias(drive, alignment):
    bias, p = alignment.gyro_bias, alignment.p_value(GYRO_BIAS, alignment.gyro_bias)
    if p < SIGNIFICANCE and np.abs(bias).max() > MIN_GYRO_BIAS:
        yield Finding(
            "gyro bias", bias.tolist(), "rad/s", _chance(p),
            f"{_list(bias, 4)} +- {_list(alignment.sigma(GYRO_BIAS), 4)} rad/s",
            cures.subtract_gyro_bias(bias), "subtract it, or let the filter estimate it as it drives",
        )  # fmt: skip


def _alignment_facts(timing, alignment):
    return {
        "IMU sample k fits step k + s best for s": "{:.2f} +- {:.2f}".format(*timing.peak),
        "camera in the IMU frame [m]": f"{_list(alignment.camera_in_imu, 2)} "
                                       f"+- {_list(alignment.sigma(LEVER_ARM), 2)}",
        "gyro bias [rad/s]": f"{_list(alignment.gyro_bias, 4)} +- {_list(alignment.sigma(GYRO_BIAS), 4)}",
        "speed and gyro, IMU over cameras": f"{alignment.speed_scale:.3f}, {alignment.gyro_scale:.3f}",
    }  # fmt: skip


def _list(values, digits):
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"


# --- command line -----------------------------------------------------------------------------------------


def add_arguments(parser):
    """What `python -m vislam_edu audit` takes beside the recording (argument `recording`, a path or a name)."""
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write the figure here (png, pdf, svg)")
    parser.add_argument("--cured", type=Path, metavar="FILE", help="write the drive with all cures applied (npz)")
    parser.add_argument("--causal", action="store_true",
                        help="with --cured: leave out the cures that need the whole drive")


def run(arguments, drive=None) -> int:
    """Audit `arguments.recording` (or the drive given) and print; returns the exit status."""
    report = audit(recordings.load(arguments.recording) if drive is None else drive)
    print(json.dumps(report.to_dict(), indent=2) if arguments.json else report)
    if arguments.figure:
        report.figure().savefig(arguments.figure, dpi=150)
        print(f"figure: {arguments.figure}", file=sys.stderr)
    if arguments.cured:
        recordings.save(report.cured(needs_future=not arguments.causal), arguments.cured)
        print(f"cured drive: {arguments.cured}", file=sys.stderr)
    return 0
