"""The measurements of one frame against each other: a second gate, after the update.

    window_slam.run(drive, noise, RightInvariant(), process_frame=consensus.process_frame)

The gate of `window_slam.update` judges each landmark alone, and the prior is too loose to reject outliers: with an IMU
of 0.05 rad/s the next pixel is uncertain by several px, and a wrong track fits in. To fit in together, all wrong tracks
would have to be wrong in the same way. So the frame is updated with all that pass, each measurement is compared with
the prediction from the others, those that contradict it are left out, and the update begins again from the prior.

>>> from vislam_edu import Noise, RightInvariant, consensus, load, window_slam
>>> steps = window_slam.run(load("first_steps"), Noise(), RightInvariant(), process_frame=consensus.process_frame)
>>> next(steps).k
0

Source: the idea of Civera et al., 1-point RANSAC for extended Kalman filtering, Journal of Field Robotics 2010, with
the concentration steps of Rousseeuw and Van Driessen, Computing LTS regression, DMKD 2006, in place of random
samples.
"""

from dataclasses import replace

import numpy as np

from . import kalman, window_slam
from .kalman import Belief, Innovation
from .window_slam import Frame, UpdateSettings

ROUNDS = 3  # the choice settles in one or two


def process_frame(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> Frame:
    """What a frame does, see `window_slam.run`: as `correlated`, and the measurements must agree with each other.

    Returns (prior, posterior, Innovation); its `accepted` are those that the posterior rests on.
    """
    return window_slam.correct_frame(update, prior, ids, pixels, settings)


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> tuple[Belief, Innovation]:
    """`window_slam.update` with those measurements that agree with the posterior they lead to.

    ids : (m,). pixels : (m, 4). Returns (posterior, Innovation).
    """
    if len(ids) == 0:
        return prior, kalman.NO_INNOVATION
    innovation, H = window_slam.compute_innovation(prior, ids, pixels, settings)

    def updated(chosen: np.ndarray) -> Belief:
        return window_slam.apply_update(prior, H.only(chosen), innovation.residual[chosen], settings)

    passed = innovation.accepted
    kept, posterior = passed, updated(passed)
    for _ in range(ROUNDS):
        agreeing = passed.copy()
        distance = after_fit(posterior, ids[passed], pixels[passed], kept[passed], settings)
        agreeing[passed] = distance <= settings.threshold
        if not agreeing.any() or np.array_equal(agreeing, kept):
            break
        kept, posterior = agreeing, updated(agreeing)
    return posterior, replace(innovation, accepted=kept)


def after_fit(posterior: Belief, ids: np.ndarray, pixels: np.ndarray, used: np.ndarray,
              settings: UpdateSettings) -> np.ndarray:
    """(m,) squared residuals over their variance, 4 degrees of freedom, of measurements against a posterior.

    used : (m,) bool, which of them it rests on: those scatter by no more than V around it. The others scatter by V and
    by what the posterior leaves open, S = H P H^T + V.
    """
    landmarks = posterior.landmarks[np.searchsorted(posterior.ids, ids)]
    predicted, in_front = settings.camera.observe(posterior.world_T_imu, landmarks)
    distance = np.sum((pixels - predicted) ** 2, axis=-1) / settings.noise.sigma_px**2
    if not used.all():
        distance[~used] = window_slam.compute_innovation(posterior, ids[~used], pixels[~used], settings)[0].nis
    return np.where(in_front, distance, np.inf)
