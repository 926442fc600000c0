"""What real tracks need: weights that fade out what does not fit, and landmarks that slip.

    window_slam.run(drive, noise, RightInvariant(), motion_model=robust.RealDrive, process_frame=robust.process_frame)

A gate decides about a measurement once, by a prior that may be loose, or wrong after a few blind steps. Here what
passes the gate is weighed: the further a measurement lies from the posterior it leads to, the larger its noise is
assumed. And a tracker does not stay on its point for ever: the more the image of a point grows from one frame to the
next, the more its track slips, so that the landmark itself has to be uncertain anew. The weights are made for this
motion model: where the noisy IMU drives the pose, they discount good measurements and lose accuracy on clean drives.

>>> from vislam_edu import Noise, RightInvariant, load, robust, window_slam
>>> steps = window_slam.run(load("first_steps"), Noise(), RightInvariant(), motion_model=robust.RealDrive,
...                         process_frame=robust.process_frame)
>>> next(steps).k
0

Source: Triggs et al., Bundle adjustment, a modern synthesis, 2000, section 3 (robust losses by reweighting).
"""

from dataclasses import replace

import numpy as np

from . import blockwise, motion, stereo, window_slam
from .belief import NO_INNOVATION, Belief, Innovation
from .drive import Drive
from .error_state import ErrorState
from .noise import Noise
from .window_slam import Frame, UpdateSettings

HALF_WEIGHT = 2.0  # standard deviations at which a measurement has half its weight
ROUNDS = 3


def process_frame(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> Frame:
    """What a frame does, see `window_slam.run`: as `correlated`, with weights on the measurements.

    Returns (prior, posterior, Innovation); its `accepted` are those that agree with the posterior.
    """
    return window_slam.correlated(prior, ids, pixels, settings, update)


def weights(squared: np.ndarray) -> np.ndarray:
    """Cauchy weights 1 / (1 + s / c^2) of squared normalised residuals s (m,), c = `HALF_WEIGHT`."""
    return 1 / (1 + squared / HALF_WEIGHT**2)


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> tuple[Belief, Innovation]:
    """`window_slam.update` with the noise V / w of each measurement: iteratively reweighted, linearised once.

    The first weights come from the NIS of each measurement, the later ones from what the update leaves of its residual.
    ids : (m,). pixels : (m, 4). Returns (posterior, Innovation).
    """
    if len(ids) == 0:
        return prior, NO_INNOVATION
    innovation, H = window_slam.compute_innovation(prior, ids, pixels, settings)
    passed = innovation.accepted
    if not passed.any():
        return prior, innovation
    H = H.only(passed)
    residual = innovation.residual[passed]
    rows, sigma2 = stereo.reduce_rows(residual), settings.noise.sigma_px**2
    variance = sigma2 * stereo.ROW_VARIANCE
    between_rows = (residual[:, 1] - residual[:, 3]) ** 2 / (2 * sigma2)  # v_left - v_right, which no state predicts
    squared = innovation.nis[passed]
    HPH = H.times(H.times(prior.covariance).T)
    for _ in range(ROUNDS):  # with S = H P H^T + V/w an update leaves r - H delta = V/w S^-1 r: no delta is needed
        noise = variance / weights(squared)[:, None]
        left = noise * np.linalg.solve(HPH + np.diag(noise.ravel()), rows.ravel()).reshape(-1, 3)
        squared = np.sum(left**2 / variance, axis=-1) + between_rows
    delta, covariance = blockwise.absorb(prior.covariance, H, rows, noise)
    accepted = passed.copy()
    accepted[passed] = squared <= settings.threshold
    posterior = motion.retract(prior, delta, covariance, settings.error_state, settings.retract_motion)
    return posterior, replace(innovation, accepted=accepted)


class RealDrive(motion.TwistAndBias):
    """`motion.TwistAndBias` with a steadier twist, and landmarks that walk because their tracks slip.

    From one frame to the next a landmark walks by what `slip_px` px in each coordinate of its image are worth. The
    default walks of the twist suit a car at ten frames a second.

    walk_v, walk_omega : m/s and rad/s per frame.
    """

    slip_floor, slip_of_zoom = 0.1, 2.0  # px a frame; px at a zoom by e, whose square grows with the zoom

    def __init__(self, drive: Drive, noise: Noise, error_state: ErrorState, walk_v: float = 0.1,
                 walk_omega: float = 0.03) -> None:
        super().__init__(drive, noise, error_state, walk_v, walk_omega)
        self.camera = drive.camera

    def slip_px(self, depth_before: np.ndarray, depth_now: np.ndarray) -> np.ndarray:
        """(n,) px, standard deviation of the slip between two frames; depths (n,), in one unit, positive.

        An image grows by the ratio of its depths.
        """
        return np.sqrt(self.slip_floor**2 + self.slip_of_zoom**2 * np.abs(np.log(depth_before / depth_now)))

    def predict(self, belief: Belief, k: int) -> Belief:
        """The belief at frame k + 1 before the camera update: P_mm += q^2 H^-1 V_1 H^-T, q the slip."""
        predicted = super().predict(belief, k)
        before, *_ = self.error_state.measure(self.camera, belief.world_T_imu, belief.points)
        now, H, _ = self.error_state.measure(self.camera, predicted.world_T_imu, predicted.points)
        rows = np.flatnonzero(self.camera.project_homogeneous(before)[1] & self.camera.project_homogeneous(now)[1])
        slip = self.slip_px(before[rows, 2], now[rows, 2])
        spread = np.linalg.inv(H[rows]) * np.sqrt(stereo.ROW_VARIANCE) * slip[:, None, None]
        P, n = predicted.covariance.copy(), len(predicted.ids)
        P[:3 * n, :3 * n].reshape(n, 3, n, 3)[rows, :, rows, :] += spread @ spread.mT
        return replace(predicted, covariance=P)
