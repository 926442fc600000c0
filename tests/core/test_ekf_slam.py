"""The plain joint filter, piece by piece, against derivatives and loops that share no code with it."""

import numpy as np
import pytest
import reference
from numerical import central_difference
from scipy.linalg import expm

from vislam_edu import ekf_slam, mapping, odometry, simulate, window_slam
from vislam_edu.belief import Belief
from vislam_edu.noise import Noise

NOISE = Noise()
RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def belief():
    """Ten frames in: landmarks that are correlated with each other and with the pose."""
    drive = simulate.street_loop(seed=1, frames=10, visible=6)
    *_, last = ekf_slam.run(drive, NOISE)
    assert len(last.posterior.ids) > 4
    return drive, last.posterior


def moved(belief, delta):
    """The state after an error delta, by the definition of the error: m + delta, T expm(epsilon^)."""
    n = belief.landmarks.size
    return belief.world_T_imu @ expm(reference.hat4(delta[n:])), belief.landmarks + delta[:n].reshape(-1, 3)


def test_predict_moves_the_pose_along_the_twist_and_its_errors_with_it(belief):
    _, before = belief
    u, tau, d = np.array([8.0, 0.1, -0.2, 0.02, -0.03, 0.4]), 0.12, len(before.covariance)
    after = ekf_slam.predict(before, u, tau, NOISE)
    np.testing.assert_allclose(after.world_T_imu, before.world_T_imu @ expm(tau * reference.hat4(u)), atol=1e-12)

    def later(delta):  # [errors of the state, error of the twist] to the error one step later
        T, m = moved(before, delta[:d])
        T = T @ expm(tau * reference.hat4(u + delta[d:]))
        error = np.linalg.inv(after.world_T_imu) @ T
        return np.concatenate([(m - before.landmarks).ravel(), error[:3, 3],
                               [error[2, 1], error[0, 2], error[1, 0]]])

    J = central_difference(later, d + 6, step=1e-5)
    Q = np.diag([NOISE.sigma_v**2] * 3 + [NOISE.sigma_omega**2] * 3)
    expected = J[:, :d] @ before.covariance @ J[:, :d].T + J[:, d:] @ Q @ J[:, d:].T
    np.testing.assert_allclose(after.covariance, expected, atol=1e-8)


def test_the_joint_jacobian_is_the_derivative_of_the_pixels_by_the_whole_state(belief):
    drive, at = belief
    rows = np.array([3, 0, 2])

    def seen(delta):
        T, m = moved(at, delta)
        return np.concatenate([reference.project(drive.camera, T, m[j])[0] for j in rows])

    H = ekf_slam.joint_jacobian(drive.camera.landmark_jacobian(at.world_T_imu, at.landmarks[rows]),
                                drive.camera.pose_jacobian(at.world_T_imu, at.landmarks[rows]), rows, len(at.ids))
    np.testing.assert_allclose(H, central_difference(seen, len(at.covariance)), atol=1e-4, rtol=1e-6)


def test_the_update_is_the_least_squares_estimate(belief):
    """argmin |x|^2_P + |r - H x|^2_V in information form, and its covariance, without a Kalman gain."""
    drive, prior = belief
    ids, n = prior.ids[[2, 0]], len(prior.ids)
    pixels, _ = drive.camera.observe(prior.world_T_imu, prior.landmarks[[2, 0]])
    pixels = pixels + RNG.normal(size=(2, 4))
    posterior, innovation = ekf_slam.update(prior, ids, pixels, drive.camera, NOISE, np.inf)
    H = np.zeros((8, 3 * n + 6))
    for i, j in enumerate((2, 0)):
        _, _, H_m, H_T = reference.project(drive.camera, prior.world_T_imu, prior.landmarks[j])
        H[4 * i:4 * i + 4, 3 * j:3 * j + 3], H[4 * i:4 * i + 4, -6:] = H_m, H_T
    information = np.linalg.inv(prior.covariance) + H.T @ H / NOISE.sigma_px**2
    delta = np.linalg.solve(information, H.T @ innovation.residual.ravel() / NOISE.sigma_px**2)
    T, m = moved(prior, delta)
    np.testing.assert_allclose(posterior.world_T_imu, T, atol=1e-8)
    np.testing.assert_allclose(posterior.landmarks, m, atol=1e-7)
    np.testing.assert_allclose(posterior.covariance, np.linalg.inv(information), atol=1e-7)
    assert innovation.accepted.all()


def test_a_new_landmark_inherits_the_errors_of_the_pose(belief):
    _, at = belief
    s, C, d = np.array([12.0, -2.0, 1.0]), np.diag([0.5, 0.02, 0.01]), len(at.covariance)
    landmark, P = ekf_slam.new_landmark(at.covariance, at.world_T_imu, s, C)

    def joined(delta):  # [errors of the state, error of s] to [landmarks, the new one, pose]
        T, m = moved(at, delta[:d])
        new = (T @ np.append(s + delta[d:], 1))[:3]
        return np.concatenate([(m - at.landmarks).ravel(), new - landmark, delta[d - 6:d]])

    J = central_difference(joined, d + 3)
    np.testing.assert_allclose(landmark, (at.world_T_imu @ np.append(s, 1))[:3])
    np.testing.assert_allclose(P, J[:, :d] @ at.covariance @ J[:, :d].T + J[:, d:] @ C @ J[:, d:].T, atol=1e-8)


def test_the_reports_birth_has_variance_2_and_no_correlation(belief):
    drive, at = belief
    ids, pixels = drive.observed(9)
    fresh = ekf_slam.initialise_as_report(at, ids[:2] + 1000, pixels[:2], drive.camera, NOISE, 0.0)
    n = at.landmarks.size
    np.testing.assert_array_equal(fresh.covariance[n:n + 6, n:n + 6], 2 * np.eye(6))
    assert not fresh.covariance[n:n + 6, :n].any()
    assert not fresh.covariance[n:n + 6, n + 6:].any()
    old = np.r_[:n, n + 6:n + 12]
    np.testing.assert_array_equal(fresh.covariance[np.ix_(old, old)], at.covariance)


def test_a_measurement_behind_the_gate_changes_nothing(belief):
    drive, prior = belief
    predicted, _ = drive.camera.observe(prior.world_T_imu, prior.landmarks[:1])
    posterior, innovation = ekf_slam.update(prior, prior.ids[:1], predicted + 500.0, drive.camera, NOISE, 13.0)
    assert not innovation.accepted.any()
    np.testing.assert_allclose(posterior.world_T_imu, prior.world_T_imu, atol=1e-12)
    np.testing.assert_allclose(posterior.covariance, prior.covariance, atol=1e-12)


def test_the_belief_cannot_be_written_to(belief):
    assert isinstance(belief[1], Belief)
    with pytest.raises(ValueError, match="read-only"):
        belief[1].covariance[0, 0] = 1.0


# --- what every filter reports of a frame ----------------------------------------------------------------------

@pytest.mark.parametrize("name", ["mapping", "mapping as the report", "odometry", "ekf_slam", "window_slam"])
def test_steps_say_what_their_docstring_promises(name):
    drive = simulate.street_loop(seed=2, frames=12, visible=8)
    runs = {"mapping": lambda: mapping.run(drive, NOISE, drive.true_world_T_imu),
            "mapping as the report": lambda: mapping.run(drive, NOISE, drive.true_world_T_imu, mapping.report_prior),
            "odometry": lambda: odometry.localize(drive, NOISE, drive.true_landmarks),
            "ekf_slam": lambda: ekf_slam.run(drive, NOISE),
            "window_slam": lambda: window_slam.run(drive, NOISE)}
    within = set()
    steps = list(runs[name]())
    assert [step.k for step in steps] == list(range(drive.n_frames))
    assert [step.time for step in steps] == drive.times.tolist()
    for step in steps:
        seen, pixels = drive.observed(step.k)
        assert set(step.innovation.ids) <= set(seen)
        where = np.searchsorted(seen, step.innovation.ids)
        np.testing.assert_array_equal(step.innovation.measured, pixels[where])
        assert len(step.innovation.accepted) == len(step.innovation.nis) == len(step.innovation.ids)
        residual = step.innovation.residual
        np.testing.assert_allclose(step.innovation.nis, [r @ np.linalg.inv(S) @ r for r, S in zip(
            residual, step.innovation.covariance)], rtol=1e-8)
        assert type(step.prior) is type(step.posterior)
        for before, after in zip(vars(step.prior).values(), vars(step.posterior).values()):
            assert before.ndim == after.ndim
            assert before.dtype == after.dtype
        assert step.born.dtype.kind == step.retired.dtype.kind == "i"
        assert not set(step.born) & within
        assert set(step.retired) <= within
        within = (within | set(step.born)) - set(step.retired)
        if hasattr(step.posterior, "ids"):
            assert within | set(step.retired) >= set(step.posterior.ids)
    assert bool(within) == (name != "odometry")
