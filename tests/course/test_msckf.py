"""The null space of the MSCKF, and first-estimates Jacobians."""

import numpy as np
import pytest
from numerical import central_difference

from vislam_edu import Noise, RightInvariant, RightPerturbation, imu, inertial_batch, load, se3, simulate, window_slam
from vislam_edu.course.ch16 import msckf, observability
from vislam_edu.stereo import ROWS


@pytest.fixture(scope="module")
def track():
    """The longest track of the street loop: camera, true poses, landmark."""
    drive = load("street_loop")
    longest = np.argmax(drive.last_seen - drive.first_seen)
    frames = np.arange(drive.first_seen[longest], drive.last_seen[longest] + 1)[::10]
    return drive.camera, drive.true_world_T_imu[frames], drive.true_landmarks[longest]


def test_jacobians_of_a_track(track):
    camera, poses, landmark = track
    H_x, H_f = msckf.track_jacobians(camera, poses, landmark)

    def pixels(delta):
        moved = poses @ se3.exp(delta[:-3].reshape(-1, 6))
        return camera.observe(moved, landmark + delta[-3:])[0][:, ROWS].ravel()

    difference = central_difference(pixels, 6 * len(poses) + 3)
    assert np.abs(np.hstack([H_x, H_f]) - difference).max() < 1e-6 * np.abs(difference).max()


def test_the_null_space_update_is_the_joint_update_marginalised(track):
    camera, poses, landmark = track
    rng = np.random.default_rng(0)
    H_x, H_f = msckf.track_jacobians(camera, poses, landmark)
    A = rng.normal(size=(H_x.shape[1],) * 2)
    P, r = 1e-4 * (A @ A.T / len(A) + np.eye(len(A))), rng.normal(size=len(H_x))
    delta, covariance = msckf.update(P, H_x, H_f, r, 0.7)
    joint, marginal = msckf.joint_update(P, H_x, H_f, r, 0.7)
    assert np.abs(delta - joint).max() < 1e-9
    assert np.abs(covariance - marginal).max() < 1e-9 * np.abs(P).max()
    assert np.abs(msckf.null_space(H_f).T @ H_f).max() < 1e-9


def test_a_track_says_nothing_about_a_shift_or_a_turn_of_everything(track):
    """Six directions of the clones that the projected H does not see: those that move all of them as one."""
    camera, poses, landmark = track
    H_x, H_f = msckf.track_jacobians(camera, poses, landmark)
    together = np.concatenate([se3.adjoint(se3.inverse(pose)) for pose in poses])
    assert np.abs(msckf.null_space(H_f).T @ H_x @ together).max() < 1e-6 * np.abs(H_x).max()


def test_a_clone_is_the_pose():
    P = np.diag(np.arange(1.0, 13.0))
    joint = msckf.clone(P, slice(6, 12))
    assert np.array_equal(joint[12:, 12:], P[6:, 6:])
    assert np.array_equal(joint[12:, :12], P[6:])


def test_first_estimates_are_less_overconfident_than_the_report_s_error():
    """On the street loop's first 150 frames, landmarks nearer than 16 m: NEES of the pose, 6 is right."""
    drive = load("street_loop").slice(0, 150)

    def nees(error_state):
        values = []
        for step in window_slam.run(drive, Noise(), error_state, min_disparity=25.0):
            e = error_state.pose_difference(drive.true_world_T_imu[step.k], step.posterior.world_T_imu)
            values.append(e @ np.linalg.solve(step.posterior.pose_covariance, e))
        return np.mean(values[75:])

    standard, first, invariant = map(nees, (RightPerturbation(), msckf.FirstEstimates(), RightInvariant()))
    assert first < standard / 2
    assert invariant < standard / 2


def test_four_directions_are_not_measured_and_a_second_linearisation_point_takes_the_yaw():
    drive, _, _ = simulate.inertial_loop(1, frames=30, tau=0.3, visible=20)
    few = drive.slice(8, 16)
    problem = inertial_batch.Problem(few, Noise(), begin=(imu.State.at_rest(), np.eye(15)))
    estimate = problem.at(few.true_world_T_imu)
    assert observability.unmeasured(observability.jacobian(problem, estimate)) == 4
    assert observability.unmeasured(observability.jacobian(problem, estimate, shift=0.01)) == 3
