"""The batch estimate with preintegrated motions: its derivatives, its minimum, its claims, and the filter beside it."""

from functools import partial

import numpy as np
import pytest
from numerical import central_difference

from vislam_edu import (
    InverseDepth,
    Noise,
    RightPerturbation,
    batch,
    imu,
    inertial,
    inertial_batch,
    metrics,
    se3,
    simulate,
    window_slam,
)


def problem_of(seed, **options):
    """A drive of few keyframes, three a second, its truth in the world of its start; and the true states there."""
    drive, velocity, bias = simulate.inertial_loop(seed, **{"frames": 20, "tau": 0.3, "visible": 20} | options)
    begin = inertial.initial(drive, Noise())
    start = se3.pose(begin[0].rotation, begin[0].position)
    true = inertial.true_states(start, drive.true_world_T_imu, velocity, bias)
    drive = inertial.in_world_of_estimate(drive, np.broadcast_to(start, (drive.n_frames, 4, 4)))
    return inertial_batch.Problem(drive, Noise(), begin=begin), true


def error(problem, estimate, true, k):
    """(15,), [pose as a right perturbation, velocity, biases] of frame k."""
    pose = RightPerturbation().pose_difference(problem.drive.true_world_T_imu[k], estimate.world_T_imu[k])
    return np.concatenate([pose, true[k].difference(estimate.states[k])[6:]])


def test_derivatives_of_the_motion():
    problem, _ = problem_of(0, frames=6)
    T, M = problem.drive.n_frames, 3 * problem.drive.n_landmarks
    estimate = problem.at(problem.drive.true_world_T_imu)
    estimate = estimate.retract(np.append(np.random.default_rng(0).normal(0, 0.02, 15 * T), np.zeros(M + 4)), None)

    def residual(delta):
        return problem.motion_residuals(estimate.retract(np.append(delta, np.zeros(M + 4)), None))[0]

    difference = central_difference(residual, 15 * T)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    assert np.abs((problem.motion_residuals(estimate)[1].toarray() - difference) / scale).max() < 1e-5


def test_without_noise_the_truth_is_the_minimum():
    """Samples without noise along the path, exact pixels, and the true start: no cost, and the solver stays there."""
    quiet = imu.ImuNoise(1e-9, 1e-9, 1e-9, 1e-9)
    drive, velocity, bias = simulate.inertial_loop(1, frames=15, tau=0.3, noise=quiet, sigma_px=0)
    drive = drive.replace(imu=inertial.ImuSamples(drive.imu.times, drive.imu.gyro, drive.imu.accelerometer))
    T = drive.true_world_T_imu[0]
    begin = imu.State(T[:3, :3], T[:3, 3], velocity[0], *np.split(bias[0], 2)), 1e-4 * np.eye(15)
    problem = inertial_batch.Problem(drive, Noise(), begin=begin)
    solution = batch.solve(problem, problem.at(drive.true_world_T_imu), tolerance=1e-9)
    assert solution.cost < 1e-3
    assert np.abs(solution.estimate.world_T_imu - drive.true_world_T_imu).max() < 1e-4


@pytest.fixture(scope="module")
def solved():
    """Eight drives, each solved from where the IMU alone leads."""
    problems = [problem_of(seed) for seed in range(8)]
    return [(batch.solve(problem), true) for problem, true in problems]


def test_the_cost_is_a_chi_square(solved):
    """Of 8 drives with about 900 degrees of freedom each the mean cost is 1 within 5 % (three sigma)."""
    assert all(solution.converged for solution, _ in solved)
    assert np.mean([solution.cost_per_dof for solution, _ in solved]) == pytest.approx(1, abs=0.05)


def test_claims_of_the_last_frame_hold_over_seeds(solved):
    """The mean of 8 runs lies between 9.3 and 22.2 for 15 numbers, between 2.8 and 10.9 for the pose (99.9 %)."""
    found = []
    for solution, true in solved:
        e, P = error(solution.problem, solution.estimate, true, -1), solution.frame_covariance([19])[0]
        found.append([metrics.nees(e, P), metrics.nees(e[:6], P[:6, :6])])
    whole, pose = np.mean(found, axis=0)
    assert 9.3 < whole < 22.2
    assert 2.8 < pose < 10.9


def test_it_is_the_filter_that_linearises_again(solved):
    """At the last frame the filter has seen the same: its position differs by a part of what both claim."""
    for solution, _ in solved[:3]:
        problem = solution.problem
        model = partial(inertial.AccelerometerDriven, begin=problem.begin)
        *_, last = window_slam.run(problem.drive, problem.noise, InverseDepth(), gate=1, motion_model=model)
        sigma = np.sqrt(np.trace(solution.pose_covariance([19])[0, :3, :3]))
        apart = np.linalg.norm(last.posterior.world_T_imu[:3, 3] - solution.estimate.world_T_imu[-1, :3, 3])
        assert apart < sigma / 2
