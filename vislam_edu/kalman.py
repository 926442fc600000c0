"""The Gaussian algebra of a Kalman filter. Nothing here knows what a camera or a pose is.

Everything broadcasts over leading axes: one call updates one state, or thousands of independent ones.

>>> import numpy as np
>>> update(np.array([[4.0]]), H=np.array([[1.0]]), V=np.array([[1.0]]), residual=np.array([5.0]))
(array([4.]), array([[0.8]]))
"""

from collections.abc import Callable

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
