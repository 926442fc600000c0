"""Linear algebra of the window filter, fast: a stereo measurement touches one landmark and the pose, nothing else.

Every function gives what the plain equation beside it gives; only zeros are left out. H_landmark (m, 3, 3) and H_pose
(m, 3, 6) are the blocks of H of m measurements of the landmarks at `rows` (m,) of n in the state, whose covariance P
(d, d) is ordered [landmarks 3n, pose 6, motion]. A measurement is three numbers [u_left, v, u_right], see
`stereo.reduce_rows`.

>>> import numpy as np
>>> P, H_landmark, H_pose = np.eye(9), np.ones((1, 3, 3)), np.ones((1, 3, 6))
>>> times_H(P, np.array([0]), H_landmark, H_pose, 1).shape
(3, 9)
"""

import numpy as np
from scipy.linalg.blas import dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

CHUNK = 32  # measurements absorbed at a time: few enough for small matrices, enough to keep products efficient


def times_H(A: np.ndarray, rows: np.ndarray, H_landmark: np.ndarray, H_pose: np.ndarray, n: int) -> np.ndarray:
    """H A, (3m, c), for A (d, c)."""
    HA = (H_landmark @ A[:3 * n].reshape(n, 3, -1)[rows]).reshape(3 * len(rows), -1)
    if H_pose.any():
        HA += H_pose.reshape(-1, 6) @ A[3 * n:3 * n + 6]
    return HA


def times_HT(X: np.ndarray, rows: np.ndarray, H_landmark: np.ndarray, H_pose: np.ndarray, n: int, d: int) -> np.ndarray:
    """H^T X, (d, c), for X (3m, c)."""
    out = np.zeros((d, X.shape[1]))
    out[:3 * n].reshape(n, 3, -1)[rows] = H_landmark.mT @ X.reshape(len(rows), 3, -1)
    out[3 * n:3 * n + 6] = H_pose.reshape(-1, 6).T @ X
    return out


def diagonal_blocks(P: np.ndarray, rows: np.ndarray, H_landmark: np.ndarray, H_pose: np.ndarray, n: int) -> np.ndarray:
    """The blocks H_i P H_i^T, (m, 3, 3), of each measurement with itself: all that a gate needs of H P H^T."""
    own = P[:3 * n, :3 * n].reshape(n, 3, n, 3)[rows, :, rows, :]
    cross = H_landmark @ P[:3 * n, 3 * n:3 * n + 6].reshape(n, 3, 6)[rows] @ H_pose.mT
    pose = P[3 * n:3 * n + 6, 3 * n:3 * n + 6]
    return H_landmark @ own @ H_landmark.mT + cross + cross.mT + H_pose @ pose @ H_pose.mT


def _factored(P: np.ndarray, H: tuple[np.ndarray, np.ndarray, np.ndarray, int],
              variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H P and the lower factor L of S = H P H^T + V = L L^T. LAPACK counts by columns, in place: S^T is S."""
    HP = times_H(P, *H)
    S = times_H(HP.T, *H)
    S.reshape(-1)[::len(S) + 1] += variance.ravel()
    L, failed = dpotrf(S.T, lower=1, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("an innovation covariance is not positive definite")
    return HP, L


def correction(P: np.ndarray, rows: np.ndarray, H_landmark: np.ndarray, H_pose: np.ndarray, n: int,
               residual: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The delta of `absorb` alone, (d,), all measurements at once: P H^T S^-1 r."""
    HP, L = _factored(P, (rows, H_landmark, H_pose, n), variance)
    return HP.T @ dtrsv(L, dtrsv(L, residual.ravel(), lower=1), lower=1, trans=1)


def absorb(P: np.ndarray, rows: np.ndarray, H_landmark: np.ndarray, H_pose: np.ndarray, n: int, residual: np.ndarray,
           variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One Kalman update: delta = K r (d,) and P - K S K^T (d, d), with residual r and noise variance (m, 3), px, px^2.

    The noise of measurements is independent, so the update may take them a chunk at a time: each chunk predicts its
    residual from the correction so far, r - H delta, with the H of all. With S = L L^T and Y = L^-1 H P the gain is
    Y^T L^-1 and the new covariance P - Y^T Y: symmetric by construction, and nothing is inverted.
    """
    P, delta = P.copy(), np.zeros(len(P))
    for start in range(0, len(rows), CHUNK):
        part = slice(start, start + CHUNK)
        H = rows[part], H_landmark[part], H_pose[part], n
        HP, L = _factored(P, H, variance[part])                                     # H P and S = L L^T
        r = residual[part].ravel() - times_H(delta[:, None], *H)[:, 0]              # r - H delta
        # BLAS counts by columns: (HP)^T becomes Y^T = (HP)^T L^-T in place
        Y = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T        # Y = L^-1 H P
        delta += Y.T @ dtrsv(L, r, lower=1)                                         # delta + K r
        P -= Y.T @ Y                                                                # P - K S K^T
    return delta, P
