"""How uncertain the sensors and the start are: everything the report calls W, V and Sigma_0.

>>> from vislam_edu import Noise
>>> Noise(sigma_omega=0.01).process_covariance(tau=0.1)[5, 5].round(9)
np.float64(1e-06)
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations of the sensors, and the covariance of the pose at the start.

    sigma_v : m/s, white noise on each axis of one linear-velocity sample.
    sigma_omega : rad/s, the same for the gyro. Both belong to one sampling rate, see `from_density`.
    sigma_px : px, white noise on each of the four numbers of a stereo measurement.
    initial_pose_covariance : (6, 6), order [position m, rotation rad], of the filter's own pose error at the start:
        in the body frame for a right perturbation, in the world frame for the right-invariant error. At the identity,
        where filters start unless a pose is given, the two are one. The default is the report's Sigma_RR.
    landmark_prior : m^2, the variance per axis that the report gives a new landmark (Sigma_LL = 2 I).
        Only filters that start a landmark as the report does use it.

    Raises ValueError for a negative or non-finite number and for a covariance that is not symmetric positive
    semi-definite.
    """

    sigma_v: float = 0.5
    sigma_omega: float = 0.05
    sigma_px: float = 0.7
    initial_pose_covariance: np.ndarray = field(default_factory=lambda: np.diag([1e-3] * 3 + [1e-4] * 3))
    landmark_prior: float = 2.0

    def __post_init__(self) -> None:
        for name in ("sigma_v", "sigma_omega", "sigma_px", "landmark_prior"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ValueError(f"Noise.{name} must be a finite number >= 0, got {value!r}")
        if self.sigma_px == 0:
            raise ValueError("Noise.sigma_px must be > 0: a filter cannot weigh perfect pixels")
        P = np.array(self.initial_pose_covariance, dtype=float)
        if P.shape != (6, 6):
            raise ValueError(f"Noise.initial_pose_covariance must have shape (6, 6), got {P.shape}")
        if not np.isfinite(P).all() or not np.allclose(P, P.T) or np.linalg.eigvalsh(P)[0] < -1e-12 * np.abs(P).max():
            raise ValueError("Noise.initial_pose_covariance must be symmetric positive semi-definite")
        P.flags.writeable = False
        object.__setattr__(self, "initial_pose_covariance", P)

    @classmethod
    def from_report(cls, tau: float = 0.1) -> "Noise":
        """The values of the report's section 3.3.3, its W read as diag(1e-4 x3, 1e-7 x3).

        The report's W is per step and does not scale with the time step; here it is turned into noise per
        sample at the nominal time step `tau` (s), so that W comes out as printed for a step of that length.
        The printed last entry, 10^7, can only be a slip for 10^-7.
        """
        return cls(sigma_v=1e-4**0.5 / tau, sigma_omega=1e-7**0.5 / tau, sigma_px=15**0.5)

    @classmethod
    def from_density(cls, velocity_density: float, gyro_density: float, rate: float, **others: Any) -> "Noise":
        """The noise of one sample of an IMU whose datasheet gives noise densities.

        velocity_density : m/s/sqrt(Hz). gyro_density : rad/s/sqrt(Hz). rate : Hz, samples per second.
        others : fields of `Noise` that keep their meaning, sigma_px for example.

        One sample is the mean of white noise over 1/rate seconds, so sigma = density sqrt(rate). A step of
        tau = 1/rate then has W = tau^2 sigma^2 = tau density^2: the same uncertainty per second at every rate.
        A density per root hertz and a random walk per root second are the same number.
        Raises ValueError for a rate that is not a positive finite number, and as `Noise` does.
        Source: the IMU noise model of Kalibr; IEEE Std 952-1997, annex C (Allan variance).
        """
        if not np.isfinite(rate) or rate <= 0:
            raise ValueError(f"rate must be a finite number > 0, got {rate!r}")
        return cls(sigma_v=velocity_density * rate**0.5, sigma_omega=gyro_density * rate**0.5, **others)

    @property
    def twist_covariance(self) -> np.ndarray:
        """(6, 6), (m/s)^2 and (rad/s)^2: covariance of one IMU sample."""
        return np.diag([self.sigma_v**2] * 3 + [self.sigma_omega**2] * 3)

    def process_covariance(self, tau: float) -> np.ndarray:
        """W (6, 6) of one step of `tau` seconds: white noise per sample moves the pose by tau times itself.

        The noise is that of one sample, so tau is the time between samples; at another rate the samples have
        another noise (`from_density`).
        """
        return tau**2 * self.twist_covariance

    @property
    def pixel_covariance(self) -> np.ndarray:
        """V (4, 4), px^2, of one stereo measurement [u_left, v_left, u_right, v_right]."""
        return self.sigma_px**2 * np.eye(4)
