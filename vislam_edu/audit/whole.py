"""What may be wrong with a file as a whole: one wrong reading of it makes every sensor look wrong at once.

Each candidate is a `Cure`: another reading of calibration, tracks, times or units. It is tried where the checks of the
single sensors found something or could not judge, and wins when the tracks move as the IMU says (`unexplained`) as well
as after all single cures, and less is left to cure: one explanation is likelier than five faults that happen to meet.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import scipy  # scipy.optimize is loaded when it is used: `run` on a sound file need not wait for it
from scipy.special import chdtrc

from .. import kalman, se3, window_slam
from ..drive import Drive
from ..error_state import RightInvariant
from ..noise import Noise
from ..recordings.extrinsics import REGULAR_T_OPTICAL
from .cures import Cure, swap_translation, use_imu_sample
from .report import Finding, Report
from .track_checks import SIGNIFICANCE, chance

CERTAIN = 0.5  # a reading that leaves half as much of the tracks' motion unexplained is taken for right
BETTER, AS_GOOD = 0.9, 1.1  # than the file as it is; as after the single cures
_MIN_FACTOR, _MIN_SHIFT = 0.1, 0.05  # of K, of the focal length: below, it is a calibration error and no other image
_MAX_STRIDE, _MOST_PAIRS = 10, 5000  # frames, and pairs of observations that are looked at
_LONGEST = 5.0  # s, a step; more is another unit
_LONGEST_BASELINE = 100.0  # m, likewise
_TRIED = 3  # readings that are audited
_LEAST = {"sigma_v": 0.01, "sigma_omega": 1e-3, "sigma_px": 0.3}  # of the filter that judges
_NICE = np.array([1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2, 3, 4])  # factors of image sizes


def unexplained(drive: Drive, path: np.ndarray | None = None) -> float:
    """The share of the tracks' motion in the images that the IMU does not explain, seen through the calibration.

    Median error of the IMU's prediction over a few frames, over the median motion: near 0 when all is right, near 1 or
    above when something is not, infinite when most disparities are not positive. It has no unit, so that readings of
    different pixels can be compared. path : (T, 4, 4), what `imu_path` makes of the drive, where it is known already.
    """
    lengths = drive.last_seen - drive.first_seen + 1
    stride = int(np.clip(np.median(lengths) // 3, 1, _MAX_STRIDE)) if lengths.size else 1
    order = np.lexsort((drive.frame, drive.landmark))
    before, after = order[:-stride], order[stride:]
    same = drive.landmark[before] == drive.landmark[after]  # tracks have no gaps: then stride frames lie between
    thin = slice(None, None, max(1, np.count_nonzero(same) // _MOST_PAIRS))
    before, after = before[same][thin], after[same][thin]
    K, fb = drive.camera.K, drive.camera.K[0, 0] * drive.camera.baseline
    first, second = (np.column_stack([(drive.pixels[rows, 0] - K[0, 2]) / K[0, 0],
                                      (drive.pixels[rows, 1:4:2].mean(axis=1) - K[1, 2]) / K[1, 1],
                                      (drive.pixels[rows, 0] - drive.pixels[rows, 2]) / K[0, 0]])
                     for rows in (before, after))
    if len(before) < 30 or (first[:, 2] > 0).mean() < 0.5:
        return np.inf
    world_T_cam = (imu_path(drive) if path is None else path) @ drive.camera.imu_T_cam
    after_T_before = se3.inverse(world_T_cam[drive.frame[after]]) @ world_T_cam[drive.frame[before]]
    q = np.matvec(after_T_before, np.column_stack([first[:, :2], np.ones(len(first)),
                                                   first[:, 2] * K[0, 0] / fb]))
    depth = np.maximum(q[:, 2], 0.05)
    predicted = np.column_stack([q[:, 0], q[:, 1], q[:, 3] * drive.camera.baseline]) / depth[:, None]
    error, flow = (np.linalg.norm(second - start, axis=1) for start in (predicted, first))
    return float(np.median(error) / max(np.median(flow), 1e-12))


def imu_path(drive: Drive) -> np.ndarray:
    """(T, 4, 4): the IMU integrated, from the identity on."""
    return se3.chain(np.eye(4), se3.exp(drive.step_twists * drive.taus[:, None]))


def explained(report: Report, judge: Callable[[Drive], Report]) -> Report:
    """The report of the file in the reading that explains it best, that reading as its first finding.

    report : of the file as it is, which is returned where no other reading is better. judge : makes such a report.
    """
    drive, best = report.drive, report
    now, cured = unexplained(drive), unexplained(report.cured())
    limit = CERTAIN * now if report.alignment is None else min(BETTER * now, AS_GOOD * cured)
    trials = sorted(((unexplained(cure(drive)), i, fault, cure, advice)
                     for i, (fault, cure, advice) in enumerate(candidates(drive))), key=lambda trial: trial[:2])
    for score, _, fault, cure, advice in trials[:_TRIED]:
        if score > limit:
            break
        other = judge(drive.apply(cure))
        if other.alignment is not None and (best.alignment is None or len(other.findings) < len(best.findings)):
            what, to_do = advice.split(": ", 1)
            finding = _finding(fault, score, "of the motion unexplained",
                               f"{what}; read so, the IMU explains all but {score:.0%} of the tracks' motion, as the "
                               f"file stands all but {now:.0%}", cure, to_do)
            best = replace(other, drive=drive, findings=(finding, *other.findings))
    return best


def certain(drive: Drive) -> Iterator[Finding]:
    """What needs no comparison: a value that stands for "not seen", units of baseline and times, times in float32."""
    if len(drive.pixels):
        value, count = np.unique(drive.pixels[:, 0], return_counts=True)
        sentinel = float(value[np.argmax(count)])
        unset = (drive.pixels == sentinel).all(axis=1).mean()
        if unset > 0.5:
            yield _finding("sentinel", sentinel, "px",
                           f"{unset:.1%} of the observations are {sentinel:g} in all four numbers: in this file "
                           f'{sentinel:g} stands for "not seen"',
                           Cure(f"observations of {sentinel:g} taken for not seen", False,
                                lambda drive: drive.keep_observations(~(drive.pixels == sentinel).all(axis=1))),
                           f"write -1 where nothing is seen, not {sentinel:g}")
    if (baseline := drive.camera.baseline) > _LONGEST_BASELINE:
        yield _finding("baseline in mm", baseline, "m", f"the cameras would be {baseline:.0f} m apart: b is in mm",
                       _camera("baseline read as mm", lambda camera: replace(camera, baseline=baseline / 1e3)),
                       "divide it by 1000")
    if drive.n_frames < 3:
        return
    tau = float(np.median(drive.taus))
    if tau > _LONGEST:
        unit, size = next((name, size) for name, size in (("ms", 1e3), ("us", 1e6), ("ns", 1e9))
                          if tau < _LONGEST * size)
        scaled = Cure(f"times read as {unit}", False, lambda drive: drive.replace(times=drive.times / size))
        yield _finding(f"times in {unit}", tau, "s", f"a step would take {tau:.3g} s: time_stamps are in {unit}",
                       scaled, f"divide them by {size:.0e}")
    resolution = float(np.spacing(np.float32(np.abs(drive.times).max())))
    if resolution > 0.05 * tau and np.array_equal(drive.times, drive.times.astype(np.float32)):
        even = np.linspace(drive.times[0], drive.times[-1], drive.n_frames)
        cure = (Cure("times spread evenly", False, lambda drive: drive.replace(times=even))
                if np.abs(even - drive.times).max() <= 2 * resolution else None)
        yield _finding("float32 times", resolution, "s",
                       f"time_stamps are float32: known to {resolution:.2g} s only, where a step takes {tau:.2g} s",
                       cure, "store them as float64, or counted from the first frame")


def candidates(drive: Drive) -> Iterator[tuple[str, Cure, str]]:
    """Other readings of the file: name of the fault, cure, and what to do about it in the file's own terms."""
    for order, name in (((2, 3, 0, 1), "right image first: u_right, v_right, u_left, v_left"),
                        ((0, 2, 1, 3), "u_left, u_right, v_left, v_right"),
                        ((2, 0, 3, 1), "v_left, v_right, u_left, u_right"),
                        ((1, 0, 3, 2), "v_left, u_left, v_right, u_right")):
        yield "left and right swapped" if order[0] == 2 and order[1] == 3 else "rows of features", _pixels(
            f"rows of features read as {name}", lambda pixels, K, order=order: pixels[:, order]), \
            f"features holds {name}: write u_left, v_left, u_right, v_right"
    yield "normalised coordinates", _pixels(
        "normalised coordinates made into pixels by K",
        lambda pixels, K: pixels * np.tile([K[0, 0], K[1, 1]], 2) + np.tile([K[0, 2], K[1, 2]], 2)), \
        "features holds normalised coordinates: multiply them by the focal length and add the centre of K"
    for unit, size in (("mm", 1e3), ("cm", 1e2)):
        yield f"baseline in {unit}", _camera(f"baseline read as {unit}", lambda camera, size=size: replace(
            camera, baseline=camera.baseline / size)), f"b is in {unit}: divide it by {size:g}"
    yield "degrees", Cure("angular velocity read as degrees per second", False, lambda drive: drive.replace(
        twists=drive.twists * np.repeat([1, np.pi / 180], 3))), \
        "angular_velocity is in degrees per second: multiply it by pi / 180"
    yield "km/h", Cure("linear velocity read as km/h", False, lambda drive: drive.replace(
        twists=drive.twists * np.repeat([1 / 3.6, 1], 3))), \
        "linear_velocity is in km/h: divide it by 3.6"
    optical = se3.inverse(REGULAR_T_OPTICAL)
    for name, change in (("the inverse", se3.inverse),
                         ("of a camera frame with x forward, z up", lambda T: optical @ T),
                         ("the inverse, of a camera frame with x forward, z up", lambda T: optical @ se3.inverse(T))):
        yield "extrinsics", _camera(f"extrinsics read as {name}", lambda camera, change=change: replace(
            camera, cam_T_imu=change(camera.cam_T_imu))), f"the extrinsics are {name}: turn them into what the key says"
    yield from _fitted(drive)


def _fitted(drive):
    """K by a factor, its focal lengths by a factor, and its centre: what explains the motion best."""
    if not len(drive.pixels):
        return
    path = imu_path(drive)  # no K changes it
    one_matrix, focal_only = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 0]]), np.diag([1, 1, 0])
    for fault, scaled in (("images of another size", one_matrix), ("focal length", focal_only)):
        s = _best_factor(drive, scaled, path)
        nice = _NICE[np.argmin(np.abs(np.log(_NICE / s)))]
        if scaled is one_matrix and abs(nice / s - 1) < 0.04:
            s = float(nice)
        if abs(np.log(s)) > _MIN_FACTOR:
            cause, numbers = ((f"features come from images {s:.3g} times as large as those of K", "f and centre of K")
                              if scaled is one_matrix else (f"f of K is {1 / s:.3g} times the right one", "f of K"))
            yield fault, _with_K(lambda K, s=s, scaled=scaled: K * s**scaled, f"{numbers} multiplied by {s:.4g}"), \
                f"{cause}: multiply {numbers} by {s:.4g}"
    centre, middle = drive.camera.K[:2, 2], (drive.pixels[:, :2].min(axis=0) + drive.pixels[:, :2].max(axis=0)) / 2

    def moved(d):
        return _with_K(lambda K: K + np.outer([*d, 0], [0, 0, 1]), f"centre of K moved by {np.round(d, 1).tolist()} px")

    shift = scipy.optimize.minimize(lambda shift: min(unexplained(moved(shift)(drive), path), 1e6), middle - centre,
                                    method="Nelder-Mead", options={"maxfev": 60, "xatol": 1.0}).x
    # Turned extrinsics look much the same; but then the centre of K is the centre of the images
    nearer = np.linalg.norm(centre + shift - middle) < 0.7 * np.linalg.norm(centre - middle)
    if np.linalg.norm(shift) > _MIN_SHIFT * drive.camera.K[0, 0] and nearer:
        u, v = centre + shift
        yield "centre of K", moved(shift), f"the centre of K is wrong: [{u:.0f}, {v:.0f}] px fits"


def _best_factor(drive, scaled, path):
    """By what the entries `scaled` (3, 3) of K are best multiplied."""
    def score(log_s):
        return unexplained(_with_K(lambda K: K * np.exp(log_s * scaled), "")(drive), path)

    start = min(np.log(_NICE), key=score)
    best = scipy.optimize.minimize_scalar(score, bounds=(start - 0.4, start + 0.4), method="bounded",
                                          options={"xatol": 2e-3})
    return float(np.exp(best.x))


def _with_K(change, name):
    return _camera(name, lambda camera: replace(camera, K=change(camera.K)))


def _camera(name: str, change: Callable) -> Cure:
    return Cure(name, False, lambda drive: drive.replace(camera=change(drive.camera)))


def _pixels(name: str, change: Callable) -> Cure:
    return Cure(name, False, lambda drive: drive.replace(pixels=change(drive.pixels, drive.camera.K)))


def _finding(fault, size, unit, text, cure, advice):
    return Finding(fault, size, unit, 0.0, text, cure, advice, whole=True)


def surprise(drive: Drive, noise: Noise) -> np.ndarray:
    """(T,): summed NIS of each frame's measurements, each counted up to twice the gate's threshold."""
    most = 2 * kalman.gate_threshold(0.99)
    return np.array([np.minimum(step.innovation.nis, most).sum()
                     for step in window_slam.run(drive, noise, RightInvariant())])


def readings(drive: Drive, noise: Noise) -> Iterator[Finding]:
    """Another IMU sample, or -R t for the translation t, where the filter's innovations prefer it clearly.

    For cameras that see too little for visual odometry: each combination of the two readings drives the joint filter.
    """
    noise = replace(noise, **{key: max(getattr(noise, key), least) for key, least in _LEAST.items()})
    sample = "k" if drive.imu_sample == "k+1" else "k+1"
    changes = (use_imu_sample(sample), swap_translation())
    cost = {}
    for chosen in product((False, True), repeat=2):
        other = drive
        for cure, wanted in zip(changes, chosen):
            other = cure(other) if wanted else other
        cost[chosen] = surprise(other, noise)
    best = min(cost, key=lambda chosen: cost[chosen].sum())
    faults = (("IMU timing", f"read it so: imu_sample={sample!r}", f"IMU sample {sample}"),
              ("lever arm", "replace the translation t of cam_T_imu by -R t", "-R t for the translation of cam_T_imu"))
    for i, (fault, advice, name) in enumerate(faults):
        if not best[i]:
            continue
        without = cost[best[:i] + (False,) + best[i + 1:]]
        # What the filter's own claims are off by makes every gain look that much more certain
        inflation = max(1.0, cost[best].sum() / (4 * max(len(drive.landmark) - drive.n_landmarks, 1)))
        gain = float((without - cost[best]).sum() / inflation)
        p = chdtrc(1, gain)
        if p < SIGNIFICANCE:
            yield Finding(fault, gain, "of squared z", chance(p),
                          f"a filter that reads {name} is contradicted less by the tracks: summed NIS "
                          f"{cost[best].sum():.0f} in place of {without.sum():.0f}", changes[i], advice)
