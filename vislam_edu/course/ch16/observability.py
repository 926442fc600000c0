"""What a few frames with a real IMU can measure, by the rank of all their residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import batch
from ...inertial_batch import Estimate, Problem


def jacobian(problem: Problem, estimate: Estimate, shift: float = 0.0) -> np.ndarray:
    """The Jacobian (rows, 15n + 3m) of the motions between n frames and of their pixels, without the prior.

    shift : m, by which the pixels of the second half of the frames are linearised at other positions, as after a
    relinearisation that spares a prior.
    """
    n, start = problem.drive.n_frames, problem.drive.frame_start
    J = batch.linearise(problem, estimate).whole()[1].toarray()
    moved = replace(estimate, world_T_imu=estimate.world_T_imu + shift * np.eye(4, 4, 3))
    later = 15 * n + 3 * start[n // 2]
    J[later:] = batch.linearise(problem, moved).whole()[1].toarray()[later:]
    return J[15:]


def unmeasured(H: np.ndarray) -> int:
    """How many directions of the unknowns no row of H sees."""
    values = np.linalg.svd(H / np.linalg.norm(H, axis=0), compute_uv=False)
    return int(np.sum(values <= 1e-9 * values[0]))
