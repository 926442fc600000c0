"""What can be wrong with the tracks of a recording: each check yields a `Finding`, or nothing.

The first five look at the tracks alone, `outlier_tracks` holds them against the cameras' own motion.
"""

import numpy as np
from scipy.special import bdtrc, ndtr, pdtrc

from . import cures, track_health, visual_odometry
from .report import Finding

SIGNIFICANCE = 1e-4  # a clean drive is accused of each fault less often than this

# What matters: below, a filter would not notice
MIN_BEHIND_INFINITY = 5e-4  # share of the observations
MIN_ROW_OFFSET = 0.5  # px
MIN_OUTLIER_TRACKS = 0.01  # share of the tracks
MIN_OUTLIER_NOISE = 0.5  # px: a track that noise of this size explains does little harm


def chance(p):
    """A p-value that underflowed is still not the zero of a certain thing."""
    return float(np.clip(p, 1e-300, 1.0))


def without_motion(drive):
    """All findings of the tracks and times alone: these checks are quick, for they need no motion of the cameras."""
    return [*copy_frames(drive, track_health.copy_steps(drive)), *frozen(drive), *behind_infinity(drive),
            *row_offset(drive), *missing_frames(drive)]


def copy_frames(drive, copy_steps):
    """Frames that repeat the pixels of the frame before. copy_steps : (T-1,) bool, steps that end in one."""
    count = int(copy_steps.sum())
    if count:
        share = track_health.copied(drive).mean()
        yield Finding("copy frames", count, "frames", 0.0,
                      f"at {count} frames every track seen there and one frame before has exactly its old pixels "
                      f"({share:.1%} of all observations are such copies)",
                      cures.end_tracks_at_copies(), "end each track before its first copy; what it says later is stale")


def frozen(drive):
    """Tracks that stand still, pixel for pixel, while others move."""
    bad = track_health.frozen(drive)
    if bad.any():
        yield Finding("frozen tracks", int(bad.sum()), "observations", 0.0,
                      f"{bad.sum()} observations have exactly the pixels of the frame before while other tracks move",
                      cures.end_tracks("tracks ended before they froze", track_health.frozen),
                      "end each track before it freezes")


def behind_infinity(drive):
    """Disparities below zero by more than noise explains: left and right show different things."""
    bad = track_health.behind_infinity(drive)
    p = float(pdtrc(bad.sum() - 1, len(bad) * ndtr(-5)))
    if p < SIGNIFICANCE and bad.mean() > MIN_BEHIND_INFINITY:
        yield Finding("behind infinity", int(bad.sum()), "observations", chance(p),
                      f"{bad.sum()} disparities ({bad.mean():.2%}) are below zero by more than noise explains, "
                      f"down to {track_health.disparity(drive).min():.1f} px: left and right show different things",
                      cures.end_tracks("tracks ended before their first impossible disparity",
                                       track_health.behind_infinity),
                      "end each track before its first impossible disparity")


def row_offset(drive):
    """A lasting difference of v_left and v_right: the pair is not rectified."""
    difference = drive.pixels[:, 1] - drive.pixels[:, 3]
    if not difference.size:
        return
    offset = float(np.median(difference))
    error = 1.2533 * 2**0.5 * visual_odometry.row_noise(drive.pixels) / len(difference) ** 0.5  # of a median
    p = 2 * ndtr(-abs(offset) / max(error, 1e-12))
    if p < SIGNIFICANCE and abs(offset) > MIN_ROW_OFFSET:
        cure = cures.Cure(f"v_right raised by {offset:.2f} px", True,
                          lambda drive: drive.replace(pixels=drive.pixels + [0, 0, 0, offset]))
        yield Finding("row offset", offset, "px", chance(p),
                      f"v_left - v_right is {offset:+.2f} px in the middle: the pair is not rectified",
                      cure, f"add {offset:.2f} px to v_right")


def missing_frames(drive):
    """Steps so long that frames must be missing from them."""
    usual = np.median(drive.taus) if drive.n_frames > 1 else 1.0
    missing = int((np.round(drive.taus / usual) - 1).clip(min=0).sum())
    if missing:
        yield Finding(
            "missing frames", missing, "frames", 0.0,
            f"steps of up to {drive.taus.max():.3f} s where {usual:.3f} s is usual: about {missing} frames are missing",
            None, "trust the filter less over such a step; the IMU sample is held for all of it")


def outlier_tracks(drive, motions):
    """Tracks that contradict the cameras' motion (`FrameMotions`) most of the time."""
    known = motions.ok[motions.step]
    landmark = drive.landmark[motions.before]
    distance = np.sqrt(motions.mahalanobis2) * min(1.0, motions.sigma_px / MIN_OUTLIER_NOISE)
    off = known & (distance**2 > visual_odometry.INLIER_D2)
    pairs, wrong = (np.bincount(landmark[rows], minlength=drive.n_landmarks) for rows in (known, off))
    judged = pairs >= 2
    outliers = judged & (wrong > pairs / 2)
    # Two pairs of two, or three of four ...: the likeliest innocent way is two of two
    by_chance = (1 - visual_odometry.INLIER_PROBABILITY) ** 2
    p = float(bdtrc(outliers.sum() - 1, max(judged.sum(), 1), by_chance))
    share = outliers.sum() / max(judged.sum(), 1)
    if p < SIGNIFICANCE and share > MIN_OUTLIER_TRACKS:
        flow = np.abs(drive.pixels[motions.after] - drive.pixels[motions.before]).max(axis=1)
        still = off & (flow < 3 * motions.sigma_px)
        stuck = outliers & (np.bincount(landmark[still], minlength=drive.n_landmarks) > pairs / 2)
        text = f"{outliers.sum()} of {judged.sum()} tracks ({share:.1%}) contradict the others most of the time"
        if stuck.any():
            text += f"; {stuck.sum()} of them stand still in the image when they should move"
        yield Finding("outlier tracks", float(share), "share of the tracks", chance(p), text,
                      cures.drop_tracks(drive, np.flatnonzero(outliers)), "drop them, or rely on the filter's gate")


def facts(drive, cured, motions):
    """What the tracks measure whether anything is wrong or not, by name. cured : the drive with its tracks cured."""
    disparity, lengths = track_health.disparity(drive), track_health.lengths(drive)
    facts = {"tracks in view (least, mean, most)": [int(drive.visible.min()), float(drive.visible.mean()),
                                                    int(drive.visible.max())],
             "track length in frames (median, longest)": [float(np.median(lengths)) if lengths.size else 0.0,
                                                          int(lengths.max(initial=0))],
             "disparities at or below 0 px": int((disparity <= 0).sum()),
             "disparities below 1 px": int((disparity < 1).sum()),
             "noise of v_left - v_right per coordinate [px]": visual_odometry.row_noise(drive.pixels),
             "steps whose motion the cameras know": f"{motions.ok.mean():.1%}" if motions.ok.size else "none"}
    if len(cured.landmark) < len(drive.landmark):
        facts["observations left after the cures of tracks"] = f"{len(cured.landmark) / len(drive.landmark):.1%}"
    if motions.ok.any():
        wrong = ~motions.inlier[motions.ok[motions.step]]
        facts["pairs of observations that contradict their step's motion"] = f"{wrong.mean():.1%}"
    return facts
