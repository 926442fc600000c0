"""A drive with ground truth: a car with a stereo camera and an IMU goes once around a street loop.

`perfect_street_loop` makes the geometry (motion along `streets`, landmarks, exact pixels and an exact IMU), `add_noise`
spoils the sensors, `street_loop` does both. Every random draw comes from the seed, and road, landmarks, IMU
noise and pixel noise each have a stream of their own: another noise leaves the geometry alone.

The defaults resemble KITTI and the report's recordings: the camera, 10 m/s, about 60 landmarks in view, tracks of 5 to
100 frames that never come back, new ones born in bursts because a tracker looks for corners only now and then.

`python -m vislam_edu.simulate.drives [directory]` writes the two drives that the notebooks use.
"""

import sys
from pathlib import Path

import numpy as np

from .. import recordings, se3
from ..drive import Drive
from ..stereo import StereoCamera
from . import faults, streets

__all__ = ["IMAGE_SIZE", "add_noise", "along", "first_steps", "kitti_camera", "perfect_street_loop", "places",
           "returning_loop", "street_loop"]

IMAGE_SIZE = (1241, 376)  # px, width and height
SHORTEST_LOOP = 400.0  # m, unless asked for
CAMERA_HEIGHT = 1.65  # m above the road
FORGOTTEN = 100  # frames after which a place may be found again, as a new landmark
NEAREST = 3.0  # m, a tracker loses what comes closer: it changes too much from frame to frame

_ROAD, _TIMES, _TRACKS, _IMU, _PIXELS, _OUTLIERS, _RETURNING = range(7)


def _stream(seed, purpose):
    """The random numbers of one purpose: independent of what the other purposes draw."""
    return np.random.default_rng((seed, purpose))


def kitti_camera():
    """A `StereoCamera` like KITTI's, 1.1 m in front of the IMU and 0.3 m above it, looking straight ahead.

    Source: Geiger et al., Vision meets robotics: the KITTI dataset (2013), figures rounded.
    """
    K = np.array([[720.0, 0.0, 610.0], [0.0, 720.0, 173.0], [0.0, 0.0, 1.0]])
    cam_R_imu = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera_in_imu = np.array([1.1, 0.0, 0.3])
    return StereoCamera(K=K, baseline=0.54, cam_T_imu=se3.pose(cam_R_imu, -cam_R_imu @ camera_in_imu))


def _scene_points(rng, n, camera, image_size, depth):
    """n points in the camera frame (n, 3), m, where random pixels meet ground, street side or far view."""
    uv = rng.uniform((0, 0), image_size, (n, 2))
    ray = np.concatenate([uv, np.ones((n, 1))], -1) @ np.linalg.inv(camera.K).T
    with np.errstate(divide="ignore"):
        ground = np.where(ray[:, 1] > 0, CAMERA_HEIGHT / ray[:, 1], np.inf)
        street_side = rng.uniform(5, 30, n) / np.abs(ray[:, 0])  # poles and parked cars are near, facades far
    far_view = np.exp(rng.uniform(*np.log([min(25, 5 * depth[0]), depth[1]]), n))
    return ray * np.clip(np.minimum(np.minimum(ground, street_side), far_view), *depth)[:, None]


def _with_old_places(rng, share, points, old, world_T_imu, camera, depth, image_size):
    """The candidates (n, 3) of a detection, a share of them replaced by old places (m, 3) that this pose sees."""
    pixels, _ = camera.observe(world_T_imu, old)
    z = camera.to_cam(world_T_imu, old)[:, 2]
    in_view = (z >= depth[0]) & (z <= depth[1]) & ((pixels > 0) & (pixels < np.tile(image_size, 2))).all(-1)
    again = rng.permutation(np.unique(old[in_view], axis=0))
    is_old = rng.random(len(points)) < share
    is_old &= np.cumsum(is_old) <= len(again)
    points[is_old] = again[:np.count_nonzero(is_old)]
    return points


def _tracks(rng, world_T_imu, camera, *, visible, life, mean_life, redetect_every, depth, nearest, image_size,
            returning, rng_old):
    """Landmarks (M, 3) and what is seen of them: frame (N,), landmark (N,), pixels (N, 4), in this order.

    At each detection so many candidates become landmarks that the number in view, averaged until the next
    detection, is `visible`. A track ends when a random life is over, or when the point leaves one of the two
    images or comes too near. With a share `returning` above 0, that share of the candidates are places that were seen
    before and are in view again, as far as there are any: the tracker has lost them and gives them new numbers.
    """
    n_frames = len(world_T_imu)
    shortest, longest = life
    in_view = np.zeros(n_frames)
    landmarks, observations, ends = [np.empty((0, 3))], [], [np.empty(0)]
    n_landmarks = k = 0
    while k <= n_frames - shortest:
        following = k + 1 + rng.poisson(redetect_every - 1)
        n = 2 * visible
        world_T_imu_ahead = world_T_imu[k : k + longest, None]
        points = camera.to_world(world_T_imu[k], _scene_points(rng, n, camera, image_size, depth))
        if returning:
            old = np.concatenate(landmarks)[np.concatenate(ends) < k - FORGOTTEN]
            points = _with_old_places(rng_old, returning, points, old, world_T_imu[k], camera, depth, image_size)
        pixels, in_front = camera.observe(world_T_imu_ahead, points[None])
        trackable = in_front & ((pixels > 0) & (pixels < np.tile(image_size, 2))).all(-1)
        trackable &= pixels[..., 0] - pixels[..., 2] < camera.K[0, 0] * camera.baseline / nearest
        lives = shortest + rng.exponential(max(mean_life - shortest, 0), n)
        lives = np.minimum(np.logical_and.accumulate(trackable).sum(0), lives.astype(int))

        candidates = np.flatnonzero(lives >= shortest)
        until_next = slice(k, following)
        missing = visible - in_view[until_next].mean()
        share = np.minimum(lives[candidates] / (following - k), 1)  # of the time until the next detection
        chosen = candidates[: np.searchsorted(np.cumsum(share) - share / 2, missing)]

        step, which = np.nonzero(np.arange(len(trackable))[:, None] < lives[chosen])
        in_view += np.bincount(k + step, minlength=n_frames)
        observations.append((k + step, n_landmarks + which, pixels[step, chosen[which]]))
        landmarks.append(points[chosen])
        ends.append(k + lives[chosen])
        n_landmarks += len(chosen)
        k = following
    frame, landmark, pixels = (np.concatenate(parts) for parts in zip(*observations))
    order = np.lexsort((landmark, frame))
    return np.concatenate(landmarks), frame[order], landmark[order], pixels[order]


def perfect_street_loop(seed=0, *, frames=500, tau=0.1, jitter=0.0005, speed=10.0, loop_length=None, hills=1.0,
                        life=(5, 100), lane_change=0.0, name="street loop", **tracks):
    """A noise-free `Drive` around a street loop, with ground truth.

    frames, tau, jitter : number of frames, mean time between them (s), and its uniform variation (+- s).
    speed : mean speed, m/s; the car is slower in corners.
    loop_length : m once around the loop; by default the drive's length, so the last frame is back where the first one
        was, but at least 400 m. A loop longer than the drive is driven in part, a shorter one several times.
    hills : RMS height of the hills, m.
    lane_change : m to the left from the second lap on. life, name, tracks : arguments of `along`.

    The IMU sample k is the constant twist from frame k to k+1, exactly: `T[k+1] = T[k] exp(tau_k xi_k^)`. The last
    sample, which no frame follows, repeats the one before. The world of the ground truth has x along the first street
    and z up. Raises ValueError when an argument is out of range or the loop is too short for its corners.
    """
    shortest, longest = life
    if not 1 <= shortest <= longest:
        raise ValueError(f"life must be (shortest, longest) with 1 <= shortest <= longest, got {life}")
    if frames < max(2, shortest):
        raise ValueError(f"frames must be at least 2 and at least the shortest life {shortest}, got {frames}")
    if not 0 <= 2 * jitter < tau:
        raise ValueError(f"jitter must be in [0, tau / 2), got jitter {jitter} s and tau {tau} s")
    if speed <= 0:
        raise ValueError(f"speed must be > 0, got {speed} m/s")
    times = tau * np.arange(frames) + _stream(seed, _TIMES).uniform(-jitter / 2, jitter / 2, frames)
    times -= times[0]
    loop_length = max(speed * times[-1], SHORTEST_LOOP) if loop_length is None else loop_length
    world_T_imu = streets.drive_along(_stream(seed, _ROAD), times, speed, loop_length, hills, lane_change)
    return along(world_T_imu, times, seed, life=life, name=name, **tracks)


def along(world_T_imu, times, seed=0, *, visible=60, life=(5, 100), mean_life=50.0, redetect_every=6,
          depth=(5.0, 120.0), nearest=NEAREST, returning=0.0, camera=None, image_size=IMAGE_SIZE, name="path"):
    """A noise-free `Drive` along any path: poses (T, 4, 4) at times (T,), s.

    visible : landmarks in view, on average.
    life, mean_life : shortest and longest track, frames, and the mean of the random life; leaving the image
        shortens it.
    redetect_every : mean number of frames between two detections; only there are landmarks born.
    depth : nearest and farthest depth at which a landmark is born, m. nearest : m, a tracker loses what comes closer.
    returning : share of the candidates at a detection that are places seen before, where there are any in view. Such a
        place gets a new number and the same row of `truth_landmarks`.
    camera, image_size : by default `kitti_camera()` and its (width, height), px.

    The world of the ground truth is that of the poses. Raises ValueError for less than one landmark in view or less
    than one frame between detections.
    """
    if visible < 1 or redetect_every < 1:
        raise ValueError(f"visible and redetect_every must be >= 1, got {visible} and {redetect_every}")
    camera = kitti_camera() if camera is None else camera
    step = se3.log(se3.inverse(world_T_imu[:-1]) @ world_T_imu[1:]) / np.diff(times)[:, None]
    landmarks, frame, landmark, pixels = _tracks(
        _stream(seed, _TRACKS), world_T_imu, camera, visible=visible, life=life, mean_life=mean_life,
        redetect_every=redetect_every, depth=depth, nearest=nearest, image_size=image_size,
        returning=returning, rng_old=_stream(seed, _RETURNING))
    return Drive(times=times, twists=np.concatenate([step, step[-1:]]), camera=camera,
                 frame_start=np.searchsorted(frame, np.arange(len(times) + 1)), landmark=landmark, pixels=pixels,
                 n_landmarks=len(landmarks), name=name, source=f"simulated by vislam_edu.simulate, seed {seed}",
                 imu_sample="k", truth_world_T_cam=world_T_imu @ camera.imu_T_cam, truth_landmarks=landmarks)


def add_noise(drive, seed=0, *, sigma_v=0.5, sigma_omega=0.05, sigma_px=0.7, gyro_bias=(0.0, 0.0, 0.0)):
    """The drive with white noise on every IMU sample and every pixel coordinate, and a constant gyro bias.

    sigma_v m/s and sigma_omega rad/s per IMU sample and axis, sigma_px px, gyro_bias (3,) rad/s. The same seed draws
    the same standard normal numbers whatever the sigmas are, so runs that differ in a sigma compare like with like.
    """
    scale = np.repeat([sigma_v, sigma_omega], 3)
    twists = drive.twists + scale * _stream(seed, _IMU).standard_normal(drive.twists.shape)
    pixels = drive.pixels + sigma_px * _stream(seed, _PIXELS).standard_normal(drive.pixels.shape)
    twists[:, 3:] += gyro_bias
    return drive.replace(twists=twists, pixels=pixels)


def street_loop(seed=0, *, frames=500, sigma_v=0.5, sigma_omega=0.05, sigma_px=0.7, gyro_bias=(0.0, 0.0, 0.0),
                outlier_share=0.0, **geometry):
    """A `Drive` around a street loop with ground truth and noisy sensors.

    The noise is that of `add_noise`; outlier_share of the tracks are wrong as in `faults.outlier_tracks`; all else goes
    to `perfect_street_loop`.
    """
    drive = perfect_street_loop(seed, frames=frames, **geometry)
    if outlier_share:
        drive = faults.outlier_tracks(drive, outlier_share, _stream(seed, _OUTLIERS))
    return add_noise(drive, seed, sigma_v=sigma_v, sigma_omega=sigma_omega, sigma_px=sigma_px, gyro_bias=gyro_bias)


def first_steps():
    """The drive in data/first_steps.npz: 60 frames into a corner, 42 landmarks, few enough to watch each."""
    return street_loop(seed=0, frames=60, speed=7.0, loop_length=500.0, visible=14, life=(9, 100), mean_life=100.0,
                       name="first steps")


def returning_loop(seed=0, *, laps=1.25, returning=0.7, **options):
    """A `Drive` that comes back: a loop of 300 m, driven `laps` times, from the second lap on 0.5 m to the left.

    About eight landmarks in view, 5 to 25 m away; the IMU twice as noisy as usual and the pixels 1.4 times. returning :
    the share of what is detected on known road that was there before. options : of `street_loop`.
    """
    options = {"speed": 7.0, "loop_length": 300.0, "visible": 8, "depth": (5.0, 25.0), "mean_life": 100.0,
               "lane_change": 0.5, "sigma_v": 1.0, "sigma_omega": 0.1, "sigma_px": 0.7 * 2**0.5,
               "name": "returning loop"} | options
    frames = 1 + round(10 * laps * options["loop_length"] / options["speed"])  # ten a second
    return street_loop(seed, frames=frames, returning=returning, **options)


def places(drive):
    """(M,): of each track the first one that shows the same place, itself where there is none before it.

    The ground truth of data association: two tracks with the same row of `truth_landmarks` are one place.
    """
    _, first, which = np.unique(drive.truth_landmarks, axis=0, return_index=True, return_inverse=True)
    return first[which]


def write(directory="data"):
    """Write both drives, the street loop with all arguments at their defaults, and return their paths."""
    Path(directory).mkdir(parents=True, exist_ok=True)
    made = {Path(directory, "street_loop.npz"): street_loop(), Path(directory, "first_steps.npz"): first_steps()}
    for path, drive in made.items():
        recordings.save(drive, path)
    return list(made)


if __name__ == "__main__":
    for written in write(*sys.argv[1:2]):
        print(written)
