"""The Gaussian algebra of a Kalman filter. Nothing here knows what a camera or a pose is.

Everything broadcasts over leading axes: one call updates one state, or thousands of independent ones.

>>> import numpy as np
>>> update(np.array([[4.0]]), H=np.array([[1.0]]), V=np.array([[1.0]]), residual=np.array([5.0]))
(array([4.]), array([[0.8]]))
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv


def central_difference(f: Callable[[np.ndarray], np.ndarray], n: int, step: float = 1e-6) -> np.ndarray:
    """Jacobian of f at 0, numerically: one column per coordinate, (f(+step) - f(-step)) / (2 step).

    f : function of a vector (n,), with values (m,). Returns (m, n).
    What every Jacobian is held against: its error is of the order of step^2, and of rounding divided by step.
    """
    return np.stack([(f(step * e) - f(-step * e)) / (2 * step) for e in np.eye(n)], axis=-1)


def innovation_covariance(covariance: np.ndarray, H: np.ndarray, V: np.ndarray) -> np.ndarray:
    """S = H Sigma H^T + V: how far a measurement may fall from its prediction.

    covariance : (..., n, n). H : (..., m, n). V : (..., m, m). Returns (..., m, m).
    Source: report section 3.2.2.
    """
    return H @ covariance @ np.swapaxes(H, -1, -2) + V


def nis(residual: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Normalised innovation squared, r^T S^-1 r: chi-square with m degrees of freedom if the filter is honest.

    residual : (..., m). S : (..., m, m). Returns (...).
    Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4.
    """
    return np.sum(residual * np.linalg.solve(S, residual[..., None])[..., 0], axis=-1)


def chi_square_quantile(probability: ArrayLike, dof: ArrayLike) -> np.ndarray:
    """What a chi-square number of `dof` degrees of freedom stays below with this probability, in [0, 1].

    The same numbers as `scipy.stats.chi2.ppf`, whose module takes half a second to import.

    >>> float(chi_square_quantile(0.95, 2).round(3))
    5.991
    """
    return 2 * gammaincinv(np.divide(dof, 2), probability)


def gate_threshold(probability: float, dof: int = 4) -> float:
    """The NIS that a correct measurement stays below with this probability; infinite for 1 (no gate).

    Raises ValueError when the probability is not in (0, 1].
    """
    if not 0 < probability <= 1:
        raise ValueError(f"a gate is a probability in (0, 1], got {probability!r}; 1 switches it off")
    return float(chi_square_quantile(probability, dof))


def gain(covariance: np.ndarray, H: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Kalman gain K = Sigma H^T S^-1, by Cholesky: S is never inverted.

    covariance : (..., n, n). H : (..., m, n). S : (..., m, m). Returns (..., n, m).
    Source: report section 3.2.2.
    """
    L = np.linalg.cholesky(S)
    whitened = np.linalg.solve(L, H @ covariance)
    return np.swapaxes(np.linalg.solve(np.swapaxes(L, -1, -2), whitened), -1, -2)


def update(covariance: np.ndarray, H: np.ndarray, V: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One Kalman update; returns the correction of the mean and the new covariance.

    covariance : (..., n, n). H : (..., m, n). V : (..., m, m). residual : (..., m), measured minus predicted.
    Returns delta (..., n) and covariance (..., n, n). The correction is returned, not added: what "adding" means
    is the state's own business (on SE(3) it is not +).

    The report's (I - K H) Sigma is right on paper and loses symmetry and positivity in rounding; the Joseph form
    (I - K H) Sigma (I - K H)^T + K V K^T is the same matrix and keeps both.
    Source: report section 3.2.2; Bar-Shalom et al., section 5.2.
    """
    K = gain(covariance, H, innovation_covariance(covariance, H, V))
    A = np.eye(covariance.shape[-1]) - K @ H
    new = A @ covariance @ np.swapaxes(A, -1, -2) + K @ V @ np.swapaxes(K, -1, -2)
    return (K @ residual[..., None])[..., 0], (new + np.swapaxes(new, -1, -2)) / 2


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
    np.empty(0, int), np.empty((0, 4)), np.empty((0, 4)), np.empty((0, 4, 4)), np.empty(0), np.empty(0, bool)
)


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
