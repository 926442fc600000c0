"""Where cameras see too little for visual odometry: the few discrete readings of a file, judged by a filter.

Each combination of two IMU samples and two translations drives the joint filter; the least contradicted is likeliest.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.special import chdtrc

from .. import kalman, window_slam
from ..drive import Drive
from ..error_state import RightInvariant
from ..noise import Noise
from . import cures
from .report import Finding
from .track_checks import SIGNIFICANCE, chance

_LEAST = {"sigma_v": 0.01, "sigma_omega": 1e-3, "sigma_px": 0.3}  # of the filter that judges


def surprise(drive: Drive, noise: Noise) -> np.ndarray:
    """(T,): summed NIS of each frame's measurements, each counted up to twice the gate's threshold."""
    most = 2 * kalman.gate_threshold(0.99)
    return np.array([np.minimum(step.innovation.nis, most).sum()
                     for step in window_slam.run(drive, noise, RightInvariant())])


def readings(drive: Drive, noise: Noise) -> Iterator[Finding]:
    """Another IMU sample, or -R t for the translation t, where the filter's innovations prefer it clearly."""
    noise = replace(noise, **{key: max(getattr(noise, key), least) for key, least in _LEAST.items()})
    sample = "k" if drive.imu_sample == "k+1" else "k+1"
    changes = (cures.use_imu_sample(sample), cures.swap_translation())
    cost = {}
    for chosen in product((False, True), repeat=2):
        other = drive
        for cure, wanted in zip(changes, chosen):
            other = cure(other) if wanted else other
        cost[chosen] = surprise(other, noise)
    best = min(cost, key=lambda chosen: cost[chosen].sum())
    faults = (("IMU timing", f"read it so: imu_sample={sample!r}", f"IMU sample {sample}"),
              ("lever arm", "replace the translation t of cam_T_imu by -R t", "-R t for the translation of cam_T_imu"))
    for i, (fault, advice, name) in enumerate(faults):
        if not best[i]:
            continue
        without = cost[best[:i] + (False,) + best[i + 1:]]
        # What the filter's own claims are off by makes every gain look that much more certain
        inflation = max(1.0, cost[best].sum() / (4 * max(len(drive.landmark) - drive.n_landmarks, 1)))
        gain = float((without - cost[best]).sum() / inflation)
        p = chdtrc(1, gain)
        if p < SIGNIFICANCE:
            yield Finding(fault, gain, "of squared z", chance(p),
                          f"a filter that reads {name} is contradicted less by the tracks: summed NIS "
                          f"{cost[best].sum():.0f} in place of {without.sum():.0f}", changes[i], advice)
