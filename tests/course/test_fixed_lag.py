"""The fixed-lag smoother of chapter 16: the batch where nothing leaves, consistent where what left keeps its point."""

import numpy as np

from vislam_edu import Noise, batch, inertial, inertial_batch, metrics, se3, simulate
from vislam_edu.course.ch16 import fixed_lag
from vislam_edu.recordings import shipped


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
    assert np.abs(last.world_T_imu[0] - solution.estimate.world_T_imu[-1]).max() < 0.05 * sigma[:3].max()
    apart = (solution.frame_covariance([7])[0] - P) / np.outer(sigma, sigma)
    assert np.abs(apart).max() < 0.02  # frame 0 is linearised at the prior here, at its estimate there


def nees(seed, freeze):
    """Mean NEES of the pose over frames 8 to 15, while the tilt of the start is being learnt."""
    drive, begin, true = drive_and_truth(seed, 16)
    found = [metrics.nees(fixed_lag.error(last, true[k])[:6], P[:6, :6])
             for k, (last, P) in enumerate(fixed_lag.run(drive, Noise(), begin, lag=4, freeze=freeze), 1)]
    return np.mean(found[7:])


def test_relinearising_what_the_prior_speaks_of_is_overconfident():
    """6 is right. Three drives here, 20 longer ones stored for the chapter, with their 99.9 % band."""
    frozen, moved = (np.mean([nees(seed, freeze) for seed in range(3)]) for freeze in (True, False))
    assert frozen < 12
    assert moved > 2 * frozen
    stored = {name: np.array(rows)[:, 1] for name, rows in shipped.results("real_imu")["fixed_lag"].items()}
    low, high = metrics.chi2_band(6, 20, probability=0.999)
    assert low < stored["frozen"].mean() < high
    assert (stored["relinearised"] > stored["frozen"]).mean() > 0.8
    assert np.median(stored["relinearised"]) > 2 * np.median(stored["frozen"])
