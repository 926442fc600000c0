"""Metrics: against the evo library, against the KITTI devkit told line by line, and on known answers."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from scipy.stats import chi2

from vislam_edu import metrics, se3
from vislam_edu.error_state import RightInvariant, RightPerturbation


@pytest.fixture
def trajectories():
    """A true drive of 400 m with turns and hills, and an estimate that drifts, in a world of its own."""
    rng = np.random.default_rng(3)
    true, estimated = [np.eye(4)], [se3.exp(rng.normal(size=6))]
    for k in range(399):
        twist = np.array([1.0, 0, 0, 0, 0.01 * np.sin(k / 7), 0.02 + 0.01 * np.sin(k / 30)])
        true.append(true[-1] @ se3.exp(twist))
        noise = rng.normal(size=6) * np.repeat([2e-2, 2e-3], 3)
        estimated.append(estimated[-1] @ se3.exp(twist + noise))
    return np.array(true), np.array(estimated)


def evo_ape(true, estimated):
    true, estimated = PosePath3D(poses_se3=list(true)), PosePath3D(poses_se3=list(estimated))
    estimated.align(true, correct_scale=False)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((true, estimated))
    return ape.get_statistic(evo_metrics.StatisticsType.rmse)


def test_ate_agrees_with_evo(trajectories):
    assert metrics.ate(*trajectories) == pytest.approx(evo_ape(*trajectories), abs=1e-9)


def test_align_undoes_a_rigid_motion_and_is_never_a_reflection(trajectories):
    true, _ = trajectories
    T = se3.exp(np.array([3.0, -2, 1, 0.5, 2.0, -1.0]))
    np.testing.assert_allclose(metrics.align(true, T @ true), se3.inverse(T), atol=1e-9)
    mirrored = true.copy()
    mirrored[:, 1, 3] *= -1
    assert np.linalg.det(metrics.align(true, mirrored)[:3, :3]) == pytest.approx(1)


def kitti_devkit(true, estimated, lengths):
    """evaluate_odometry.cpp: trajectoryDistances, lastFrameFromSegmentLength, calcSequenceErrors."""
    distance = [0.0]
    for before, after in itertools.pairwise(true):
        distance.append(distance[-1] + np.linalg.norm(after[:3, 3] - before[:3, 3]))
    t_errors, r_errors = [], []
    for first in range(0, len(true), 10):
        for length in lengths:
            last = next((i for i in range(first, len(true)) if distance[i] > distance[first] + length), None)
            if last is None:
                continue
            true_delta = np.linalg.inv(true[first]) @ true[last]
            delta = np.linalg.inv(estimated[first]) @ estimated[last]
            error = np.linalg.inv(delta) @ true_delta
            t_errors.append(np.linalg.norm(error[:3, 3]) / length)
            r_errors.append(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)) / length)
    return 100 * np.mean(t_errors), np.degrees(np.mean(r_errors))


@pytest.mark.parametrize("lengths", [metrics.KITTI_LENGTHS, (5, 17.5)])
def test_kitti_drift_is_that_of_the_devkit(trajectories, lengths):
    assert metrics.kitti_drift(*trajectories, lengths=lengths) == pytest.approx(
        kitti_devkit(*trajectories, lengths), rel=1e-6)


def test_kitti_drift_of_a_scale_error_is_that_scale():
    true = np.tile(np.eye(4), (301, 1, 1))
    true[:, 0, 3] = np.arange(301.0)
    estimated = true.copy()
    estimated[:, 0, 3] *= 1.02
    percent, deg_per_m = metrics.kitti_drift(true, estimated)
    # A piece ends at the first frame past its length, 101 m for 100 m and 201 m for 200 m.
    pieces = np.array([1.01] * 20 + [1.005] * 10)
    assert (percent, deg_per_m) == pytest.approx((2 * pieces.mean(), 0))


def test_kitti_drift_of_a_short_drive_is_nan_until_shorter_lengths_are_given(trajectories):
    true, estimated = (poses[:80] for poses in trajectories)
    assert np.isnan(metrics.kitti_drift(true, estimated)).all()
    assert np.isfinite(metrics.kitti_drift(true, estimated, lengths=(10, 20))).all()


def test_frames_without_truth_are_left_out(trajectories):
    true, estimated = trajectories
    gap = true.copy()
    gap[:50] = gap[200:220] = np.nan
    known = np.isfinite(gap[:, 0, 0])
    assert metrics.ate(gap, estimated) == metrics.ate(true[known], estimated[known])
    assert len(metrics.position_errors(gap, estimated)) == known.sum()


@pytest.mark.parametrize("metric", [metrics.ate, metrics.kitti_drift, metrics.align])
def test_bad_trajectories_are_named(trajectories, metric):
    true, estimated = trajectories
    with pytest.raises(ValueError, match="400 true poses but 399 estimated"):
        metric(true, estimated[1:])
    with pytest.raises(ValueError, match=r"estimated poses must have shape \(T, 4, 4\), got \(400, 3, 4\)"):
        metric(true, estimated[:, :3])
    with pytest.raises(ValueError, match="no frame has a true pose"):
        metric(np.full_like(true, np.nan), estimated)
    broken = estimated.copy()
    broken[7, 0, 3] = np.nan
    with pytest.raises(ValueError, match="frame 7 is not finite"):
        metric(true, broken)


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()], ids=lambda e: e.name)
def test_pose_nees_of_errors_drawn_from_the_covariance_is_chi_square(error_state):
    """The truth is drawn here by each error's definition, so a NEES in the other's coordinates would fail."""
    rng = np.random.default_rng(11)
    runs = 4000
    A = rng.normal(size=(6, 6)) * 0.05
    P = A @ A.T + 1e-4 * np.eye(6)
    T = se3.exp(np.array([20.0, -10, 3, 0.3, -0.4, 2.0]))
    drawn = se3.exp(rng.multivariate_normal(np.zeros(6), P, size=runs))
    true = T @ drawn if error_state.name == "right perturbation" else drawn @ T
    nees = metrics.pose_nees(error_state, true, T, P)
    for value, dof in [(nees.pose, 6), (nees.rotation, 3), (nees.position, 3)]:
        low, high = metrics.chi2_band(dof, runs)
        assert low < value.mean() < high


def test_pose_nees_is_nan_without_truth():
    true = np.stack([np.eye(4), np.full((4, 4), np.nan)])
    nees = metrics.pose_nees(RightPerturbation(), true, np.eye(4), np.eye(6))
    assert nees.pose[0] == 0
    assert np.isnan([nees.pose[1], nees.rotation[1], nees.position[1]]).all()


@pytest.mark.parametrize(("dof", "runs"), [(6, 1), (3, 50)])
def test_chi2_band_holds_its_share(dof, runs):
    low, high = metrics.chi2_band(dof, runs, probability=0.9)
    means = np.random.default_rng(5).chisquare(dof, size=(20_000, runs)).mean(axis=1)
    # 0.006 is four standard deviations of a share of 0.05 among 20 000.
    assert np.mean(means < low) == pytest.approx(0.05, abs=0.006)
    assert np.mean(means > high) == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize(("arguments", "message"), [((6, 0), "runs"), ((6, 1, 1.0), "probability")])
def test_chi2_band_rejects_nonsense(arguments, message):
    with pytest.raises(ValueError, match=message):
        metrics.chi2_band(*arguments)


def step_with(*nis):
    return SimpleNamespace(innovation=SimpleNamespace(nis=np.array(nis)))


def test_average_nis_is_over_measurements_not_frames_and_leaves_out_points_behind_the_camera():
    steps = [step_with(2.0, 3.0, 100.0), step_with(), step_with(np.inf), step_with(7.0)]
    assert metrics.average_nis(iter(steps)) == 28
    assert np.isnan(metrics.average_nis([step_with()]))
    assert np.isnan(metrics.average_nis([]))


def test_coverage_is_the_share_inside_the_ellipsoid():
    """20 000 draws: 95 % within four standard errors; with a covariance four times too small, P(chi2_3 < 7.81 / 4)."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(3, 3))
    P = A @ A.T + np.eye(3)
    error = rng.multivariate_normal(np.zeros(3), P, 20_000)
    assert metrics.coverage(error, P) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 20_000))
    small = chi2.cdf(chi2.ppf(0.95, 3) / 4, 3)
    assert metrics.coverage(error, P / 4) == pytest.approx(small, abs=4 * np.sqrt(small * (1 - small) / 20_000))
