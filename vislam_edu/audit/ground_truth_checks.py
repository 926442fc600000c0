"""Ground truth is checked before it judges: does it move as the cameras and the IMU say?

A mistake in how poses were written or read makes errors of thousands of standard deviations that say nothing about a
filter. Motions over a second are compared, not poses, so the world frame does not matter. Truth that fits the cameras
or the IMU is believed; otherwise each likely mistake is undone in turn, and the one after which truth fits is named.
Slips in time (a shift, a missing row) show only from frame to frame, against the cameras.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

import numpy as np
from scipy.spatial.transform import Rotation

from .. import se3
from ..drive import Drive
from ..recordings.extrinsics import REGULAR_T_OPTICAL
from . import visual_odometry

_STRIDE = 1.0  # s
_TURN = 0.2  # rad over a stride that counts as much as an error of the whole length
_DOUBTFUL = 0.3  # mismatch; a speed wrong by 10 % makes 0.1
_UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "feet": 1 / 0.3048}  # how many are a metre
_SHIFTS = 30  # frames by which truth may be shifted in time
_EVIDENCE = 50.0  # by how much the squared errors must fall, in units of their variance


def doubt(drive: Drive) -> str | None:
    """What speaks against a drive's ground truth, in a sentence that says what would undo it; None where nothing does.

    It judges only what it can: None also without truth, or with less than two known poses.
    """
    truth = drive.truth_world_T_cam
    if truth is None or np.isfinite(truth[:, 0, 0]).sum() < 2:
        return None
    camera = drive.camera
    imu = camera.cam_T_imu @ se3.exp(drive.step_twists * drive.taus[:, None]) @ camera.imu_T_cam
    motions = visual_odometry.estimate(drive)
    cameras = np.where(motions.ok[:, None, None], motions.motion, imu)
    n = int(np.clip(round(_STRIDE / np.median(drive.taus)), 1, drive.n_frames - 1))
    references = [_over(steps, n) for steps in (cameras, imu)]
    said = _between(truth, n)
    known = np.isfinite(said[:, 0, 0])
    if not known.any():
        return None
    sizes = "; ".join(f"by {name} {_sizes(strides[known])}" for name, strides in
                      zip(("the truth", "the cameras", "the IMU"), (said, *references)))
    mismatch = min(_mismatch(said, reference) for reference in references)
    likely: tuple[str, str] | None = None
    if mismatch > _DOUBTFUL and np.ptp(truth[np.isfinite(truth[:, 0, 0]), :3, :3], axis=0).max() < 1e-6:
        likely = "has one rotation for all poses", "only its positions can be used"
    elif mismatch > _DOUBTFUL:
        trials = [(min(_mismatch(_between(poses, n), reference) for reference in references), mistake, undo)
                  for mistake, undo, poses in _undone(drive, references[0], said)]
        least, *named = min(trials, key=lambda trial: round(trial[0], 2))  # of equal ones the first
        likely = (named[0], named[1]) if least < min(_DOUBTFUL, mismatch / 2) else None
    likely = likely or _slip(truth, cameras)
    if likely is None and mismatch > _DOUBTFUL:
        likely = "moves neither as the cameras nor as the IMU say", "compare its format with what is read"
    if likely is None:
        return None
    mistake, undo = likely
    return (f"the ground truth {mistake}: {undo}; in {n} frames the motion is {sizes}. "
            "As it is, drift and NEES are not meaningful")


def _undone(drive: Drive, reference: np.ndarray, said: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """Each likely mistake, what undoes it, and the poses of the camera (T, 4, 4) after that."""
    left_T_cam = np.eye(4) if drive.left_T_cam is None else drive.left_T_cam
    assert drive.truth_world_T_cam is not None
    poses = drive.truth_world_T_cam @ se3.inverse(left_T_cam)  # as they stand in the file
    known = np.isfinite(poses[:, 0, 0])
    w_first = poses.copy()
    w_first[known, :3, :3] = Rotation.from_quat(Rotation.from_matrix(poses[known, :3, :3]).as_quat()[:, [1, 2, 3, 0]]
                                                ).as_matrix()
    yield "has w first in its quaternions", "put it last (time x y z qx qy qz qw)", w_first @ left_T_cam
    yield "holds poses of the IMU", "multiply each by imu_T_cam from the right", poses @ drive.camera.imu_T_cam
    yield ("holds poses of a camera frame x forward, y left, z up",
           "multiply each from the right by [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]",
           poses @ REGULAR_T_OPTICAL @ left_T_cam)
    yield "holds inverse poses, cam_T_world", "invert each", se3.inverse(poses) @ left_T_cam
    factor = np.nanmedian(np.linalg.norm(said[:, :3, 3], axis=-1)) / np.median(
        np.linalg.norm(reference[:, :3, 3], axis=-1))
    unit, factor = next(((f"in {name}", size) for name, size in _UNITS.items() if 0.85 < factor / size < 1.15),
                        (f"{factor:.3g} times too long", factor))
    scaled = poses.copy()
    scaled[:, :3, 3] /= factor
    yield f"has positions {unit}", f"divide them by {factor:.4g}", scaled @ left_T_cam


def _slip(truth: np.ndarray, cameras: np.ndarray) -> tuple[str, str] | None:
    """A shift in time, or a missing row, and what undoes it."""
    steps = _between(truth, 1, every=1)
    n, most = len(steps), min(_SHIFTS, len(steps) // 4)
    # The same steps of the cameras for every shift: how noisy they are must not decide
    errors = {s: _errors(steps[most - s:n - most - s], cameras[most:n - most]) for s in range(-most, most + 1)}
    errors = {s: e for s, e in errors.items() if np.isfinite(e[:, 0]).mean() > 0.5}
    if 0 not in errors or 1 not in errors:
        return None  # too few steps are known
    scale = np.min([1.4826 * np.nanmedian(np.abs(e), axis=0) for e in errors.values()], axis=0) + 1e-6

    def cost(error: np.ndarray, far: float = 100.0) -> np.ndarray:
        """Squared errors of each step in units of their variance; what a number adds grows no further than `far`."""
        return np.minimum((error / scale) ** 2, far).sum(axis=-1)

    gain = {s: np.nansum(cost(errors[0], 9) - cost(e, 9)) for s, e in errors.items()}  # 9: no single step decides
    shift = max(gain, key=lambda s: gain[s])
    as_is, later = cost(_errors(steps, cameras))[:-1], cost(_errors(steps[:-1], cameras[1:]))
    double = cost(_errors(steps[:-1], cameras[:-1] @ cameras[1:]))
    # Row m is missing: steps before m - 1 are right, step m - 1 is two of the cameras', and the later ones are shifted
    saved = np.nan_to_num(as_is - double)
    saved[:-1] += np.cumsum(np.nan_to_num(as_is - later)[:0:-1])[::-1]
    m = int(saved.argmax()) + 1
    of_a_row = np.nansum((cost(errors[0], 9) - cost(errors[1], 9))[max(0, m + 1 - most):])  # as `gain` counts
    if saved.max() > _EVIDENCE and gain[shift] < of_a_row + _EVIDENCE:
        return f"lacks the row of frame {m}, so that all later ones belong to the next frame", "insert that row"
    if gain[shift] > _EVIDENCE:
        return f"is shifted in time, its pose of frame k belongs to frame k{shift:+d}", f"move it by {shift:+d} frames"
    return None


def _errors(truth: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(n, 6) m and rad, NaN where truth is."""
    known = np.isfinite(truth[:, 0, 0])
    error = np.full((len(truth), 6), np.nan)
    error[known] = se3.log(se3.inverse(reference[known]) @ truth[known])
    return error


def _between(poses: np.ndarray, n: int, every: int | None = None) -> np.ndarray:
    """Motions from frame k to k + n, for every n-th frame k or as often as asked."""
    starts = np.arange(0, len(poses) - n, every or n)
    return se3.inverse(poses[starts]) @ poses[starts + n]


def _over(steps: np.ndarray, n: int) -> np.ndarray:
    """Motions over n steps, for every n-th step."""
    starts = np.arange(0, len(steps) + 1 - n, n)
    return reduce(np.matmul, (steps[starts + j] for j in range(n)))


def _mismatch(truth: np.ndarray, reference: np.ndarray) -> float:
    """0 where motions agree, 1 where they have nothing in common."""
    known = np.isfinite(truth[:, 0, 0])
    length = max(0.05, float(np.median(np.linalg.norm(reference[:, :3, 3], axis=-1))))
    off = np.linalg.norm(truth[known, :3, 3] - reference[known, :3, 3], axis=-1) / length
    turned = Rotation.from_matrix(reference[known, :3, :3].mT @ truth[known, :3, :3]).magnitude() / _TURN
    return float(np.minimum(off + turned, 1).mean())


def _sizes(motions: np.ndarray) -> str:
    turns = np.degrees(Rotation.from_matrix(motions[:, :3, :3]).magnitude())
    return f"{np.median(np.linalg.norm(motions[:, :3, 3], axis=-1)):.3g} m and {np.median(turns):.2g} degrees"
