"""The six directions that stereo and body twists cannot tell, and which filter keeps them unseen."""

import functools

import numpy as np
import pytest
from numerical import central_difference

from vislam_edu import se3, simulate, window_slam
from vislam_edu.course.ch07 import observability
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise

RIGHT_PERTURBATION, RIGHT_INVARIANT = RightPerturbation(), RightInvariant()
WINDOW = slice(20, 32)
both = pytest.mark.parametrize("error_state", [RIGHT_PERTURBATION, RIGHT_INVARIANT], ids=lambda e: e.name)


@functools.cache
def drive():
    return simulate.street_loop(seed=0, frames=40, loop_length=500)


@functools.cache
def steps(error_state):
    return list(window_slam.run(drive(), Noise(), error_state))


def matrix(error_state, at):
    window = steps(error_state)[WINDOW]
    ids = observability.common_landmarks(window)
    assert len(ids) >= 5
    frames = range(*WINDOW.indices(drive().n_frames))
    points = (observability.at_truth(drive(), frames, ids) if at == "truth"
              else observability.at_estimates(window, ids))
    return observability.observability_matrix(error_state, drive().camera, points), points


@both
def test_global_directions_are_the_error_of_a_moved_world(error_state):
    """By central differences of the error's own definition, with car and map moved as one."""
    rng = np.random.default_rng(1)
    T, landmarks = se3.exp(rng.normal(size=6)), rng.normal(size=(4, 3)) * 10

    def error(xi):
        moved_T, moved = se3.exp(xi) @ T, se3.transform(se3.exp(xi), landmarks)
        return np.concatenate([error_state.landmark_difference(moved_T, T, moved, landmarks).ravel(),
                               error_state.pose_difference(moved_T, T)])

    numeric = central_difference(error, 6)
    np.testing.assert_allclose(observability.global_directions(error_state, T, landmarks), numeric, atol=1e-7)


@both
def test_at_the_true_states_the_null_space_is_the_global_directions(error_state):
    M, points = matrix(error_state, "truth")
    n = points.landmarks.shape[1]
    assert (observability.rank_by_frame(M) == 3 * n).all()
    null = np.linalg.svd(M.reshape(-1, 3 * n + 6))[2][3 * n:]
    directions = observability.global_directions(error_state, points.world_T_imu[0], points.landmarks[0])
    basis, _ = np.linalg.qr(directions)
    np.testing.assert_allclose(np.linalg.svd(null @ basis, compute_uv=False), 1, atol=1e-9)


def test_at_the_estimates_the_right_perturbation_sees_all_six():
    M, points = matrix(RIGHT_PERTURBATION, "estimates")
    n = points.landmarks.shape[1]
    ranks = observability.rank_by_frame(M)
    assert ranks[0] == 3 * n
    assert ranks[-1] == 3 * n + 6
    assert (observability.information_gained(RIGHT_PERTURBATION, M, points) > 1).all()


def test_at_the_estimates_the_right_invariant_error_still_sees_none():
    M, points = matrix(RIGHT_INVARIANT, "estimates")
    assert (observability.rank_by_frame(M) == 3 * points.landmarks.shape[1]).all()
    np.testing.assert_allclose(observability.information_gained(RIGHT_INVARIANT, M, points), 0, atol=1e-9)


def test_the_right_perturbation_claims_a_heading_that_was_never_measured_and_the_right_invariant_does_not():
    """No sensor tells the heading, so its variance may only grow. Prior and posterior of every frame."""
    start = Noise().initial_pose_covariance[5, 5]

    def heading_variance(error_state, belief):
        W = error_state.world_pose(belief.world_T_imu)
        return (W @ belief.pose_covariance @ W.T)[5, 5]

    def claimed(error_state):
        return np.array([heading_variance(error_state, belief)
                         for step in steps(error_state) for belief in (step.prior, step.posterior)])

    assert claimed(RIGHT_INVARIANT).min() >= start * (1 - 1e-9)
    assert claimed(RIGHT_PERTURBATION).min() < 0.1 * start
