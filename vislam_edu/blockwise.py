"""Linear algebra of the window filter, fast: a stereo measurement touches one landmark and the pose, nothing else.

Everything gives what the plain equation beside it gives; only zeros are left out. The covariance P (d, d) of the state
is ordered [landmarks 3n, pose 6, motion]. A measurement is three numbers [u_left, v, u_right], see
`stereo.reduce_rows`.

>>> H = BlockJacobian(np.array([0]), np.ones((1, 3, 3)), np.ones((1, 3, 6)), 1)
>>> H.times(np.eye(9)).shape
(3, 9)
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

CHUNK = 32  # measurements absorbed at a time: few enough for small matrices, enough to keep products efficient


@dataclass(frozen=True, eq=False)
class BlockJacobian:
    """H of m measurements of the landmarks at `rows` (m,) of n in the state: H_landmark (m, 3, 3), H_pose (m, 3, 6)."""

    rows: np.ndarray
    H_landmark: np.ndarray
    H_pose: np.ndarray
    n: int

    def only(self, which: np.ndarray | slice) -> "BlockJacobian":
        """H of some measurements: (m,) bool, or a slice."""
        return BlockJacobian(self.rows[which], self.H_landmark[which], self.H_pose[which], self.n)

    def times(self, A: np.ndarray) -> np.ndarray:
        """H A, (3m, c), for A (d, c)."""
        end = 3 * self.n
        HA = (self.H_landmark @ A[:end].reshape(self.n, 3, -1)[self.rows]).reshape(3 * len(self.rows), -1)
        if self.H_pose.any():
            HA += self.H_pose.reshape(-1, 6) @ A[end:end + 6]
        return HA

    def transposed_times(self, X: np.ndarray, d: int) -> np.ndarray:
        """H^T X, (d, c), for X (3m, c)."""
        out, end = np.zeros((d, X.shape[1])), 3 * self.n
        out[:end].reshape(self.n, 3, -1)[self.rows] = self.H_landmark.mT @ X.reshape(len(self.rows), 3, -1)
        out[end:end + 6] = self.H_pose.reshape(-1, 6).T @ X
        return out

    def diagonal_blocks(self, P: np.ndarray) -> np.ndarray:
        """The blocks H_i P H_i^T, (m, 3, 3), of each measurement with itself: all that a gate needs of H P H^T."""
        n, rows, pose = self.n, self.rows, slice(3 * self.n, 3 * self.n + 6)
        own = P[:3 * n, :3 * n].reshape(n, 3, n, 3)[rows, :, rows, :]
        cross = self.H_landmark @ P[:3 * n, pose].reshape(n, 3, 6)[rows] @ self.H_pose.mT
        return (self.H_landmark @ own @ self.H_landmark.mT + cross + cross.mT
                + self.H_pose @ P[pose, pose] @ self.H_pose.mT)


def _factored(P: np.ndarray, H: BlockJacobian, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H P and the lower factor L of S = H P H^T + V = L L^T. LAPACK counts by columns, in place: S^T is S."""
    HP = H.times(P)
    S = H.times(HP.T)
    S.reshape(-1)[::len(S) + 1] += variance.ravel()
    L, failed = dpotrf(S.T, lower=1, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("an innovation covariance is not positive definite")
    return HP, L


def correction(P: np.ndarray, H: BlockJacobian, residual: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The delta of `absorb` alone, (d,), all measurements at once: P H^T S^-1 r."""
    HP, L = _factored(P, H, variance)
    return HP.T @ dtrsv(L, dtrsv(L, residual.ravel(), lower=1), lower=1, trans=1)


def absorb(P: np.ndarray, H: BlockJacobian, residual: np.ndarray, variance: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray]:
    """One Kalman update: delta = K r (d,) and P - K S K^T (d, d), with residual r and noise variance (m, 3), px, px^2.

    The noise of measurements is independent, so the update may take them a chunk at a time: each chunk predicts its
    residual from the correction so far, r - H delta, with the H of all. With S = L L^T and Y = L^-1 H P the gain is
    Y^T L^-1 and the new covariance P - Y^T Y: symmetric by construction, and nothing is inverted.
    """
    P, delta = P.copy(), np.zeros(len(P))
    for start in range(0, len(residual), CHUNK):
        part = slice(start, start + CHUNK)
        chunk = H.only(part)
        HP, L = _factored(P, chunk, variance[part])                                 # H P and S = L L^T
        r = residual[part].ravel() - chunk.times(delta[:, None])[:, 0]              # r - H delta
        # BLAS counts by columns: (HP)^T becomes Y^T = (HP)^T L^-T in place
        Y = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T        # Y = L^-1 H P
        delta += Y.T @ dtrsv(L, r, lower=1)                                         # delta + K r
        P -= Y.T @ Y                                                                # P - K S K^T
    return delta, P
