"""What a filter believes and what it saw: `Belief` over map and pose, `Innovation`, and one `Step` of a run.

>>> import numpy as np
>>> belief = Belief(np.eye(4), np.zeros((2, 3)), np.arange(2), np.eye(12))
>>> belief.pose, belief.landmark_covariance.shape
(slice(6, 12, None), (2, 3, 3))
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

FARTHEST = 1000.0  # m; a landmark of inverse depth whose distance is larger, or not known, is drawn there


def homogeneous(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks of inverse depth as homogeneous points of the world: M (n, 3) and rho (n,), 1/m.

    points : (n, 3, 5), see `error_state.InverseDepth`. The position is M / rho, m, with
    M = R_c (a, b, 1) + rho C; nothing is divided by rho.
    """
    y = points[..., 4]
    M = points[..., 2] + y[:, None, 0] * points[..., 0] + y[:, None, 1] * points[..., 1] + y[:, 2:] * points[..., 3]
    return M, y[:, 2]


def positions(points: np.ndarray) -> np.ndarray:
    """(n, 3), m, world, of `Belief.points`; an inverse depth counts as at least 1 / `FARTHEST`."""
    if points.ndim == 2:
        return points
    M, rho = homogeneous(points)
    behind = np.minimum(rho - 1 / FARTHEST, 0.0)  # what is missing to a distance that can be drawn
    return (M - behind[:, None] * points[..., 3]) / (rho - behind)[:, None]


@dataclass(frozen=True, eq=False)
class Belief:
    """A Gaussian over the landmarks in the window and the pose, in the coordinates of one error state.

    world_T_imu : (4, 4). ids : (n,), which landmarks of the drive they are.
    points : the landmarks as the error state has them: (n, 3), m, world; or (n, 3, 5), see `error_state.InverseDepth`.
    covariance : (3n+6+t, 3n+6+t), order [landmarks, position, rotation, motion].
    motion : (t,), what a motion model estimates beyond the pose (twist, bias); empty for the plain filter.
    """

    world_T_imu: np.ndarray
    points: np.ndarray
    ids: np.ndarray
    covariance: np.ndarray
    motion: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        for array in (self.world_T_imu, self.points, self.ids, self.covariance, self.motion):
            array.flags.writeable = False

    @cached_property
    def landmarks(self) -> np.ndarray:
        """(n, 3), m, world."""
        return positions(self.points)

    @property
    def pose(self) -> slice:
        """Where the pose error stands in the state."""
        n = 3 * len(self.ids)
        return slice(n, n + 6)

    @property
    def pose_covariance(self) -> np.ndarray:
        """(6, 6), order [position, rotation]."""
        return self.covariance[self.pose, self.pose]

    @property
    def landmark_covariance(self) -> np.ndarray:
        """(n, 3, 3), the landmarks' own blocks."""
        n = len(self.ids)
        i = np.arange(n)
        return self.covariance[:3 * n, :3 * n].reshape(n, 3, n, 3)[i, :, i, :]


@dataclass(frozen=True, eq=False)
class Innovation:
    """What the cameras said in one frame against what the filter expected, for the landmarks it knew.

    ids : (n,) landmark ids. measured, predicted : (n, 4) px, [u_left, v_left, u_right, v_right].
    covariance : (n, 4, 4) px^2, S of each measurement. nis : (n,), 4 degrees of freedom, infinite for a
    point that is not in front of the camera.
    accepted : (n,) bool, False where the gate (or a point behind the camera) kept a measurement out.
    """

    ids: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    covariance: np.ndarray
    nis: np.ndarray
    accepted: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """(n, 4) px, measured minus predicted."""
        return self.measured - self.predicted


NO_INNOVATION = Innovation(
    np.empty(0, int), np.empty((0, 4)), np.empty((0, 4)), np.empty((0, 4, 4)), np.empty(0), np.empty(0, bool))


@dataclass(frozen=True, eq=False)
class Step:
    """One frame of a filter: what it believed before and after looking, and what it saw.

    k : frame. time : s. prior : the belief predicted to this frame. posterior : the belief after the update.
    innovation : see `Innovation`. born, retired : ids of landmarks that came into and left the state here.
    """

    k: int
    time: float
    prior: Any
    posterior: Any
    innovation: Innovation
    born: np.ndarray
    retired: np.ndarray
