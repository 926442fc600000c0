"""When a filter breaks down: which of its results cannot be used, and what is the likely reason."""

import numpy as np

from ..drive import Drive
from ..noise import Noise
from .pipeline import Result

LONG_GAP = 10.0  # s
LEAST = {"sigma_v": 1e-4, "sigma_omega": 1e-5, "sigma_px": 1e-3}  # m/s, rad/s, px
MOST = {"sigma_v": 100.0, "sigma_omega": 10.0, "sigma_px": 100.0}


def unusable(result: Result) -> list[str]:
    """Names of the estimates whose numbers are not finite or whose covariances are not positive definite."""
    estimates = {"dead reckoning": (result.dead_reckoning.world_T_imu, result.dead_reckoning.covariance),
                 "the map on the poses of dead reckoning": _seen(result.mapped.map),
                 "the path": (result.slam.trajectory.world_T_imu, result.slam.trajectory.covariance),
                 "the map": _seen(result.slam.map)}
    return [name for name, (mean, covariance) in estimates.items()
            if not (np.isfinite(mean).all() and positive_definite(covariance))]


def _seen(found):
    return found.landmarks[found.seen], found.covariance[found.seen]


def positive_definite(covariance: np.ndarray) -> bool:
    """Whether all of these matrices (..., d, d) are finite and positive definite in floating point numbers."""
    if not np.isfinite(covariance).all():
        return False
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return True


def likely_reason(drive: Drive, noise: Noise) -> str:
    """What in a recording or in the assumed noise is likely to have broken a filter, in words."""
    gaps = np.diff(drive.times)
    if len(gaps) and gaps.max() > LONG_GAP:
        k = int(gaps.argmax())
        return (f"likely because of the gap of {gaps[k]:.3g} s after frame {k}: use the part before (--to {k + 1}) "
                f"or after (--from {k + 1})")
    given = {name: getattr(noise, name) for name in LEAST}
    for name, value in given.items():
        if value > MOST[name]:
            return f"likely because the assumed noise is huge: {name} is {value:.3g}"
    for name, value in given.items():
        if value < LEAST[name]:
            return f"likely because the assumed noise is tiny: {name} is {value:.3g}; assume more"
    return "neither a gap nor the assumed noise explains it; `audit` says what else may be wrong with the recording"
