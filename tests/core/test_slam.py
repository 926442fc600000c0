"""The joint filter against a plain reference, against itself with nothing dropped, and under stress."""

import itertools

import numpy as np
import pytest
import reference
from scipy.linalg import expm

from vislam_edu import blockwise, ekf_slam, se3, simulate, window_slam
from vislam_edu.course.ch10 import broken_filters
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise

NOISE = Noise()
BOTH = [RightPerturbation(), RightInvariant()]


@pytest.fixture(scope="module")
def small():
    """60 frames, few landmarks in view, some of them outliers: small enough for the slow filters."""
    return simulate.street_loop(seed=3, frames=60, visible=10, outlier_share=0.1)


def agree(drive, frame, plain_frame, min_disparity):
    """The fast and the plain filter, every number of every frame; returns how many measurements the gate kept out."""
    rejected = 0
    for step, plain in zip(window_slam.run(drive, NOISE, process_frame=frame, min_disparity=min_disparity),
                           ekf_slam.run(drive, NOISE, plain_frame, min_disparity=min_disparity), strict=True):
        a, b = step.posterior, plain.posterior
        rows = np.array([list(b.ids).index(i) for i in a.ids], dtype=int)
        index = np.concatenate([(3 * rows[:, None] + np.arange(3)).ravel(), np.arange(-6, 0)])
        np.testing.assert_allclose(a.world_T_imu, b.world_T_imu, atol=1e-9)
        np.testing.assert_allclose(a.landmarks, b.landmarks[rows], atol=1e-9)
        np.testing.assert_allclose(a.covariance, b.covariance[np.ix_(index, index)], atol=1e-9)
        np.testing.assert_array_equal(step.innovation.accepted, plain.innovation.accepted)
        np.testing.assert_allclose(step.innovation.nis, plain.innovation.nis, rtol=1e-6)
        np.testing.assert_array_equal(step.born, plain.born)
        rejected += (~step.innovation.accepted).sum()
    return rejected


BOTH_WAYS = pytest.mark.parametrize(("frame", "plain_frame"), [(window_slam.correlated, ekf_slam.correlated),
                                                               (window_slam.as_report, ekf_slam.as_report)])


@BOTH_WAYS
def test_agrees_with_the_plain_filter_over_all_frames(small, frame, plain_frame):
    assert agree(small, frame, plain_frame, 1.0) > 0, "the gate was never at work, so this says nothing about it"


@BOTH_WAYS
def test_agrees_with_the_plain_filter_where_landmarks_are_single_and_wait(small, frame, plain_frame):
    """Frames with one known landmark, frames with one new one, and landmarks that are too far when first seen."""
    few, least = small.subsample(3), 12.0
    steps = list(ekf_slam.run(few, NOISE, plain_frame, min_disparity=least))
    assert 1 in [len(step.innovation.ids) for step in steps]
    assert 1 in [len(step.born) for step in steps]
    waited = [i for step in steps for i in step.born if step.k > few.first_seen[i]]
    assert waited, "no landmark waited for a better view"
    for i in waited:
        k = few.first_seen[i]
        pixels = few.observed(k)[1][few.observed(k)[0] == i][0]
        assert pixels[0] - pixels[2] <= least
    agree(few, frame, plain_frame, least)


def test_a_run_goes_on_from_one_of_its_steps_and_starts_where_it_is_put(small):
    there = se3.exp(np.array([3.0, -2.0, 1.0, 0.1, -0.2, 0.3]))
    steps = list(window_slam.run(small, NOISE, world_T_imu=there))
    np.testing.assert_array_equal(steps[0].prior.world_T_imu, there)
    rest = list(window_slam.run(small, NOISE, world_T_imu=there, after=steps[20]))
    assert [step.k for step in rest] == list(range(21, small.n_frames))
    np.testing.assert_array_equal(rest[-1].posterior.covariance, steps[-1].posterior.covariance)


def test_the_order_of_the_measurements_does_not_matter(small):
    """Also when everything in the window is measured: blocks of H must follow the ids, not their position."""
    step = list(window_slam.run(small, NOISE))[30]
    settings = window_slam.UpdateSettings(small.camera, NOISE, RightPerturbation(), np.inf, 1.0)
    ids, pixels = step.innovation.ids, step.innovation.measured
    assert len(ids) == len(step.prior.ids) > 3
    shuffled = np.random.default_rng(0).permutation(len(ids))
    sorted_, _ = window_slam.update(step.prior, ids, pixels, settings)
    mixed, _ = window_slam.update(step.prior, ids[shuffled], pixels[shuffled], settings)
    np.testing.assert_allclose(mixed.world_T_imu, sorted_.world_T_imu, atol=1e-12)
    np.testing.assert_allclose(mixed.covariance, sorted_.covariance, atol=1e-12)


def test_chunks_give_what_one_update_gives(monkeypatch):
    """Seven chunks of five against all measurements at once, from the plain Kalman update."""
    drive = simulate.street_loop(seed=2, frames=12, visible=60)
    step = list(window_slam.run(drive, NOISE))[-1]
    settings = window_slam.UpdateSettings(drive.camera, NOISE, RightPerturbation(), np.inf, 1.0)
    ids, pixels = step.innovation.ids, step.innovation.measured
    monkeypatch.setattr(blockwise, "CHUNK", 5)
    posterior, _ = window_slam.update(step.prior, ids, pixels, settings)
    plain, _ = ekf_slam.update(step.prior, ids, pixels, drive.camera, NOISE, np.inf)
    assert len(ids) > 25
    np.testing.assert_allclose(posterior.world_T_imu, plain.world_T_imu, atol=1e-10)
    np.testing.assert_allclose(posterior.landmarks, plain.landmarks, atol=1e-9)
    np.testing.assert_allclose(posterior.covariance, plain.covariance, atol=1e-10)


@pytest.mark.parametrize("error_state", BOTH)
@pytest.mark.parametrize("process_frame", [window_slam.correlated, window_slam.as_report])
def test_window_equals_the_filter_that_keeps_everything(small, error_state, process_frame):
    window = window_slam.run(small, NOISE, error_state, process_frame=process_frame)
    dense = window_slam.run(small, NOISE, error_state, process_frame=process_frame, retire=window_slam.retire_none)
    retired = 0
    for a, b in zip(window, dense, strict=True):
        np.testing.assert_allclose(a.posterior.world_T_imu, b.posterior.world_T_imu, atol=1e-9)
        rows = np.searchsorted(b.posterior.ids, a.posterior.ids)
        index = np.concatenate([(3 * rows[:, None] + np.arange(3)).ravel(), np.arange(-6, 0)])
        np.testing.assert_allclose(a.posterior.landmarks, b.posterior.landmarks[rows], atol=1e-9)
        np.testing.assert_allclose(a.posterior.covariance, b.posterior.covariance[np.ix_(index, index)], atol=1e-9)
        retired += len(a.retired)
    assert retired > 20
    assert len(b.posterior.ids) > len(a.posterior.ids)


@pytest.mark.parametrize("error_state", BOTH)
def test_covariance_stays_symmetric_positive_definite_on_a_long_drive(error_state):
    drive = simulate.street_loop(seed=5, frames=1200, visible=25, outlier_share=0.05)
    for step in window_slam.run(drive, NOISE, error_state):
        if step.k % 20 == 0:
            P = step.posterior.covariance
            np.testing.assert_array_equal(P, P.T)
            np.linalg.cholesky(P)


def test_a_step_is_immutable_and_tells_who_came_and_went(small):
    alive = set()
    for step in window_slam.run(small, NOISE):
        ids, _ = small.observed(step.k)
        assert set(step.retired) == alive - set(ids)
        assert set(step.born) == set(step.posterior.ids) - alive
        assert set(step.innovation.ids) == alive & set(ids)
        alive = set(step.posterior.ids)
        assert alive <= set(ids)
        with pytest.raises(ValueError, match="read-only"):
            step.posterior.covariance[0, 0] = 1.0
        with pytest.raises(AttributeError):
            step.k = 3


def test_update_shrinks_and_prediction_grows(small):
    steps = list(window_slam.run(small, NOISE))
    for before, after in itertools.pairwise(steps):
        grown = after.prior.pose_covariance - without_noise(before, small)
        assert np.linalg.eigvalsh(grown).min() > 0  # noise is added in every direction
        known = np.isin(after.posterior.ids, after.prior.ids)
        index = np.concatenate([np.flatnonzero(np.repeat(known, 3)), np.arange(-6, 0)])
        shrunk = after.prior.covariance - after.posterior.covariance[np.ix_(index, index)]
        assert np.linalg.eigvalsh(shrunk).min() > -1e-9


def without_noise(step, drive):
    """F Sigma F^T with F from expm: the pose covariance one frame later if the IMU were perfect."""
    k = step.k
    F = expm(-drive.taus[k] * reference.curly(drive.step_twists[k]))
    return F @ step.posterior.pose_covariance @ F.T


def test_newborn_landmarks_are_correlated_with_the_pose_and_used_once(small):
    step = next(window_slam.run(small, NOISE))
    belief = step.posterior
    assert len(step.innovation.ids) == 0
    assert len(belief.ids) > 5
    cross = belief.covariance[:3 * len(belief.ids), belief.pose]
    assert np.abs(cross).max() > 1e-4
    report = next(window_slam.run(small, NOISE, process_frame=window_slam.as_report))
    assert len(report.innovation.ids) == len(report.posterior.ids) == len(belief.ids)
    assert not report.prior.covariance[:-6, -6:].any()


def test_joint_filter_beats_dead_reckoning_tenfold_on_the_embedded_drive():
    from vislam_edu import odometry, recordings

    drive = recordings.load("street_loop")
    truth = drive.true_world_T_imu[:, :3, 3]
    estimate = np.array([s.posterior.world_T_imu[:3, 3] for s in window_slam.run(drive, NOISE)])
    reckoned = odometry.dead_reckon(drive, NOISE).world_T_imu[:, :3, 3]

    def rmse(p):
        return np.sqrt(np.mean(np.sum((p - truth) ** 2, axis=1)))

    assert rmse(estimate) < rmse(reckoned) / 10


def test_cross_covariances_matter():
    """What notebook 05's switch drops. Over seeds: without them the filter is far surer than it is right."""
    def nees(process_frame, seed):
        drive = simulate.street_loop(seed=seed, frames=80, visible=15)
        values = []
        for step in window_slam.run(drive, NOISE, process_frame=process_frame):
            e = RightPerturbation().pose_difference(drive.true_world_T_imu[step.k], step.posterior.world_T_imu)
            values.append(e @ np.linalg.solve(step.posterior.pose_covariance, e))
        return np.mean(values)

    blind = [nees(broken_filters.without_cross_covariance, s) for s in range(6)]
    whole = [nees(window_slam.correlated, s) for s in range(6)]
    assert np.mean(blind) > 2 * np.mean(whole)


def test_without_cross_covariance_leaves_no_cross_covariance(small):
    for step in window_slam.run(small.slice(0, 10), NOISE, process_frame=broken_filters.without_cross_covariance):
        P = step.posterior.covariance
        n = len(step.posterior.ids)
        blocks = P[:3 * n, :3 * n].reshape(n, 3, n, 3)
        off = blocks.copy()
        off[np.arange(n), :, np.arange(n), :] = 0
        assert not off.any()
        assert not P[:3 * n, 3 * n:].any()
        np.linalg.cholesky(P)


@pytest.mark.parametrize("bad", [{"gate": 0.0}, {"gate": 1.5}, {"min_disparity": -1.0}, {"min_disparity": np.nan}])
def test_bad_options_are_named(small, bad):
    with pytest.raises(ValueError, match=r"gate|min_disparity"):
        next(window_slam.run(small, NOISE, **bad))


def test_a_drive_without_any_landmark_is_dead_reckoning(small):
    from vislam_edu import odometry

    blind = small.keep_observations(np.zeros(len(small.pixels), dtype=bool))
    last = list(window_slam.run(blind, NOISE))[-1]
    reckoned = odometry.dead_reckon(blind, NOISE)
    np.testing.assert_allclose(last.posterior.world_T_imu, reckoned.world_T_imu[-1], atol=1e-12)
    np.testing.assert_allclose(last.posterior.covariance, reckoned.covariance[-1], rtol=1e-9)


def test_a_retraction_undoes_a_difference():
    """Both error states: retract(estimate, true - estimate) is the truth, for large errors too."""
    from vislam_edu import se3

    rng = np.random.default_rng(0)
    for error_state in (RightPerturbation(), RightInvariant()):
        for size in (1e-3, 0.3, 1.5):
            T, true_T = (se3.exp(rng.normal(size=6)) for _ in range(2))
            true_T = se3.exp(size * rng.normal(size=6)) @ T
            m = rng.normal(size=(5, 3)) * 10
            true_m = m + size * rng.normal(size=(5, 3))
            delta = np.concatenate([error_state.landmark_difference(true_T, T, true_m, m).ravel(),
                                    error_state.pose_difference(true_T, T)])
            got_T, got_m = error_state.retract(T, m, delta)
            np.testing.assert_allclose(got_T, true_T, atol=1e-10)
            np.testing.assert_allclose(got_m, true_m, atol=1e-10)
