"""The joint filter over the landmarks in view: the estimates of `ekf_slam`, fast enough for thousands of landmarks.

    for step in window_slam.run(drive, noise):
        step.prior, step.innovation, step.posterior

One frame: predict, retire the landmarks that are out of sight, update with those that are known, add the new ones. What
makes it fast is the window (a landmark that cannot be seen again leaves the state, which is exact for all that stays)
and `blockwise` (H is never written out). What an error is, what moves the car, what a frame does and who retires are
arguments.

>>> from vislam_edu import Noise, load, window_slam
>>> step = next(window_slam.run(load("first_steps"), Noise()))
>>> len(step.born) == len(step.posterior.ids)
True
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import ThreadpoolController

from . import blockwise, kalman, motion, stereo
from .belief import NO_INNOVATION, Belief, Innovation, Step
from .blockwise import BlockJacobian
from .drive import Drive
from .error_state import ErrorState, RightPerturbation
from .noise import Noise
from .stereo import StereoCamera


@dataclass(frozen=True, eq=False)
class UpdateSettings:
    """What an update needs besides the belief.

    threshold : largest NIS (4 degrees of freedom) of a measurement that is used.
    min_disparity : px, below it a new landmark waits for a better view.
    predict_again : from a first correction of the prior to the prior once more, linearised there, and the error that
        the prior's mean has there; None: a frame is linearised once. See `motion.ImuDriven.predict_again`.
    retract_motion : see `motion.retract`.
    """

    camera: StereoCamera
    noise: Noise
    error_state: ErrorState
    threshold: float
    min_disparity: float
    predict_again: Callable[[np.ndarray], tuple[Belief, np.ndarray]] | None = None
    retract_motion: motion.RetractMotion = motion.add


Frame = tuple[Belief, Belief, Innovation]
ProcessFrame = Callable[[Belief, np.ndarray, np.ndarray, UpdateSettings], Frame]
Retire = Callable[[Belief, np.ndarray], np.ndarray]


def contains(sorted_ids: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """(len(ids),) bool: which of `ids` are among `sorted_ids`, which ascend."""
    if len(sorted_ids) == 0:
        return np.zeros(len(ids), dtype=bool)
    place = np.minimum(np.searchsorted(sorted_ids, ids), len(sorted_ids) - 1)
    return sorted_ids[place] == ids


def linearise(belief: Belief, ids: np.ndarray, settings: UpdateSettings) -> tuple[BlockJacobian, np.ndarray]:
    """H of the landmarks `ids` (m,), all in the window, and where they are: (m, 4), homogeneous, camera frame."""
    rows = np.searchsorted(belief.ids, ids)
    q, H_landmark, H_pose = settings.error_state.measure(settings.camera, belief.world_T_imu, belief.points[rows])
    return BlockJacobian(rows, H_landmark, H_pose, len(belief.ids)), q


def compute_innovation(prior: Belief, ids: np.ndarray, pixels: np.ndarray,
                       settings: UpdateSettings) -> tuple[Innovation, BlockJacobian]:
    """The landmarks `ids` (m,), all in the window, against their predictions, gated one by one. pixels : (m, 4)."""
    H, q = linearise(prior, ids, settings)
    explained = H.diagonal_blocks(prior.covariance)
    predicted, in_front = settings.camera.project_homogeneous(q)
    predicted = predicted + settings.error_state.mean_shift(predicted, explained)
    S = explained[:, stereo.FOUR_FROM_THREE][:, :, stereo.FOUR_FROM_THREE] + settings.noise.pixel_covariance
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    return Innovation(ids, pixels, predicted, S, nis, in_front & (nis <= settings.threshold)), H


def _variance(residual: np.ndarray, settings: UpdateSettings) -> np.ndarray:
    return np.tile(settings.noise.sigma_px**2 * stereo.ROW_VARIANCE, (len(residual), 1))


def relinearise(prior: Belief, H: BlockJacobian, innovation: Innovation, settings: UpdateSettings
                ) -> tuple[Belief, np.ndarray | float, BlockJacobian, np.ndarray, np.ndarray]:
    """A step of Gauss and Newton over prediction and update: both linearised where the first update leads.

    H : of all measurements of the innovation. Returns the belief at that point, the error (d,) of the prior's mean
    there, H and the residual (m, 4), px, of the accepted measurements there, less H times that error, and which of all
    they are: a landmark behind the camera there is left out. Where a frame is linearised once, that point is the prior.
    Source: Bell, Cathey, The iterated Kalman filter update as a Gauss-Newton method, 1993.
    """
    good = innovation.accepted
    residual = innovation.residual[good]
    if settings.predict_again is None or not good.any():
        return prior, 0.0, H.only(good), residual, good
    first = blockwise.correction(prior.covariance, H.only(good), stereo.reduce_rows(residual),
                                 _variance(residual, settings))
    there, error = settings.predict_again(first)
    H, q = linearise(there, innovation.ids, settings)
    predicted, in_front = settings.camera.project_homogeneous(q)
    good = good & in_front
    H = H.only(good)
    shift = H.times(error[:, None]).reshape(-1, 3)[:, stereo.FOUR_FROM_THREE]
    return there, error, H, (innovation.measured - predicted)[good] - shift, good


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> tuple[Belief, Innovation]:
    """EKF update with those landmarks `ids` (m,), all in the window, that the gate lets pass. pixels : (m, 4).

    Source: report section 3.3.2, steps 3 to 5.
    """
    if len(ids) == 0:
        return prior, NO_INNOVATION
    innovation, H = compute_innovation(prior, ids, pixels, settings)
    there, error, H, residual, good = relinearise(prior, H, innovation, settings)
    if len(residual):
        delta, P = blockwise.absorb(there.covariance, H, stereo.reduce_rows(residual), _variance(residual, settings))
        there = motion.retract(there, delta + error, P, settings.error_state, settings.retract_motion)
    return there, replace(innovation, accepted=good)


def marginalise(belief: Belief, keep: np.ndarray) -> Belief:
    """The belief over fewer landmarks. keep : (n,) bool.

    Marginalising variables of a Gaussian is dropping their rows and columns: exact for everything that stays.
    """
    if keep.all():
        return belief
    rest = np.ones(len(belief.covariance) - 3 * len(keep), dtype=bool)
    index = np.flatnonzero(np.concatenate([np.repeat(keep, 3), rest]))
    return Belief(belief.world_T_imu, belief.points[keep], belief.ids[keep],
                  belief.covariance.take(index, axis=0).take(index, axis=1), belief.motion)


def _insert(belief: Belief, ids: np.ndarray, points: np.ndarray, cross: np.ndarray, own: np.ndarray) -> Belief:
    """New landmarks at their places in the order of ids. cross : (3m, d), own : (3m, 3m) covariance."""
    n, m, d = len(belief.ids), len(ids), len(belief.covariance)
    P = np.empty((d + 3 * m, d + 3 * m))
    P[:d, :d], P[d:, :d], P[:d, d:], P[d:, d:] = belief.covariance, cross, cross.T, own
    all_ids = np.concatenate([belief.ids, ids])
    order = np.argsort(all_ids)
    first = np.where(order < n, 3 * order, d + 3 * (order - n))  # where each landmark's rows stand in P
    index = np.concatenate([(first[:, None] + np.arange(3)).ravel(), np.arange(3 * n, d)])
    return Belief(belief.world_T_imu, np.concatenate([belief.points, points])[order], all_ids[order],
                  P.take(index, axis=0).take(index, axis=1), belief.motion)


def add_correlated(belief: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> Belief:
    """New landmarks, each as uncertain as its triangulation and correlated with the pose it was seen from.

    Sigma_mm = G Sigma_TT G^T + C,  Sigma_m. = G Sigma_T.   (C: covariance of the triangulation)

    Source: Solà, Simultaneous localization and mapping with the extended Kalman filter, 2014, on landmark
    initialisation with a sensor that sees all three coordinates.
    """
    error_state, T = settings.error_state, belief.world_T_imu
    points, C, ok = error_state.triangulate(settings.camera, T, pixels, settings.noise.sigma_px, settings.min_disparity)
    ids, points = ids[ok], points[ok]
    G = error_state.inherited(T, points).reshape(-1, 6)
    own = motion.symmetric(G @ belief.pose_covariance @ G.T)
    blocks, each = own.reshape(len(ids), 3, len(ids), 3), np.arange(len(ids))
    blocks[each, :, each, :] += C[ok]
    return _insert(belief, ids, points, G @ belief.covariance[belief.pose], own)


def add_as_report(belief: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> Belief:
    """New landmarks the report's way: triangulated mean, variance 2 per axis, no correlation with anything.

    That counts the pose as known at the moment a landmark is born.
    Raises ValueError for an error state whose landmarks are not `WorldPoints`.
    Source: report section 3.3.3.
    """
    if belief.points.ndim != 2:
        raise ValueError("the report's initialisation gives a landmark a variance per axis of the world; "
                         f"landmarks of the error state '{settings.error_state.name}' have none")
    points, ok = settings.camera.triangulate(pixels, settings.min_disparity)
    ids = ids[ok]
    landmarks = settings.camera.to_world(belief.world_T_imu, points[ok])
    return _insert(belief, ids, landmarks, np.zeros((3 * len(ids), len(belief.covariance))),
                   settings.noise.landmark_prior * np.eye(3 * len(ids)))


def correlated(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings,
               update: Callable[..., tuple[Belief, Innovation]] = update) -> Frame:
    """The correct frame: known landmarks correct the state by `update`, then new ones join it, their pixels used once.

    Returns (prior, posterior, Innovation).
    """
    known = contains(prior.ids, ids)
    posterior, innovation = update(prior, ids[known], pixels[known], settings)
    if not known.all():
        posterior = add_correlated(posterior, ids[~known], pixels[~known], settings)
    return prior, posterior, innovation


def as_report(prior: Belief, ids: np.ndarray, pixels: np.ndarray, settings: UpdateSettings) -> Frame:
    """The report's frame: new landmarks join first and their first measurement is used a second time.

    Returns (prior with the new landmarks in it, posterior, Innovation).
    """
    new = ~contains(prior.ids, ids)
    prior = add_as_report(prior, ids[new], pixels[new], settings)
    known = contains(prior.ids, ids)
    return prior, *update(prior, ids[known], pixels[known], settings)


def retire_unseen(belief: Belief, ids: np.ndarray) -> np.ndarray:
    """(n,) bool: keep what this frame sees. Tracks never return, so what is lost can never be measured again."""
    return contains(ids, belief.ids)


def retire_none(belief: Belief, ids: np.ndarray) -> np.ndarray:
    """(n,) bool: keep everything, as the report's filter does, whose covariance grows with the map."""
    return np.ones(len(belief.ids), dtype=bool)


def run(drive: Drive, noise: Noise, error_state: ErrorState | None = None, *,
        motion_model: Callable[[Drive, Noise, ErrorState], motion.MotionModel] = motion.ImuDriven,
        process_frame: ProcessFrame = correlated, retire: Retire = retire_unseen,
        associate: Callable[[Belief, int], Belief] | None = None, gate: float = 0.99, min_disparity: float = 1.0,
        world_T_imu: np.ndarray | None = None, after: Step | None = None) -> Iterator[Step]:
    """The joint filter over a drive: yields one `Step` per frame, its beliefs `Belief`s.

    error_state : `RightPerturbation()` (the report's, the default), `RightInvariant()` or `InverseDepth()`.
    motion_model : `motion.ImuDriven` (the report's) or `motion.TwistAndBias`. process_frame : what a frame does,
    `correlated` or `as_report`. retire : which landmarks leave the state, `retire_unseen` or `retire_none`.
    associate : what to do about places that the map may hold twice, an `association.LoopClosing`, or nothing.
    gate : probability that a good measurement passes, 1 for no gate.
    min_disparity : px, below it a landmark waits for a better view; `InverseDepth` needs no such limit.
    world_T_imu : (4, 4) pose at frame 0, the identity by default.
    after : a Step of an earlier run with the same arguments, to go on from; none: from the beginning.
    Raises ValueError for a gate outside (0, 1] or a negative disparity.
    Source: report section 3.3.2.
    """
    if not min_disparity >= 0:
        raise ValueError(f"min_disparity must be >= 0 px, got {min_disparity!r}")
    error_state = error_state or RightPerturbation()
    model = motion_model(drive, noise, error_state)
    settings = UpdateSettings(drive.camera, noise, error_state, kalman.gate_threshold(gate), min_disparity,
                              retract_motion=model.retract_motion)
    posterior = after.posterior if after else model.start(world_T_imu)
    # Matrices of a few hundred rows: the threads of one product would wait for each other longer than they work.
    blas = ThreadpoolController()
    for k in range(after.k + 1 if after else 0, drive.n_frames):
        with blas.limit(limits=1, user_api="blas"):
            ids, pixels = drive.observed(k)
            before, kept = posterior, marginalise(posterior, retire(posterior, ids))
            prior = model.predict(kept, k - 1) if k else kept
            settings = replace(settings, predict_again=model.second_prediction(kept, k - 1) if k else None)
            prior, posterior, innovation = process_frame(prior, ids, pixels, settings)
            posterior = associate(posterior, k) if associate else posterior
        born = posterior.ids[~contains(before.ids, posterior.ids)]
        retired = before.ids[~contains(posterior.ids, before.ids)]
        yield Step(k, drive.times[k], prior, posterior, innovation, born, retired)
