"""Faults of real recordings, planted on purpose in a good one, so that an audit can be seen to find them.

Each function returns a new `Drive` and says in its `history` what was planted. The ground truth stays what it was.
"""

import numpy as np


def _planted(drive, what, **fields):
    return drive.replace(history=(*drive.history, f"planted: {what}"), **fields)


def flip_imu_axes(drive, signs=(1, -1, -1)):
    """The extrinsics belong to an IMU frame with some axes reversed; the samples stay as they were.

    signs (3,) of +1 and -1 with product +1 (a reflection is no frame). (1, -1, -1), forward-right-down extrinsics with
    forward-left-up samples, is the fault of the report's dataset 3. The cure is the same flip again.
    """
    signs = np.asarray(signs)
    if signs.shape != (3,) or not np.isin(signs, (-1, 1)).all() or signs.prod() != 1:
        raise ValueError(f"signs must be three numbers +1 or -1 whose product is +1, got {signs.tolist()}")
    flip = np.diag([*signs, 1.0])
    return _planted(drive.with_extrinsics(drive.camera.cam_T_imu @ flip), f"IMU axes flipped by {signs.tolist()}")


def wrong_lever_arm(drive, translation=None):
    """The extrinsics carry a wrong translation (3,), m.

    By default the camera's position in the IMU frame, written where cam_T_imu wants the IMU's position in the
    camera frame: the two differ by `t = -R p`, and 0027.npz confuses them.
    """
    cam_T_imu = drive.camera.cam_T_imu.copy()
    cam_T_imu[:3, 3] = drive.camera.imu_T_cam[:3, 3] if translation is None else translation
    return _planted(drive.with_extrinsics(cam_T_imu), f"lever arm set to {cam_T_imu[:3, 3].round(3).tolist()} m")


def add_gyro_bias(drive, bias):
    """Every angular velocity is off by the constant bias (3,), rad/s."""
    bias = np.broadcast_to(np.asarray(bias, float), 3)
    return _planted(drive, f"gyro bias {bias.tolist()} rad/s", twists=drive.twists + np.pad(bias, (3, 0)))


def delay_imu(drive, samples=1):
    """The IMU comes late: sample k + samples holds what sample k held. The first ones repeat the first.

    After a delay of one, sample k+1 tells the motion from frame k to k+1, as in the real recordings, but the
    drive's `imu_sample` still claims what it claimed before.
    """
    if not 0 <= samples < drive.n_frames:
        raise ValueError(f"samples must be in 0..{drive.n_frames - 1}, got {samples}")
    late = np.maximum(np.arange(drive.n_frames) - samples, 0)
    return _planted(drive, f"IMU late by {samples} samples", twists=drive.twists[late])


LENS_TERMS = {"disparity": (False, lambda x, y: (1 + 0 * x, 0 * x)),
              "disparity with u^2": (False, lambda x, y: (x**2, 0 * x)),
              "disparity with v^2": (False, lambda x, y: (y**2, 0 * x)),
              "row saddle": (False, lambda x, y: (0 * x, x * y)),
              "focal length": (True, lambda x, y: (x, y)),
              "radial": (True, lambda x, y: ((x**2 + y**2) * x, (x**2 + y**2) * y)),
              "tangential along u": (True, lambda x, y: (3 * x**2 + y**2, 2 * x * y)),
              "tangential along v": (True, lambda x, y: (2 * x * y, x**2 + 3 * y**2))}


def lens_error(drive, **px):
    """The lenses, or the rectification, are not what the calibration says: smooth shifts of the pixels.

    px : the size of each term of `LENS_TERMS` (blanks and ^ written as _), px at tan = 1, which is one focal length
    from the image's centre. Terms of disparity and rows concern the left image against the right one (u_left - u_right
    and v_left - v_right), half of it each; the others move both images.
    A lens of the left camera that is decentred, or a camera that is yawed, makes a row saddle and bends the disparity
    with u^2 by the same number of px.
    Source: Brown, Decentering distortion of lenses, 1966.
    """
    return _planted(drive, "lens error", pixels=drive.pixels + lens_shift(drive, **px))


def lens_shift(drive, **px):
    """(N, 4) px: by what an error of the lenses shifts each observation. px : see `lens_error`."""
    shift, K = np.zeros_like(drive.pixels), drive.camera.K
    for term, (both, field) in LENS_TERMS.items():
        size = px.pop(term.replace(" ", "_").replace("^", "_"), 0.0)
        for image, sign in ((slice(0, 2), 0.5), (slice(2, 4), -0.5)):
            x, y = ((drive.pixels[:, image] - K[:2, 2]) / K[[0, 1], [0, 1]]).T
            shift[:, image] += size * (1 if both else sign) * np.stack(field(x, y), axis=-1)
    if px:
        raise ValueError(f"lens_error knows no {', '.join(px)}; it knows {', '.join(LENS_TERMS)}")
    return shift


def copy_frames(drive, frames=None):
    """At some frames the tracker copies its old pixels and goes on from them.

    There, every track that was seen one frame before has exactly its old pixels. Afterwards it moves as the true track
    moves, but from the stale place: each copy leaves it one increment behind for good, noise included.
    frames : copy frames; by default every frame after the first where a landmark is born, as in the real recordings.
    """
    frames = np.unique(drive.first_seen[drive.first_seen > 0]) if frames is None else np.asarray(frames, int)
    if frames.size and not (frames.min() > 0 and frames.max() < drive.n_frames):
        raise ValueError(f"copy frames must lie in 1..{drive.n_frames - 1}, got {frames.min()}..{frames.max()}")
    order = np.lexsort((drive.frame, drive.landmark))  # track by track
    frame, landmark, pixels = drive.frame[order], drive.landmark[order], drive.pixels[order]

    row = np.arange(len(landmark))
    track_begin = np.searchsorted(landmark, landmark)
    copy = (row > track_begin) & np.isin(frame, frames)
    increment = np.diff(pixels, axis=0, prepend=pixels[:1])
    lost = np.cumsum(np.where(copy[:, None], increment, 0), axis=0)
    stale = pixels - (lost - lost[track_begin])
    copied_from = np.maximum.accumulate(np.where(copy, 0, row))  # exactly the same numbers, not to rounding
    result = np.empty_like(stale)
    result[order] = stale[copied_from]
    return _planted(drive, f"pixels copied at {len(frames)} frames", pixels=result)


def outlier_tracks(drive, share, seed=0):
    """A share in [0, 1] of the tracks is wrong for its whole life; needs ground truth. seed : int or numpy Generator.

    Half of them move: the point has a constant velocity of 2 to 8 m/s along the ground (the truth's world has z up);
    its true landmark is where it was first seen. Half are stereo mismatches: the right pixel is off by a constant 5 to
    30 px to the left or right (disparities may become negative, as in the real recordings). A mover that would leave
    the image before its track ends is made a mismatch instead: tracks keep their lengths.
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share of outlier tracks must be in [0, 1], got {share}")
    if drive.truth_landmarks is None or drive.truth_world_T_cam is None:
        raise ValueError("moving points need a drive with truth_world_T_cam and truth_landmarks")
    rng = np.random.default_rng(seed)
    M, camera = drive.n_landmarks, drive.camera
    chosen = rng.permutation(M) < round(share * M)
    moves = chosen & (rng.random(M) < 0.5)
    course, speed = rng.uniform(0, 2 * np.pi, M), rng.uniform(2, 8, M)
    velocity = speed[:, None] * np.stack([np.cos(course), np.sin(course), np.zeros(M)], -1)
    mismatch = rng.choice([-1, 1], M) * rng.uniform(5, 30, M)

    frame, landmark = drive.frame, drive.landmark
    age = drive.times[frame] - drive.times[drive.first_seen[landmark]]
    world_T_imu = (drive.truth_world_T_cam @ camera.cam_T_imu)[frame]
    stands = drive.truth_landmarks[landmark]
    there, _ = camera.observe(world_T_imu, stands)
    moved, in_front = camera.observe(world_T_imu, stands + age[:, None] * velocity[landmark])
    # Inside the image, as far as this drive shows where its borders are.
    inside = (moved >= drive.pixels.min(0)) & (moved <= drive.pixels.max(0))
    moves[landmark[~(in_front & inside.all(-1))]] = False

    pixels = drive.pixels + np.where(moves[landmark, None], moved - there, 0)
    pixels[:, 2] += np.where(chosen & ~moves, mismatch, 0)[landmark]
    return _planted(drive, f"{chosen.sum()} outlier tracks of {M}", pixels=pixels)
