"""Is the stereo pair what its calibration says? Two checks that need neither ground truth nor IMU.

An error of the lens or the rectification is the same in every frame, so it does not average out, and since all tracks
share it, no comparison of tracks chosen at random shows it: what shows is where in the image a track was.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtr

from . import imu_alignment, visual_odometry
from .report import Finding
from .track_checks import SIGNIFICANCE, chance

MIN_SADDLE = 0.4  # px at one focal length from the centre
MIN_APART = 0.005  # of the speed

ADVICE = ("no constant can be fitted, since the rows do not show how the disparity is bent: calibrate the cameras "
          "anew, and do not trust a covariance without calibration error (run --calibration)")


def image_coordinates(drive):
    """(N, 2): where the left image shows each observation, in focal lengths from the centre."""
    K = drive.camera.K
    return (drive.pixels[:, :2] - K[:2, 2]) / K[[0, 1], [0, 1]]


def saddle(drive) -> tuple[float, float]:
    """c of v_left - v_right = a + b u' + d v' + c u' v', px at one focal length, and its standard error.

    Least squares, what is far off left out. Rows of one track may be wrong together, so the error is that of sums over
    tracks (the sandwich). NaN and infinite for a drive with hardly any observation.
    """
    x, y = image_coordinates(drive).T
    A, rows = np.column_stack([np.ones_like(x), x, y, x * y]), drive.pixels[:, 1] - drive.pixels[:, 3]
    if len(rows) < 100:
        return np.nan, np.inf
    left = rows - np.median(rows)
    for _ in range(3):
        inlier = np.abs(left) <= max(imu_alignment.CUT * 1.4826 * np.median(np.abs(left)), 1e-9)
        fitted = np.linalg.lstsq(A[inlier], rows[inlier], rcond=None)[0]
        left = rows - A @ fitted
    covariance = np.linalg.pinv(A[inlier].T @ A[inlier])
    score = A * np.where(inlier, left, 0.0)[:, None]
    by_track = np.stack([np.bincount(drive.landmark, column) for column in score.T], axis=-1)
    sandwich = covariance @ (by_track.T @ by_track) @ covariance
    return float(fitted[3]), float(max(sandwich[3, 3], 1e-18) ** 0.5)


def row_saddle(drive):
    """v_left - v_right bent over the image: a yaw between the cameras or a decentred lens."""
    size, error = saddle(drive)
    p = 2 * ndtr(-abs(size) / error)
    if p < SIGNIFICANCE and abs(size) > MIN_SADDLE:
        yield Finding(
            "row saddle", size, "px at one focal length", chance(p),
            f"v_left - v_right goes with u' v' over the image, by {size:+.2f} +- {error:.2f} px: one camera is yawed "
            "against the other or a lens is decentred; either bends the disparity too, by about as many px times u'^2",
            None, ADVICE)


@dataclass(frozen=True, eq=False)
class Halves:
    """The cameras' motion from one half of the tracks less that from the other half.

    twist : (6,) mean over the steps, [m/s, rad/s], in the left camera's frame. covariance : (6, 6) of it, from how much
    pieces of ten steps scatter. forward : share of the speed by which the halves differ along the way. pieces : number.
    """

    twist: np.ndarray
    covariance: np.ndarray
    forward: float
    pieces: int

    @property
    def distance2(self) -> float:
        """Squared Mahalanobis distance: 6 on average where noise is all that the halves differ by."""
        return float(self.twist @ np.linalg.solve(self.covariance, self.twist))

    @property
    def p_value(self) -> float:
        """How often noise alone would part the halves as much; the scatter itself is known from 6 numbers a piece."""
        return float(fdtrc(6, 6 * self.pieces, self.distance2 / 6))


def compare_halves(drive, first) -> Halves | None:
    """The tracks first (M,) bool against the others; None when fewer than 30 steps are known from both halves."""
    one, other = (visual_odometry.estimate(drive.keep_landmarks(mask)) for mask in (first, ~first))
    both = np.flatnonzero(imu_alignment.usable_steps(one) & imu_alignment.usable_steps(other))
    if len(both) < 30:
        return None
    covariance = one.twist_covariance[both] + other.twist_covariance[both]
    weight = np.linalg.inv(covariance)
    difference = one.twists[both] - other.twists[both]
    total = np.linalg.inv(weight.sum(axis=0))
    score = np.matvec(weight, difference)
    mean = total @ score.sum(axis=0)
    left = score - np.matvec(weight, mean)
    blocks = np.stack([np.bincount(np.arange(len(both)) // 10, column) for column in left.T], axis=-1)
    # Steps share the noise of the frame between them, which cancels, and the slip of a track, which does not
    factor = np.mean(np.diagonal(total @ (blocks.T @ blocks) @ total) / np.diagonal(total))
    speed = np.median(np.abs(one.twists[both, 2]))
    return Halves(mean, factor * total, float(mean[2] / max(speed, 1e-9)), len(blocks))


def halves_by_place(drive) -> Halves | None:
    """Tracks near the middle column of the image against those further out."""
    far_out = np.abs(image_coordinates(drive)[:, 0])
    count = np.maximum(np.bincount(drive.landmark, minlength=drive.n_landmarks), 1)
    mean = np.bincount(drive.landmark, far_out, minlength=drive.n_landmarks) / count
    return compare_halves(drive, mean < np.median(far_out)) if len(far_out) else None


def halves_at_random(drive, seed=0) -> Halves | None:
    """Tracks drawn by lot against the rest: what they share does not show."""
    return compare_halves(drive, np.random.default_rng(seed).random(drive.n_landmarks) < 0.5)


def split_halves(by_place, at_random):
    """Two halves of the tracks that see different motions, depending on where in the image they are (`Halves`)."""
    if by_place is None or at_random is None:
        return
    p = by_place.p_value
    if p < SIGNIFICANCE and abs(by_place.forward) > MIN_APART:
        yield Finding(
            "split halves", by_place.forward, "of the speed", chance(p),
            f"tracks near the middle of the image see a speed that differs by {100 * by_place.forward:+.1f} % from "
            f"what those further out see (squared distance {by_place.distance2:.0f}, 6 is right; halves at random: "
            f"{at_random.distance2:.1f}): an error that tracks share and noise does not explain",
            None, ADVICE)


def facts(drive, by_place, at_random):
    """What the checks measure whether anything is wrong or not, by name."""
    facts = {"saddle of v_left - v_right [px at tan = 1]": "{:.2f} +- {:.2f}".format(*saddle(drive))}
    if by_place is not None and at_random is not None:
        facts["halves of the tracks, squared distance (6 is right)"] = (
            f"drawn at random {at_random.distance2:.1f}, by place in the image {by_place.distance2:.1f}")
    return facts
