"""Full visual-inertial SLAM: one Gaussian over the pose and every landmark in view.

    for step in slam.run(drive, noise):
        step.prior, step.innovation, step.posterior

One frame: predict, drop the landmarks that are out of sight, update with those that are known, add the new ones.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cholesky
from scipy.linalg.blas import dtrsm, dtrsv

from . import kalman, motion
from .error_state import ErrorState, RightPerturbation
from .motion import Belief
from .noise import Noise
from .stereo import StereoCamera

# v_left and v_right of a rectified pair measure the same thing. Their mean carries all they say about the state and
# has half the variance; their difference is pure noise, of no use but to the gate. So four rows become three.
ROWS = [0, 1, 2]  # of J: u_left, v, u_right
ROW_VARIANCE = np.array([1.0, 0.5, 1.0])
FOUR_FROM_THREE = [0, 1, 2, 1]


@dataclass(frozen=True, eq=False)
class UpdateSettings:
    """What an update needs to know besides the belief.

    camera : StereoCamera. noise : Noise. error_state : `ErrorState`.
    threshold : largest NIS (4 degrees of freedom) of a measurement that is believed.
    min_disparity : px, below it a new landmark waits for a better view.
    """

    camera: StereoCamera
    noise: Noise
    error_state: ErrorState
    threshold: float
    min_disparity: float


def reduce_rows(pixels):
    """(n, 4) stereo measurements to the (n, 3) numbers that carry information."""
    return np.stack([pixels[:, 0], (pixels[:, 1] + pixels[:, 3]) / 2, pixels[:, 2]], axis=-1)


def contains(sorted_ids, ids):
    """(len(ids),) bool: which of `ids` are among `sorted_ids`, both ascending."""
    if len(sorted_ids) == 0:
        return np.zeros(len(ids), dtype=bool)
    place = np.minimum(np.searchsorted(sorted_ids, ids), len(sorted_ids) - 1)
    return sorted_ids[place] == ids


def linearise(belief, rows, settings):
    """Prediction and Jacobians of the landmarks at `rows` of the window.

    Returns predicted (n, 4) px, in_front (n,), H_landmark (n, 3, 3) and H_pose (n, 3, 6), rows [u_left, v, u_right].
    """
    landmarks = belief.landmarks[rows]
    points = settings.camera.to_cam(belief.world_T_imu, landmarks)
    predicted, in_front = settings.camera.project(points)
    J = settings.camera.measurement_jacobian(points)[:, ROWS]
    return predicted, in_front, *settings.error_state.jacobians(belief.world_T_imu, landmarks, J)


def times_H(A, rows, H_landmark, H_pose, n):
    """H A for A (d, c), without writing H: a measurement touches one landmark and the pose, nothing else.

    n : landmarks in the state. Returns (3 len(rows), c).
    """
    blocks = A[:3 * n].reshape(n, 3, -1)
    if len(rows) < n:  # the usual case, everything in the window is seen, needs no copy
        blocks = blocks[rows]
    HA = (H_landmark @ blocks).reshape(3 * len(rows), -1)
    HA += H_pose.reshape(-1, 6) @ A[3 * n:3 * n + 6]
    return HA


@dataclass(frozen=True, eq=False)
class Linearised:
    """A frame's measurements against a prior, ready to be absorbed.

    HP : (3m, d), H times the covariance. S : (3m, 3m), innovation covariance. residual : (3m,) px, three numbers a
    measurement.
    """

    HP: np.ndarray
    S: np.ndarray
    residual: np.ndarray


def compute_innovation(prior, ids, pixels, settings):
    """The landmarks `ids` (all in the window) against their predictions, gated one by one.

    ids : (m,). pixels : (m, 4). Returns (Innovation, Linearised).
    """
    n, m = len(prior.ids), len(ids)
    rows = np.searchsorted(prior.ids, ids)
    predicted, in_front, H_l, H_p = linearise(prior, rows, settings)
    residual = pixels - predicted

    HP = times_H(prior.covariance, rows, H_l, H_p, n)
    S = times_H(np.ascontiguousarray(HP.T), rows, H_l, H_p, n)
    each = np.arange(m)
    explained = S.reshape(m, 3, m, 3)[each, :, each, :]
    S.reshape(-1)[::3 * m + 1] += np.tile(settings.noise.sigma_px**2 * ROW_VARIANCE, m)  # on the diagonal

    S_each = explained[:, FOUR_FROM_THREE][:, :, FOUR_FROM_THREE] + settings.noise.pixel_covariance
    nis = np.where(in_front, kalman.nis(residual, S_each), np.inf)
    accepted = in_front & (nis <= settings.threshold)
    return (kalman.Innovation(ids, pixels, predicted, S_each, nis, accepted),
            Linearised(HP, S, reduce_rows(residual).ravel()))


def apply_update(prior, linearised, accepted, settings) -> Belief:
    """EKF update of the whole joint belief with the measurements that are accepted, (m,) bool.

    With S = L L^T and Y = L^-1 H P, the gain is K = Y^T L^-1 and the new covariance P - K S K^T = P - Y^T Y: symmetric
    by construction, and no inverse is ever formed.
    Source: report section 3.3.2, steps 3 to 5.
    """
    if not accepted.any():
        return prior
    HP, S, residual = linearised.HP.copy(), linearised.S.copy(), linearised.residual.copy()
    if not accepted.all():  # a measurement kept out is one that depends on nothing: H = 0, whatever its noise
        out = np.flatnonzero(np.repeat(~accepted, 3))
        HP[out], S[out], S[:, out], S[out, out], residual[out] = 0, 0, 0, 1, 0

    # LAPACK and BLAS count by columns: S^T is S, and (HP)^T becomes Y^T = (HP)^T L^-T, both in place
    L = cholesky(S.T, lower=True, overwrite_a=True, check_finite=False)
    Y = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
    y = dtrsv(L, residual, lower=1)
    return motion.retract(prior, Y.T @ y, prior.covariance - Y.T @ Y, settings.error_state)


def update(prior, ids, pixels, settings):
    """EKF update with the landmarks `ids` (all in the window) that the gate lets pass.

    ids : (m,). pixels : (m, 4). Returns (posterior, Innovation).
    """
    if len(ids) == 0:
        return prior, kalman.NO_INNOVATION
    innovation, linearised = compute_innovation(prior, ids, pixels, settings)
    return apply_update(prior, linearised, innovation.accepted, settings), innovation


def marginalise(belief, keep) -> Belief:
    """The belief over fewer landmarks. keep : (n,) bool.

    Dropping variables from a Gaussian is dropping their rows and columns: exact for everything that stays.
    """
    if keep.all():
        return belief
    rest = np.ones(len(belief.covariance) - 3 * len(keep), dtype=bool)
    index = np.flatnonzero(np.concatenate([np.repeat(keep, 3), rest]))
    return Belief(belief.world_T_imu, belief.landmarks[keep], belief.ids[keep],
                  belief.covariance.take(index, axis=0).take(index, axis=1), belief.motion)


def _insert(belief, ids, landmarks, cross, own) -> Belief:
    """New landmarks at their places in the order of ids. cross : (3m, d), own : (3m, 3m) covariance."""
    n, m, d = len(belief.ids), len(ids), len(belief.covariance)
    P = np.empty((d + 3 * m, d + 3 * m))
    P[:d, :d], P[d:, :d], P[:d, d:], P[d:, d:] = belief.covariance, cross, cross.T, own
    all_ids = np.concatenate([belief.ids, ids])
    order = np.argsort(all_ids)
    first = np.where(order < n, 3 * order, d + 3 * (order - n))  # where each landmark's rows stand in P
    index = np.concatenate([(first[:, None] + np.arange(3)).ravel(), np.arange(3 * n, d)])
    return Belief(belief.world_T_imu, np.concatenate([belief.landmarks, landmarks])[order], all_ids[order],
                  P.take(index, axis=0).take(index, axis=1), belief.motion)


def add_correlated(belief, ids, pixels, settings) -> Belief:
    """New landmarks, each as uncertain as its triangulation and correlated with the pose it was seen from.

    Sigma_mm = G Sigma_TT G^T + A C A^T,  Sigma_m. = G Sigma_T.   (C: triangulation covariance in the IMU frame)

    Source: Solà, Simultaneous localization and mapping with the extended Kalman filter, 2014, on landmark
    initialisation with a sensor that sees all three coordinates.
    """
    camera = settings.camera
    points_cam, ok = camera.triangulate(pixels, settings.min_disparity)
    ids, points_cam = ids[ok], points_cam[ok]
    if len(ids) == 0:
        return belief
    imu_R_cam = camera.imu_T_cam[:3, :3]
    C = imu_R_cam @ camera.triangulation_covariance(points_cam, settings.noise.sigma_px) @ imu_R_cam.T
    points = points_cam @ imu_R_cam.T + camera.imu_T_cam[:3, 3]
    G, A = settings.error_state.birth(belief.world_T_imu, points)
    G = G.reshape(-1, 6)
    own = motion.symmetric(G @ belief.pose_covariance @ G.T)
    blocks, each = own.reshape(len(ids), 3, len(ids), 3), np.arange(len(ids))
    C = A @ C @ A.T
    blocks[each, :, each, :] += (C + C.swapaxes(1, 2)) / 2
    landmarks = points @ belief.world_T_imu[:3, :3].T + belief.world_T_imu[:3, 3]
    return _insert(belief, ids, landmarks, G @ belief.covariance[belief.pose], own)


def add_as_report(belief, ids, pixels, settings) -> Belief:
    """New landmarks the report's way: triangulated mean, variance 2 per axis, no correlation with anything.

    That counts the pose as known at the moment a landmark is born.
    Source: report section 3.3.3.
    """
    points, ok = settings.camera.triangulate(pixels, settings.min_disparity)
    ids = ids[ok]
    landmarks = settings.camera.to_world(belief.world_T_imu, points[ok])
    return _insert(belief, ids, landmarks, np.zeros((3 * len(ids), len(belief.covariance))),
                   settings.noise.landmark_prior * np.eye(3 * len(ids)))


def correlated(prior, ids, pixels, settings):
    """The correct frame: known landmarks correct the state, then new ones join it, their first measurement used up.

    Returns (prior, posterior, Innovation): the prior comes back unchanged.
    """
    known = contains(prior.ids, ids)
    posterior, innovation = update(prior, ids[known], pixels[known], settings)
    if not known.all():
        posterior = add_correlated(posterior, ids[~known], pixels[~known], settings)
    return prior, posterior, innovation


def as_report(prior, ids, pixels, settings):
    """The report's frame: new landmarks join first and their first measurement is used a second time.

    Returns (prior with the new landmarks in it, posterior, Innovation).
    """
    new = ~contains(prior.ids, ids)
    prior = add_as_report(prior, ids[new], pixels[new], settings)
    known = contains(prior.ids, ids)
    return prior, *update(prior, ids[known], pixels[known], settings)


def without_cross_covariance(process_frame):
    """The same frame, after which landmarks and pose are taken for independent: what many first versions do.

    process_frame : `correlated` or `as_report`. Returns a function to pass to `run`. It is wrong, and worth seeing.
    """

    def blind(prior, ids, pixels, settings):
        prior, posterior, innovation = process_frame(prior, ids, pixels, settings)
        blocks = [*posterior.landmark_covariance, posterior.covariance[posterior.pose.start:, posterior.pose.start:]]
        return prior, replace(posterior, covariance=block_diag(*blocks)), innovation

    return blind


def retire_unseen(belief, ids):
    """Retire what this frame does not see: tracks never return, so it can never be measured again."""
    return contains(ids, belief.ids)


def retire_none(belief, ids):
    """Retire nothing: the report's filter, whose covariance grows with the map."""
    return np.ones(len(belief.ids), dtype=bool)


def keep_apart(belief, k):
    """Associate nothing: what the tracker numbers differently stays different."""
    return belief


def run(drive, noise, error_state=None, *, motion_model=motion.ImuDriven, process_frame=correlated,
        retire=retire_unseen, associate=keep_apart, gate=0.99, min_disparity=1.0, world_T_imu=None, after=None):
    """The joint filter over a drive: yields one `Step` per frame, its beliefs `Belief`s.

    drive : Drive. noise : Noise. error_state : `RightPerturbation()` (the report's, the default) or another.
    motion_model : `motion.ImuDriven` (the report's) or `motion.TwistAndBias`. process_frame : what a frame does,
    `correlated` or `as_report`. retire : which landmarks leave the state, `retire_unseen` or `retire_none`.
    associate : what to do about places that the map may hold twice, `keep_apart` or an `association.LoopClosing`.
    gate : probability that a good measurement passes, 1 for no gate. min_disparity : px, below it a landmark waits.
    world_T_imu : (4, 4) pose at frame 0, the identity by default.
    after : a Step of an earlier run with the same arguments, to go on from; none: from the beginning.
    Raises ValueError for a gate outside (0, 1] or a negative disparity.
    Source: report section 3.3.2.
    """
    if not min_disparity >= 0:
        raise ValueError(f"min_disparity must be >= 0 px, got {min_disparity!r}")
    error_state = error_state or RightPerturbation()
    settings = UpdateSettings(drive.camera, noise, error_state, kalman.gate_threshold(gate), min_disparity)
    model = motion_model(drive, noise, error_state)
    posterior = after and after.posterior
    for k in range(after.k + 1 if after else 0, drive.n_frames):
        before = model.start(world_T_imu) if posterior is None else model.predict(posterior, k - 1)
        ids, pixels = drive.observed(k)
        keep = retire(before, ids)
        prior, posterior, innovation = process_frame(marginalise(before, keep), ids, pixels, settings)
        posterior = associate(posterior, k)
        born = posterior.ids[~contains(before.ids, posterior.ids)]
        yield kalman.Step(k, drive.times[k], prior, posterior, innovation, born,
                          before.ids[~contains(posterior.ids, before.ids)])
