"""Scale of an estimate: the cameras measure lengths by their baseline, the IMU by its speed.

Both can be wrong. Over a drive the noise of the IMU's speed averages out and what is left of it is its scale, while
a stereo pair that is not quite calibrated loses or gains up to a per cent for good. So the path of a filter, whose
shape is the cameras', can be given the IMU's metre. No state of the filter does this: as a state, scale takes up
whatever else does not fit, and becomes certain of it.
"""

from dataclasses import replace

import numpy as np

from .. import se3
from ..mapping import MapBelief

PRIOR = 0.01  # of the cameras' scale, one standard deviation: what calibrated stereo pairs are found to be off by

EXPLAINED = f"""metre: the IMU's speed, because its noise averages out and the scale error of a stereo pair
    ({100 * PRIOR:.0f} % assumed) does not; the summary's `metre` is what the cameras' lengths were multiplied by"""


def running(world_T_imu, drive, sigma_v):
    """(T,): at each frame the IMU's forward speed over the path's so far, from 1 at frame 0. Needs no future.

    world_T_imu : (T, 4, 4). drive : Drive of T frames. sigma_v : m/s, of one IMU sample.
    With the speed u that the IMU measures and v that the path has, least squares with a prior at 1:
    g = (sum u v / sigma_v^2 + 1 / prior^2) / (sum v^2 / sigma_v^2 + 1 / prior^2).
    """
    along = se3.log(se3.inverse(world_T_imu[:-1]) @ world_T_imu[1:])[:, 0] / drive.taus
    weight = (PRIOR / max(sigma_v, 1e-3)) ** 2  # a perfect sensor would leave nothing to the prior
    both = 1 + weight * np.cumsum(drive.step_twists[:, 0] * along)
    path = 1 + weight * np.cumsum(along**2)
    return np.concatenate([[1.0], both / path])


def of_the_imu(slam, drive, noise):
    """A `pipeline.Slam` in the metre of the IMU's speed. drive : Drive. noise : Noise, its sigma_v of one sample."""
    return rescaled(slam, drive, running(slam.trajectory.world_T_imu, drive, noise.sigma_v))


def rescaled(slam, drive, g):
    """A `pipeline.Slam` in another metre: each step times g (T,) of its end, each landmark as seen from the car.

    The covariances stay: they are those of noise, and the scale is not known so well that its last per cent counts.
    """
    path = slam.trajectory.world_T_imu
    p, world_T_imu = path[:, :3, 3], path.copy()
    world_T_imu[1:, :3, 3] = p[0] + np.cumsum(g[1:, None] * np.diff(p, axis=0), axis=0)
    seen, last = slam.map.seen, np.maximum(drive.last_seen, 0)  # the frame of each landmark's last estimate
    landmarks = world_T_imu[last, :3, 3] + g[last, None] * (slam.map.landmarks - p[last])
    return replace(slam, metre=float(g[-1]), trajectory=replace(slam.trajectory, world_T_imu=world_T_imu),
                   map=MapBelief(np.where(seen[:, None], landmarks, 0), slam.map.covariance, seen))
