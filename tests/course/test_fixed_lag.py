"""The fixed-lag smoother of chapter 16: the batch where nothing leaves, consistent where what left keeps its point."""

import numpy as np
import pytest

from vislam_edu import Noise, batch, inertial, inertial_batch, metrics, se3, simulate
from vislam_edu.course.ch16 import fixed_lag


def drive_and_truth(seed, frames):
    drive, velocity, bias = simulate.inertial_loop(seed, frames=frames, tau=0.3, visible=20, depth=(5.0, 40.0))
    begin = inertial.initial(drive, Noise())
    start = se3.pose(begin[0].rotation, begin[0].position)
    return drive, begin, inertial.true_states(start, drive.true_world_T_imu, velocity, bias)


def test_a_window_that_nothing_leaves_is_the_batch():
    drive, begin, _ = drive_and_truth(0, 8)
    *_, (last, P) = fixed_lag.run(drive, Noise(), begin, lag=9)
    solution = batch.solve(inertial_batch.Problem(drive, Noise(), begin=begin), tolerance=1e-8)
    sigma = np.sqrt(np.diag(P))
    assert np.abs(last.world_T_imu[0] - solution.estimate.world_T_imu[-1]).max() < 1e-2 * sigma[:3].max()
    assert solution.frame_covariance([7])[0] == pytest.approx(P, rel=1e-3, abs=1e-3 * sigma.min()**2)


def nees(seed, freeze):
    """Mean NEES of the pose over frames 8 to 19, while the tilt of the start is being learnt."""
    drive, begin, true = drive_and_truth(seed, 20)
    found = [metrics.nees(fixed_lag.error(last, true[k])[:6], P[:6, :6])
             for k, (last, P) in enumerate(fixed_lag.run(drive, Noise(), begin, lag=4, freeze=freeze), 1)]
    return np.mean(found[7:])


def test_relinearising_what_the_prior_speaks_of_is_overconfident():
    """Over 4 seeds 6 is right; frozen it was 5 to 9, relinearised 15 to 90."""
    frozen, moved = (np.mean([nees(seed, freeze) for seed in range(4)]) for freeze in (True, False))
    assert frozen < 12
    assert moved > 2 * frozen
