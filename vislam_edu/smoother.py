"""What the rest of the drive still says about the landmarks that were passed long ago.

The window drops a landmark when it is out of sight; the filter that never drops anything goes on correcting it through
its correlation with the pose. Both agree on the pose. This pass gives the landmarks back, without the big covariance:
it walks the drive backwards and carries, instead of a state, the adjoint of the state,

    lambda (d,)  and  Lambda (d, d),   so that   x_N = x + P lambda   and   P_N = P - P Lambda P

tell what the filter would say at the end (N) about any x that it believed with covariance P here. Both start as zero.
Each thing that the filter did on the way forward is undone by its transpose:

    update        lambda <- lambda + H^T w,   w = S^-1 r - K^T lambda
                  Lambda <- (I - K H)^T Lambda (I - K H) + H^T S^-1 H
    birth         lambda <- A^T lambda        Lambda <- A^T Lambda A,   A = [I; G]
    retirement    a row of zeros: the future does not look at what is gone
    prediction    lambda <- F^T lambda        Lambda <- F^T Lambda F

A landmark stands still, so at its retirement x_N is its final estimate: a fixed-point smoother.
Source: Bierman, Fixed interval smoothing with discrete measurements, 1973 (the modified Bryson-Frazier form).
"""

from functools import partial
from itertools import islice, pairwise
from math import isqrt

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from . import motion, se3, window_slam
from .error_state import RightPerturbation
from .mapping import MapBelief


def _indices(rows):
    """Rows of the state of the landmarks at `rows` of the window."""
    return (3 * rows[:, None] + np.arange(3)).ravel()


def _times_HT(X, rows, H_l, H_p, d):
    """H^T X for X (3m, c), without writing H. Returns (d, c)."""
    out = np.zeros((d, X.shape[1]))
    out[_indices(rows)] = np.einsum("iab,iac->ibc", H_l, X.reshape(len(rows), 3, -1)).reshape(3 * len(rows), -1)
    n = d - H_p.shape[-1]
    out[n:] = H_p.reshape(3 * len(rows), -1).T @ X
    return out


def _undo_update(lam, Lam, step, settings):
    """Back through the update of one frame. lam (d, 1), Lam (d, d), over the landmarks of the prior."""
    prior, ids = step.prior, step.innovation.ids[step.innovation.accepted]
    if len(ids) == 0:
        return lam, Lam
    rows, n, d = np.searchsorted(prior.ids, ids), len(prior.ids), len(lam)
    _, _, H_l, H_p = window_slam.linearise(prior, rows, settings)
    HP = window_slam.times_H(prior.covariance, rows, H_l, H_p, n)
    S = window_slam.times_H(np.ascontiguousarray(HP.T), rows, H_l, H_p, n)
    S[np.diag_indices(len(S))] += np.tile(settings.noise.sigma_px**2 * window_slam.ROW_VARIANCE, len(ids))
    L = cholesky(S, lower=True, check_finite=False)
    residual = window_slam.reduce_rows(step.innovation.residual[step.innovation.accepted]).reshape(-1, 1)

    def solve(b, trans="N"):
        return solve_triangular(L, b, lower=True, trans=trans, check_finite=False)

    Y = solve(HP)  # K = Y^T L^-1
    w = solve(solve(residual) - Y @ lam, "T")
    Z = Y @ Lam
    M = solve(Z, "T")  # K^T Lambda
    inner = solve(solve(Z @ Y.T + np.eye(len(L)), "T").T, "T")  # K^T Lambda K + S^-1, symmetric
    # (I - K H)^T Lambda (I - K H) + H^T S^-1 H, H on one side at a time
    X = _times_HT(inner, rows, H_l, H_p, d)
    HtM = _times_HT(M, rows, H_l, H_p, d)
    Lam = Lam - HtM - HtM.T + _times_HT(X.T, rows, H_l, H_p, d)
    return lam + _times_HT(w, rows, H_l, H_p, d), motion.symmetric(Lam)


def _undo_birth(lam, Lam, step, settings):
    """Back to before the landmarks that `window_slam.add_correlated` added: A = [I; G], G on the pose alone."""
    belief = step.posterior
    is_new = ~window_slam.contains(step.prior.ids, belief.ids)
    if not is_new.any():
        return lam, Lam
    new = _indices(np.flatnonzero(is_new))
    old = np.setdiff1d(np.arange(len(lam)), new)
    points = se3.transform(se3.inverse(belief.world_T_imu), belief.landmarks[is_new])
    G, _ = settings.error_state.birth(belief.world_T_imu, points)
    A = np.zeros((len(new), len(old)))
    A[:, -6:] = G.reshape(-1, 6)
    cross = Lam[np.ix_(old, new)] @ A
    return (lam[old] + A.T @ lam[new],
            motion.symmetric(Lam[np.ix_(old, old)] + cross + cross.T + A.T @ Lam[np.ix_(new, new)] @ A))


def _undo_prediction(lam, Lam, n, transition):
    """F^T lambda and F^T Lambda F; of F only the columns of the pose differ from the identity."""
    F = transition.F_tail
    lam, Lam = lam.copy(), Lam.copy()
    lam[n:] = F.T @ lam[n:]
    Lam[:, n:] = Lam[:, n:] @ F
    Lam[n:] = F.T @ Lam[n:]
    return lam, Lam


def _undo_window(final, before, prior, lam, Lam, error_state):
    """From the landmarks of the prior back to those of the belief before it, where those that retired still were.

    A landmark that the prior has and the belief before has not (born before the update, the report's way) had no past:
    its row goes. One that retired has no future of its own: a row of zeros, once its final estimate is written down.
    """
    keep = window_slam.contains(prior.ids, before.ids)
    old = np.flatnonzero(window_slam.contains(before.ids, prior.ids))
    narrow = np.concatenate([_indices(old), np.arange(3 * len(prior.ids), len(lam))])
    lam, Lam = lam[narrow], Lam[np.ix_(narrow, narrow)]
    if keep.all():
        return lam, Lam
    _settle(final, before, keep, lam, Lam, error_state)
    d = len(before.covariance)
    wide = np.concatenate([_indices(np.flatnonzero(keep)), np.arange(3 * len(keep), d)])
    lam_wide, Lam_wide = np.zeros((d, 1)), np.zeros((d, d))
    lam_wide[wide], Lam_wide[np.ix_(wide, wide)] = lam, Lam
    return lam_wide, Lam_wide


def _settle(final, before, keep, lam, Lam, error_state):
    """Write down the final estimates of the landmarks of a belief that leave it, keep (n,) False.

    lam, Lam : over what stays.
    """
    rows = np.flatnonzero(~keep)
    kept = np.concatenate([_indices(np.flatnonzero(keep)), np.arange(3 * len(keep), len(before.covariance))])
    P = before.covariance
    to_all = P[_indices(rows)]  # (3r, d), covariance of each retired landmark with everything
    own = P[np.ix_(_indices(rows), _indices(rows))]
    C = error_state.world_landmark(before.landmarks[rows])
    if C is not None:  # the error in metres is the landmark's plus C times the pose's
        C = C.reshape(-1, 6)
        cross = to_all[:, before.pose] @ C.T
        own = own + cross + cross.T + C @ before.pose_covariance @ C.T
        to_all = to_all + C @ P[before.pose]
    future = to_all[:, kept]
    r, retired = len(rows), before.ids[rows]
    each = np.arange(r)
    final.landmarks[retired] = before.landmarks[rows] + (future @ lam).reshape(r, 3)
    final.covariance[retired] = (own - future @ Lam @ future.T).reshape(r, 3, r, 3)[each, :, each, :]
    final.seen[retired] = True


def _backwards(n_frames, run):
    """Pairs (step before, step) of a run over n_frames, the last first; before the first step is None.

    run : function that starts the filter, `run(after=step)` one that goes on. The filter goes over the drive once for
    a step to restart from every sqrt(T) frames, and once more piece by piece: memory is that of a few dozen steps.
    """
    piece = max(1, isqrt(n_frames))
    starts = [None, *(step for step in run(after=None) if (step.k + 1) % piece == 0)]
    for start in reversed(starts):
        steps = [start, *islice(run(after=start), piece)]
        yield from reversed(list(pairwise(steps)))


def final_map(drive, noise, error_state=None, progress=lambda frames, total: frames, **options) -> MapBelief:
    """Every landmark as the filter that never retires one would know it at the end of the drive.

    Returns a `MapBelief`; rows of landmarks that were never born are zero, and not `seen`.
    drive, noise, error_state, options : as for `window_slam.run`, with its `ImuDriven` motion model.
    progress : called as `progress(frames, total=T)` on the backward walk, for instance `tqdm.auto.tqdm`.
    Raises ValueError for another motion model or for a run that retires nothing.

    For `RightPerturbation` the result is that filter's, to rounding. For `RightInvariant` it is to first order: there
    a correction turns all landmarks about the origin, which is not a sum.
    """
    for name in ("motion_model", "retire"):
        if name in options:
            raise ValueError(f"final_map walks back through the plain window filter, so it takes no {name}")
    error_state = error_state or RightPerturbation()
    model = motion.ImuDriven(drive, noise, error_state)
    settings = window_slam.UpdateSettings(drive.camera, noise, error_state, np.inf, 0.0)
    M = drive.n_landmarks
    final = MapBelief(np.zeros((M, 3)), np.zeros((M, 3, 3)), np.zeros(M, bool))

    lam = Lam = None
    run = partial(window_slam.run, drive, noise, error_state, **options)
    for earlier, step in progress(_backwards(drive.n_frames, run), total=drive.n_frames):
        if lam is None:  # the end: no future, and whoever is still in the state has its final estimate
            d, n = len(step.posterior.covariance), len(step.posterior.ids)
            lam, Lam = np.zeros((d, 1)), np.zeros((d, d))
            _settle(final, step.posterior, np.zeros(n, bool), lam[3 * n:], Lam[3 * n:, 3 * n:], error_state)
        if earlier is None:
            break
        lam, Lam = _undo_birth(lam, Lam, step, settings)
        lam, Lam = _undo_update(lam, Lam, step, settings)
        transition = model.transition(earlier.posterior, earlier.k)
        before = motion.propagate(earlier.posterior, transition)
        lam, Lam = _undo_window(final, before, step.prior, lam, Lam, error_state)
        lam, Lam = _undo_prediction(lam, Lam, 3 * len(before.ids), transition)
    return final
