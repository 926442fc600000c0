"""Relative inverse depth: every block against central differences, also at rho = 0 and rho < 0, and the two filters."""

import numpy as np
import pytest
from numerical import central_difference

from vislam_edu import belief as belief_module
from vislam_edu import inverse_depth, metrics, motion, robust, se3, simulate, smoother, stereo, window_slam
from vislam_edu.belief import Belief
from vislam_edu.course.ch07 import observability
from vislam_edu.error_state import InverseDepth, RightInvariant
from vislam_edu.noise import Noise
from vislam_edu.studies import consistency, pipeline
from vislam_edu.widgets import Explorer

ERROR = InverseDepth()
RHO = np.array([0.12, 0.02, 0.0, -0.004])  # 1/m: near, far, at infinity, beyond
N = len(RHO)
D = 3 * N + 6


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=1, frames=12, visible=10)


def estimate(drive, tail=6):
    """A belief far from the origin whose charts are cameras behind the present one."""
    rng = np.random.default_rng(8)
    T = se3.exp(np.concatenate([5 * rng.normal(size=3), rng.normal(size=3)]))
    points = np.empty((N, 3, 5))
    for i, rho in enumerate(RHO):
        back = se3.exp(np.concatenate([[-1.0 - i, 0.3, 0.1], 0.05 * rng.normal(size=3)]))
        points[i, :, :4] = (T @ back @ drive.camera.imu_T_cam)[:3]
        points[i, :, 4] = [*rng.uniform(-0.3, 0.3, 2), rho]
    A = 0.1 * rng.normal(size=(3 * N + tail,) * 2)
    state = np.concatenate([[9.0, 0.1, -0.1], 0.3 * rng.normal(size=3), 0.01 * rng.normal(size=3)])[:tail - 6]
    return Belief(T, points, np.arange(N), A @ A.T, state)


def homogeneous(belief):
    """(n, 4): the landmarks in the world as homogeneous points [M, rho]."""
    return np.column_stack(belief_module.homogeneous(belief.points))


def moved(belief, error):
    return motion.retract(belief, error, np.array(belief.covariance), ERROR)


def error_of(belief, T, world, state=()):
    """The error of a belief, the truth being the pose (4, 4) and the landmarks (n, 4), homogeneous, by definition."""
    x = se3.log(T @ se3.inverse(belief.world_T_imu))
    etas = []
    for point, true in zip(belief.points, world):
        chart = se3.exp(x) @ se3.pose(point[:, :3], point[:, 3])
        h = se3.inverse(chart) @ true
        etas.append(h[[0, 1, 3]] / h[2] - point[:, 4])
    return np.concatenate([*etas, x, np.subtract(state, belief.motion) if len(belief.motion) else []])


def assert_same(analytic, numeric):
    np.testing.assert_allclose(analytic, numeric, atol=1e-6 * max(1.0, np.abs(numeric).max()), rtol=0)


def dense(transition, which):
    top, tail = (getattr(transition, f"{which}_{part}") for part in ("landmarks", "tail"))
    top = top.reshape(3 * N, -1)
    if which == "N":
        return np.concatenate([top, tail])
    return np.block([[np.eye(3 * N), top], [np.zeros((len(tail), 3 * N)), tail]])


def test_a_difference_undoes_a_retraction(drive):
    before = estimate(drive)
    for size in (1e-8, 1e-2, 0.3):
        error = size * np.random.default_rng(0).normal(size=D) * np.append(np.tile([1, 1, 0.01], N), np.ones(6))
        true = moved(before, error)
        np.testing.assert_allclose(error_of(before, true.world_T_imu, homogeneous(true)), error, atol=1e-9)
        near = RHO > 0.01
        np.testing.assert_allclose(
            ERROR.landmark_difference(true.world_T_imu, before.world_T_imu, true.landmarks[near], before.points[near]),
            error[:3 * N].reshape(N, 3)[near], atol=1e-9)


def test_prediction_of_the_imu_driven_model(drive):
    before, tau, twist = estimate(drive), drive.taus[5], drive.step_twists[5]
    transition = motion.ImuDriven(drive, Noise(), ERROR).transition(before, 5)
    after = Belief(transition.world_T_imu, before.points, before.ids, before.covariance)

    def one_step_later(error, noise):
        true = moved(before, error)
        return error_of(after, true.world_T_imu @ se3.exp(tau * (twist + noise)), homogeneous(true))

    assert_same(dense(transition, "F"), central_difference(lambda x: one_step_later(x, 0.0), D))
    assert_same(dense(transition, "N"), central_difference(lambda n: one_step_later(np.zeros(D), n), 6))
    B = transition.N_tail
    np.testing.assert_allclose([inverse_depth.landmark_noise(point, B) for point in before.points],
                               transition.N_landmarks, atol=1e-12)


def test_prediction_along_an_estimated_twist(drive):
    before = estimate(drive, tail=15)
    transition = motion.TwistAndBias(drive, Noise(), ERROR).transition(before, 5)
    after = Belief(transition.world_T_imu, before.points, before.ids, before.covariance, before.motion)

    def one_step_later(error):
        true = moved(before, error)
        T = true.world_T_imu @ se3.exp(drive.taus[5] * true.motion[:6])
        return error_of(after, T, homogeneous(true), true.motion)

    assert_same(dense(transition, "F"), central_difference(one_step_later, 3 * N + 15))


def test_measurement_sees_the_landmark_and_not_the_pose(drive):
    before = estimate(drive)
    q, H, H_pose = ERROR.measure(drive.camera, before.world_T_imu, before.points)
    pixels, in_front = drive.camera.project_homogeneous(q)
    assert in_front.all()
    assert pixels[2, 0] > pixels[2, 2] - 1e-9  # rho = 0 is born without disparity, and has none later
    assert pixels[3, 0] < pixels[3, 2]  # rho < 0: a negative disparity, as noisy pixels have
    assert not H_pose.any()

    def seen(error):
        true = moved(before, error)
        in_cam = homogeneous(true) @ (drive.camera.cam_T_imu @ se3.inverse(true.world_T_imu)).T
        return stereo.reduce_rows(drive.camera.project_homogeneous(in_cam)[0]).ravel()

    numeric = central_difference(seen, D).reshape(N, 3, D)
    for i in range(N):
        assert_same(H[i], numeric[i, :, 3 * i:3 * i + 3])
        numeric[i, :, 3 * i:3 * i + 3] = 0
    np.testing.assert_allclose(numeric, 0, atol=1e-6)


def test_birth_is_linear_in_the_pixels_whatever_the_disparity(drive):
    camera, T = drive.camera, estimate(drive).world_T_imu
    pixels = np.array([[700.0, 100, 650, 101], [500, 200, 500, 200], [600, 150, 603, 149]])  # disparity 50, 0, -3 px
    points, covariance, ok = ERROR.triangulate(camera, T, pixels, 0.7, min_disparity=1.0)
    assert ok.all()
    q, H, _ = ERROR.measure(camera, T, points)
    reduced = stereo.reduce_rows(pixels)
    np.testing.assert_allclose(stereo.reduce_rows(camera.project_homogeneous(q)[0]), reduced, atol=1e-9)
    np.testing.assert_allclose(H @ covariance @ H.mT, np.tile(0.49 * np.diag(stereo.ROW_VARIANCE), (3, 1, 1)),
                               atol=1e-9)
    assert not ERROR.inherited(T, points).any()


def test_errors_in_charts_that_stand_still_and_in_metres(drive):
    before = estimate(drive)

    def in_still_charts(error):
        charts = [se3.pose(point[:, :3], point[:, 3]) for point in before.points]
        h = [se3.inverse(chart) @ m for chart, m in zip(charts, homogeneous(moved(before, error)))]
        return np.concatenate([one[[0, 1, 3]] / one[2] for one in h])

    expected = np.concatenate([np.eye(3 * N), ERROR.world_landmark(before.points).reshape(3 * N, 6)], axis=1)
    assert_same(expected, central_difference(in_still_charts, D))

    def positions(shift):
        return belief_module.positions(ERROR.shifted(before.points[:2], shift.reshape(2, 3))).ravel()

    numeric = central_difference(positions, 6, step=1e-5).reshape(2, 3, 2, 3)
    metres = ERROR.metres(before.points)
    assert_same(metres[:2], numeric[[0, 1], :, [0, 1]])
    assert np.isfinite(metres).all()
    assert np.isfinite(before.landmarks).all()


def test_slip_is_q_pixels_in_the_image(drive):
    before = estimate(drive, tail=15)
    model, usual = robust.RealDrive(drive, Noise(), ERROR), motion.TwistAndBias(drive, Noise(), ERROR, 0.1, 0.03)
    after, plain = model.predict(before, 5), usual.predict(before, 5)
    added = after.covariance - plain.covariance
    depth = ERROR.measure(drive.camera, before.world_T_imu, before.points)[0][:, 2]
    q, H, _ = ERROR.measure(drive.camera, after.world_T_imu, after.points)
    slip = model.slip_px(depth, q[:, 2])
    for i in range(N):
        block = slice(3 * i, 3 * i + 3)
        np.testing.assert_allclose(H[i] @ added[block, block] @ H[i].T, slip[i]**2 * np.diag(stereo.ROW_VARIANCE),
                                   atol=1e-6)
        added[block, block] = 0
    assert not added.any()


@pytest.fixture(scope="module")
def small():
    """60 frames, few landmarks in view, some of them outliers: small enough for the plain filter."""
    return simulate.street_loop(seed=3, frames=60, visible=10, outlier_share=0.1)


def test_the_window_agrees_with_the_plain_filter(small):
    rejected = 0
    for step, plain in zip(window_slam.run(small, Noise(), ERROR), inverse_depth.run(small, Noise()), strict=True):
        a, b = step.posterior, plain.posterior
        rows = np.array([list(b.ids).index(i) for i in a.ids], dtype=int)
        index = np.concatenate([(3 * rows[:, None] + np.arange(3)).ravel(), np.arange(-6, 0)])
        np.testing.assert_allclose(a.world_T_imu, b.world_T_imu, atol=1e-9)
        np.testing.assert_allclose(a.points, b.points[rows], atol=1e-9)
        np.testing.assert_allclose(a.covariance, b.covariance[np.ix_(index, index)], rtol=1e-6, atol=1e-12)
        np.testing.assert_array_equal(step.innovation.accepted, plain.innovation.accepted)
        np.testing.assert_allclose(step.innovation.nis, plain.innovation.nis, rtol=1e-6)
        np.testing.assert_array_equal(step.born, plain.born)
        rejected += (~step.innovation.accepted).sum()
    assert rejected > 0, "the gate was never at work, so this says nothing about it"


def posteriors(steps):
    """Poses (T, 4, 4) and their covariances (T, 6, 6)."""
    beliefs = [step.posterior for step in steps]
    return np.array([b.world_T_imu for b in beliefs]), np.array([b.pose_covariance for b in beliefs])


def test_moving_and_turning_the_world_changes_nothing(small):
    """Also 500 m away and upside down: the same poses, seen from the start, and the same NEES."""
    away = se3.exp(np.array([300.0, -400.0, 50.0, 1.0, -2.0, 0.5]))
    Ad = se3.adjoint(away)
    there = Noise(initial_pose_covariance=Ad @ Noise().initial_pose_covariance @ Ad.T)
    T, P = posteriors(window_slam.run(small, Noise(), ERROR))
    T_far, P_far = posteriors(window_slam.run(small, there, ERROR, world_T_imu=away))
    np.testing.assert_allclose(se3.inverse(away) @ T_far, T, atol=1e-9)
    true = small.true_world_T_imu
    np.testing.assert_allclose(metrics.pose_nees(ERROR, away @ true, T_far, P_far).pose,
                               metrics.pose_nees(ERROR, true, T, P).pose, rtol=1e-6, atol=1e-9)


def mean_nees(error_state, seed, **street):
    """Mean NEES of the pose over one street, started off the truth by a draw from the claimed covariance."""
    noise = Noise(sigma_px=street.get("sigma_px", 0.7))
    drive = simulate.street_loop(seed, frames=100, visible=20, **street)
    start = consistency.initial_pose(drive, consistency.FilterConfig(noise, error_state), seed)
    poses, claimed = posteriors(window_slam.run(drive, noise, error_state, world_T_imu=start))
    return metrics.pose_nees(error_state, drive.true_world_T_imu, poses, claimed).pose.mean()


@pytest.mark.parametrize("street", [{}, {"sigma_px": 3.0}, {"depth": (60.0, 250.0)}], ids=["street", "3 px", "far"])
def test_it_is_honest_where_the_other_is_not(street):
    """Ten seeds. The band is chi-square's for ten numbers of 6 degrees of freedom, 99.9 %: errors live that long."""
    low, high = metrics.chi2_band(6, 10, 0.999)
    assert low < np.mean([mean_nees(ERROR, seed, **street) for seed in range(10)]) < high
    if street:
        assert np.mean([mean_nees(RightInvariant(), seed, **street) for seed in range(10)]) > high


def test_no_measurement_tells_a_shift_or_a_turn(small):
    steps = list(window_slam.run(small, Noise(), ERROR))[20:28]
    points = observability.at_estimates(steps, observability.common_landmarks(steps))
    matrix = observability.observability_matrix(ERROR, small.camera, points)
    n = points.landmarks.shape[1]
    assert n > 2
    assert (observability.rank_by_frame(matrix) == 3 * n).all()
    assert not matrix[..., 3 * n:].any()
    directions = observability.global_directions(ERROR, points.world_T_imu[0], points.landmarks[0])
    np.testing.assert_allclose(directions[:3 * n], 0, atol=1e-9)


def test_the_backward_pass_agrees_to_first_order_with_the_filter_that_keeps_everything():
    """With little noise the two agree below their uncertainty, where a map without the pass is a sigma off."""
    quiet = Noise(sigma_v=0.02, sigma_omega=0.002, sigma_px=0.1, initial_pose_covariance=1e-8 * np.eye(6))
    drive = simulate.street_loop(seed=2, frames=60, visible=15, sigma_v=0.02, sigma_omega=0.002, sigma_px=0.1)
    *_, step = window_slam.run(drive, quiet, ERROR, retire=window_slam.retire_none)
    full, final = step.posterior, smoother.final_map(drive, quiet, ERROR)
    np.testing.assert_array_equal(np.flatnonzero(final.seen), full.ids)
    claimed = pipeline.world_landmark_covariance(full, ERROR)
    assert np.sqrt(metrics.nees(final.landmarks[full.ids] - full.landmarks, claimed)).max() < 0.2
    traces = [np.trace(covariance, axis1=1, axis2=2) for covariance in (final.covariance[full.ids], claimed)]
    np.testing.assert_allclose(*traces, rtol=0.03)


def test_the_map_at_the_end_is_honest():
    """Mean NEES of the landmarks, 3 degrees of freedom, over eight streets: also of the far ones."""
    means = []
    for seed in range(8):
        drive = simulate.street_loop(seed, frames=60, visible=12)
        start = consistency.initial_pose(drive, consistency.FilterConfig(Noise(), ERROR), seed)
        final = smoother.final_map(drive, Noise(), ERROR, world_T_imu=start)
        error = (drive.true_landmarks - final.landmarks)[final.seen]
        means.append(metrics.nees(error, final.covariance[final.seen]).mean())
    low, high = metrics.chi2_band(3, 8, 0.999)
    assert low < np.mean(means) < high


def test_the_explorer_steps_through_it(small):
    part = small.slice(0, 8)
    explorer = Explorer(window_slam.run(part, Noise(), ERROR), part)
    history = explorer.histories[0]
    assert history.rows[0] == list(ERROR.landmark_rows)
    last = history.snapshots[-1]
    np.linalg.cholesky(last.landmark_covariance)
    assert np.nanmax(np.abs(history["NIS / landmark"].values)) < 20
