"""The normal equations of a batch estimate by blocks, and their solution by the Schur complement.

Sources: Triggs et al., Bundle adjustment: a modern synthesis, 2000, section 6; Barfoot, State Estimation for Robotics.

>>> import numpy as np
>>> block_rows(3, np.stack([np.eye(6)] * 2), np.stack([-np.eye(6)] * 2)).shape
(12, 18)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag, cho_solve_banded, cholesky_banded
from scipy.sparse import bsr_array, csr_array

if TYPE_CHECKING:
    from .batch import Linearised

ALMOST_NOTHING = 1e-12  # 1/m^2, information about every landmark: where no camera measured one, nothing divides by 0


def block_rows(n_frames: int, *blocks: np.ndarray) -> bsr_array:
    """Sparse (dn, dT) whose row i holds blocks[0][i] at frame i, blocks[1][i] at frame i + 1, ...; each (n, d, d)."""
    (n, d, _), width = blocks[0].shape, len(blocks)
    columns = np.arange(n)[:, None] + np.arange(width)
    return bsr_array((np.stack(blocks, axis=1).reshape(-1, d, d), columns.ravel(), width * np.arange(n + 1)),
                     shape=(d * n, d * n_frames))


class NormalEquations:
    """H delta = g with H = J^T J and g = -J^T r, in blocks: poses, landmarks, constants of IMU and lenses.

        U    E     B       poses: each frame touches few others
        E^T  V     B       landmarks: V is block diagonal, no residual holds two of them
        B^T  B^T   D       B has the rows of both; only the lenses touch landmarks
    """

    def __init__(self, at: Linearised):
        self.problem = problem = at.problem
        size, T, M, N = problem.size, problem.drive.n_frames, problem.drive.n_landmarks, len(at.r_px)
        to_frame = csr_array((np.ones(N), np.arange(N), problem.drive.frame_start), shape=(T, N))  # sums observations
        to_landmark = csr_array((np.ones(N), (problem.landmark, np.arange(N))), shape=(M, N))
        poseT, landmarkT = np.swapaxes(at.J_pose, 1, 2), np.swapaxes(at.J_landmark, 1, 2)

        def total(sums, blocks):
            return (sums @ blocks.reshape(N, -1)).reshape(sums.shape[0], *blocks.shape[1:])

        self.U = (at.J.T @ at.J + block_rows(T, total(to_frame, poseT @ at.J_pose))).tobsr((size, size))
        self.V = total(to_landmark, landmarkT @ at.J_landmark) + ALMOST_NOTHING * np.eye(3)
        self.E = problem.by_frame(poseT @ at.J_landmark)
        L = at.J_lens.shape[2]
        lens = at.J_lens.reshape(3 * N, L)
        self.free = np.flatnonzero(problem.sigma_constants > 0)
        information = problem.sigma_constants[self.free]**-2.0
        by_lens = [total(to_frame, poseT @ at.J_lens).reshape(size * T, L),
                   total(to_landmark, landmarkT @ at.J_lens).reshape(3 * M, L)]
        by_imu = [at.J.T @ at.J_imu, np.zeros((3 * M, 4))]
        self.B = np.hstack([np.vstack(by_imu), np.vstack(by_lens)])[:, self.free]
        D = block_diag(at.J_imu.T @ at.J_imu, lens.T @ lens)
        self.D = D[np.ix_(self.free, self.free)] + np.diag(information)
        g_constants = np.concatenate([at.J_imu.T @ at.r, lens.T @ at.r_px.ravel()])[self.free]
        self.g = -np.concatenate([
            at.J.T @ at.r + total(to_frame, np.matvec(poseT, at.r_px)).ravel(),
            total(to_landmark, np.matvec(landmarkT, at.r_px)).ravel(),
            g_constants + information * at.r_constants[self.free]])

    def with_known(self, step: np.ndarray) -> np.ndarray:
        """The step (6T + 3M + f,) with zeros for the constants that are known: (6T + 3M + 4 + L,)."""
        constants = np.zeros(len(self.problem.sigma_constants))
        constants[self.free] = step[len(self.B):]
        return np.concatenate([step[:len(self.B)], constants])


class Factorised:
    """The normal equations ready to be solved: landmarks eliminated first, then the poses, then the constants.

    With V = L L^T and F = E L^-T the landmarks leave S = U - F F^T to the poses (the Schur complement). Two frames are
    neighbours in S when one landmark is seen in both, so S is a band as wide as the longest track. The constants
    touch every frame: a border.

    damping : lambda of Levenberg-Marquardt, H + lambda diag(H).
    Raises LinAlgError when H is not positive definite (in floating point numbers).
    """

    def __init__(self, normal: NormalEquations, damping: float = 0.0):
        problem = normal.problem
        V = normal.V + damping * normal.V * np.eye(3)
        self.L_inverse = np.linalg.inv(np.linalg.cholesky(V))
        L_inverseT = np.swapaxes(self.L_inverse, 1, 2)
        self.F = problem.by_frame(normal.E.data @ L_inverseT[problem.landmark])
        self.S = (normal.U - self.F @ self.F.T).tocoo()
        size = problem.size
        self.place = (size * problem.rank[:, None] + np.arange(size)).ravel()  # of each row of S in the band
        row, column = self.place[self.S.row], self.place[self.S.col]
        below = row >= column
        band = np.zeros(((row - column).max() + 1, len(self.place)))
        band[(row - column)[below], column[below]] = self.S.data[below]
        band[0, self.place] += damping * normal.U.diagonal()
        self.band = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
        self.B = normal.B
        self.H_B = self._without_border(normal.B)
        D = normal.D + damping * normal.D * np.eye(len(normal.D))
        self.D_inverse = np.linalg.inv(D - normal.B.T @ self.H_B)

    def _poses(self, right: np.ndarray) -> np.ndarray:
        """S^-1 times right (6T, n)."""
        ordered = np.empty_like(right)
        ordered[self.place] = right
        return cho_solve_banded((self.band, True), ordered, overwrite_b=True, check_finite=False)[self.place]

    def _without_border(self, g: np.ndarray) -> np.ndarray:
        """Poses and landmarks (6T + 3M, n) for the right side g (6T + 3M, n) if the constants were known."""
        poses, n = len(self.place), g.shape[1]

        def each(blocks, x):  # (M, 3, 3) times (3M, n)
            return (blocks @ x.reshape(len(blocks), 3, n)).reshape(x.shape)

        landmarks = each(self.L_inverse, g[poses:])
        x = self._poses(g[:poses] - self.F @ landmarks)
        return np.concatenate([x, each(np.swapaxes(self.L_inverse, 1, 2), landmarks - self.F.T @ x)])

    def solve(self, g: np.ndarray) -> np.ndarray:
        """H^-1 times g (6T + 3M + f, n): f constants are unknown."""
        end = len(self.B)
        x = self._without_border(g[:end])
        constants = self.D_inverse @ (g[end:] - self.B.T @ x)
        return np.concatenate([x - self.H_B @ constants, constants])
