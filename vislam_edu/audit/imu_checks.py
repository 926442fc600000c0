"""What can be wrong with the IMU of a recording, held against its cameras: a check yields a `Finding`, or nothing.

They are put to a drive in the order in which they stand here, each to the drive with the earlier cures applied. All but
the first judge an `Alignment`.
"""

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, chdtri

from .. import se3
from . import cures, imu_alignment
from .imu_alignment import GYRO_BIAS, GYRO_SCALE, LEVER_ARM, ROTATION, SPEED_SCALE
from .report import AXES, Finding
from .track_checks import SIGNIFICANCE, chance

# What matters: below, a filter would not notice
MIN_OFFSET = 0.3  # samples
MIN_LEVER_ARM = 0.1  # m
MIN_MISALIGNMENT = np.radians(2.0)
MIN_SCALE = 0.02  # of the speed; twice that of the gyro
CAMERAS_SCALE = 0.03  # what the calibration of a stereo pair may be off by; more is a fault of the IMU's speed
MOST_SCALE = 1.3  # no speed sensor and no gyro is wrong by more, either way
MIN_GYRO_BIAS = 1e-3  # rad/s: 3 degrees of heading a minute

_READINGS = {"k": 0.0, "mean": -0.5, "k+1": -1.0}  # which step k + s sample k is read for


def mistimed(drive, timing):
    """Samples that belong to another step than is claimed (`imu_timing.Timing`): by a whole offset, or by a half."""
    claimed = _READINGS[drive.imu_sample]
    offset, error = timing.peak
    p = timing.p_value(claimed)
    if p >= SIGNIFICANCE or abs(offset - claimed) <= MIN_OFFSET:
        return
    fits = float(timing.best)
    if timing.p_value(fits) < SIGNIFICANCE and abs(offset - fits) > MIN_OFFSET:
        fits = float(np.floor(offset)) + 0.5
    reading = next((name for name, s in _READINGS.items() if s == fits), None)
    if reading:
        cure, advice = cures.use_imu_sample(reading), f'read it so: imu_sample="{reading}"'
    else:
        samples = int(np.floor(-fits))
        cure = cures.shift_imu(samples, "k" if fits % 1 == 0 else "mean")
        advice = f"move the IMU by {samples:+d} samples"
    late = (claimed - offset) * float(np.median(drive.taus))
    yield Finding("IMU timing", late, "s", chance(p),
                  f'IMU sample k fits the motion over step k{fits:+g} best (k{offset:+.2f} +- {error:.2f}), but '
                  f'"{drive.imu_sample}" is claimed: it is {abs(late):.3f} s {"late" if late > 0 else "early"}',
                  cure, advice)


def mirrored_axis(drive, motions, alignment):
    """A gyro axis with the wrong sign, which no rotation explains: a list with the finding, or none.

    A car that drives ahead cannot tell one mirrored axis from another one and a half turn of the IMU; the reading that
    needs no turn is taken. alignment : of the drive as it is. Also returns the `Alignment` of what is right then.
    """
    trials = []
    for axis in range(3):
        cure = cures.divide_imu(f"gyro {'xyz'[axis]} reversed", np.where(np.arange(6) == 3 + axis, -1, 1), False)
        mirrored = imu_alignment.align(drive.apply(cure), motions)
        cost = [imu_alignment.cost(fit, mirrored.variance) for fit in (alignment, mirrored)]
        z2 = imu_alignment.evidence((cost[0] - cost[1]) / 2, 4 * imu_alignment.camera_noise(mirrored))
        straight = np.array_equal(_turn(drive, mirrored), np.eye(3))
        trials.append((z2, straight, axis, cure, mirrored))
    threshold = chdtri(1, SIGNIFICANCE / 3)
    most = max(z2 for z2, *_ in trials)
    if most <= threshold:
        return [], alignment
    likely = [trial for trial in trials if trial[0] > most - threshold]
    z2, _, axis, cure, mirrored = max(likely, key=lambda trial: (trial[1], trial[0]))
    finding = Finding("mirrored axis", axis, "axis of the gyro", chance(3 * chdtrc(1, z2)),
                      f"{AXES[3 + axis]} has the wrong sign: no rotation of the IMU explains it",
                      cure, f"reverse {AXES[3 + axis]}")
    return [finding], mirrored


def _turn(drive, alignment):
    """The rotation of whole axes from the extrinsics' IMU frame to that of the samples, nearest to the fitted one."""
    samples_R_extrinsics = alignment.imu_R_cam @ drive.camera.cam_T_imu[:3, :3]
    group = Rotation.create_group("O").as_matrix().round()
    return group[np.argmax(np.einsum("gij,ij->g", group, samples_R_extrinsics))]


def turned_axes(drive, alignment):
    """The IMU frame of the samples against the one of the extrinsics: rotations of whole axes."""
    turn = _turn(drive, alignment)
    if np.array_equal(turn, np.eye(3)):
        return
    p = imu_alignment.mounting_p_value(alignment, drive.camera.imu_T_cam[:3, :3])
    if p < SIGNIFICANCE:
        flipped = " and ".join("xyz"[i] for i in range(3) if turn[i, i] < 0) if (np.diag(turn) != 0).all() else ""
        yield Finding("IMU axes", turn.astype(int).tolist(), "rotation", chance(p),
                      f"the samples are in another frame than the extrinsics: {cures.describe_axes(turn)}"
                      + (f", the {flipped} axes are flipped" if flipped else ""),
                      cures.turn_imu_axes(turn.T), f"right-multiply cam_T_imu by {cures.describe_axes(turn.T)}")


def _shrunk(deviation, covariance, prior):
    """The deviation, as far as it is known: what the drive hardly tells of (prior sigma) stays near zero."""
    prior = prior**2 * np.eye(len(deviation))
    return prior @ np.linalg.solve(prior + covariance, deviation)


def misalignment(drive, alignment):
    """Extrinsics that are turned by a small angle."""
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
            "misalignment", np.degrees(known).tolist(), "deg", chance(p),
            f"the extrinsics are rotated by {np.degrees(angle):.1f} deg against what cameras and IMU agree on "
            f"(about the IMU's axes: {_list(np.degrees(known), 1)} deg)",
            cures.rotate_extrinsics(se3.so3_exp(-known)), "rotate the extrinsics by the fitted angle")


def lever_arm(drive, alignment):
    """Where the camera sits.

    A speed that is expressed in the body frame of another moment within the step looks like a lever arm of v times that
    time, along the way the car goes: up to half a step either way, so tau^2 / 12 of v v^T is not known.
    """
    speed = np.median(alignment.measured[:, :3], axis=0) * np.median(drive.taus)
    covariance = alignment.covariance[LEVER_ARM, LEVER_ARM] + np.outer(speed, speed) / 12

    def p_value(camera):
        deviation = alignment.camera_in_imu - camera.imu_T_cam[:3, 3]
        return float(chdtrc(3, deviation @ np.linalg.solve(covariance, deviation)))

    given = drive.camera.imu_T_cam[:3, 3]
    p, known = p_value(drive.camera), _shrunk(alignment.camera_in_imu - given, covariance, prior=1.0)
    if p >= SIGNIFICANCE or np.linalg.norm(known) < MIN_LEVER_ARM:
        return
    text = (f"the turns put the camera at {_list(alignment.camera_in_imu, 2)} +- "
            f"{_list(np.sqrt(np.diag(covariance)), 2)} m in the IMU frame, the extrinsics at {_list(given, 2)} m")
    swap = cures.swap_translation()
    if p_value(swap(drive).camera) >= SIGNIFICANCE:  # no free number: as good as a fitted one until it is refuted
        cure, advice = swap, "replace the translation t of cam_T_imu by -R t"
        apart = np.linalg.norm(swap(drive).camera.imu_T_cam[:3, 3] - alignment.camera_in_imu)
        text += (f"; its translation t is the camera's position in the IMU frame, where the map needs -R t (that is "
                 f"{apart:.2f} m from the fit, p = {p_value(swap(drive).camera):.1g})")
    else:
        cure = cures.set_lever_arm(given + known)
        advice = f"put the camera at {_list(given + known, 2)} m, as far as the turns tell"
    yield Finding("lever arm", known.tolist(), "m", chance(p), text, cure, advice)


def scale_conflict(drive, alignment):
    """The IMU's speed and the cameras' baseline disagree about the length of the path.

    The recording cannot tell which is wrong. A few per cent may be either, and nothing is changed; more than a stereo
    pair's calibration is ever off by must be the IMU's unit.
    """
    scale, p = alignment.speed_scale, alignment.p_value(SPEED_SCALE, alignment.speed_scale - 1)
    if p >= SIGNIFICANCE or abs(scale - 1) <= MIN_SCALE:
        return
    by_imu = float(np.linalg.norm(drive.step_twists[:, :3].mean(axis=0)) * drive.duration)
    text = (f"the IMU's speed is {scale:.3f} times the cameras' (+- {alignment.sigma(SPEED_SCALE)[0]:.3f}). If "
            f"the IMU is right, baseline or focal length are off by {100 * (scale - 1):+.1f} % and the drive is about "
            f"{by_imu:.0f} m long; if the cameras are, the IMU's speed is wrong by as much and it is "
            f"{by_imu / scale:.0f} m long")
    if not 1 / MOST_SCALE < scale < MOST_SCALE:
        yield _contradiction("scale conflict", scale, p, text)
        return
    if abs(scale - 1) > CAMERAS_SCALE:
        cure = cures.divide_imu(f"speed divided by {scale:.4f}", np.repeat([scale, 1], 3), True)
        advice = f"divide the speed by {scale:.3f}: no calibration of cameras is that far off"
    else:
        cure, advice = None, "choose; `run` takes the IMU's metre, whose noise averages out, and says by how much"
    yield Finding("scale conflict", scale, "IMU / cameras", chance(p), text, cure, advice)


def gyro_scale(drive, alignment):
    """A gyro that measures too much or too little throughout."""
    scale, p = alignment.gyro_scale, alignment.p_value(GYRO_SCALE, alignment.gyro_scale - 1)
    if p < SIGNIFICANCE and not 1 / MOST_SCALE < scale < MOST_SCALE:
        yield _contradiction("gyro scale", scale, p, f"the IMU's gyro is {scale:.3f} times the cameras'")
    elif p < SIGNIFICANCE and abs(scale - 1) > 2 * MIN_SCALE:
        yield Finding(
            "gyro scale", scale, "IMU / cameras", chance(p), f"the IMU's gyro is {scale:.3f} times the cameras'",
            cures.divide_imu(f"gyro divided by {scale:.4f}", np.repeat([1, scale], 3), True),
            f"divide the gyro by {scale:.3f}")


def _contradiction(fault, scale, p, text):
    return Finding(fault, scale, "IMU / cameras", chance(p), f"{text}; no sensor is that wrong", None,
                   "nothing is cured: compare K, the image size, the units and the times of the file with its source",
                   whole=True)


def gyro_bias(drive, alignment):
    """A gyro that tells of turns at rest."""
    bias, p = alignment.gyro_bias, alignment.p_value(GYRO_BIAS, alignment.gyro_bias)
    if p < SIGNIFICANCE and np.abs(bias).max() > MIN_GYRO_BIAS:
        cure = cures.Cure(f"gyro bias {np.round(bias, 5).tolist()} rad/s subtracted", True,
                          lambda drive: drive.replace(twists=drive.twists - np.r_[np.zeros(3), bias]))
        yield Finding("gyro bias", bias.tolist(), "rad/s", chance(p),
                      f"{_list(bias, 4)} +- {_list(alignment.sigma(GYRO_BIAS), 4)} rad/s",
                      cure, "subtract it, or let the filter estimate it as it drives")


def facts(timing, alignment):
    """What timing and alignment measure whether anything is wrong or not, by name."""
    when = {"IMU sample k fits step k + s best for s": "{:.2f} +- {:.2f}".format(*timing.peak)} if timing else {}
    return when | {"camera in the IMU frame [m]":
                   f"{_list(alignment.camera_in_imu, 2)} +- {_list(alignment.sigma(LEVER_ARM), 2)}",
                   "gyro bias [rad/s]": f"{_list(alignment.gyro_bias, 4)} +- {_list(alignment.sigma(GYRO_BIAS), 4)}",
                   "speed and gyro, IMU over cameras": f"{alignment.speed_scale:.3f}, {alignment.gyro_scale:.3f}"}


def _list(values, digits):
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"
