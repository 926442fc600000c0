"""The picture of chapter 06, read back from their artists and held against runs of the filter made here."""

import dataclasses

import numpy as np
import picture_checks
import pytest
from matplotlib.path import Path
from scipy.stats import chi2

from vislam_edu import metrics, simulate, window_slam
from vislam_edu.course.ch06 import panel as tuning
from vislam_edu.course.ch06.panel import TuningPicture
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import consistency
from vislam_edu.widgets import Panel
from vislam_edu.widgets.canvas import Decades

NOISE = Noise()
REPORT = {"sigma_v": 0.1, "sigma_omega": 0.00316, "sigma_px": 15**0.5, "report_birth": True}
RADIUS2 = chi2.ppf(0.95, 2)


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=0, frames=60, visible=12, loop_length=250)


@pytest.fixture(scope="module")
def start(drive):
    return consistency.initial_pose(drive, consistency.FilterConfig(NOISE, RightPerturbation()), seed=0)


@pytest.fixture(scope="module")
def tuned(drive, start):
    return TuningPicture(drive, start)


@pytest.fixture(scope="module")
def pictures(tuned):
    """The picture with the states in which it is looked at; all sliders at both ends."""
    start = tuned.start
    ends = [start | {name: end} for name, control in tuned.controls.items() if isinstance(control, Decades)
            for end in (control.low, control.high)]
    return [(tuned, [start, start | REPORT, start | {"invariant": True}, *ends])]


# --- both ---


@pytest.mark.parametrize("check", picture_checks.ALL, ids=lambda check: check.__name__)
def test_what_every_picture_must_stand(check, pictures):
    for picture, states in pictures:
        check(picture, states)


# --- tuning ---


@pytest.mark.parametrize("invariant", [False, True])
@pytest.mark.parametrize("report_birth", [False, True])
def test_a_setting_is_the_run_of_the_filter_it_stands_for(tuned, drive, start, invariant, report_birth):
    noise = Noise(0.2, 0.1, 1.5, 4 * NOISE.initial_pose_covariance)
    error_state = RightInvariant() if invariant else RightPerturbation()
    process_frame = window_slam.as_report if report_birth else window_slam.correlated
    steps = list(window_slam.run(drive, noise, error_state, process_frame=process_frame, gate=1, world_T_imu=start))
    poses = np.array([step.posterior.world_T_imu for step in steps])
    claimed = np.array([step.posterior.pose_covariance for step in steps])

    run = tuned.outcome(
        sigma_v=0.2, sigma_omega=0.1, sigma_px=1.5, start=2.0, report_birth=report_birth, invariant=invariant
    )

    np.testing.assert_allclose(run.world_T_imu, poses)
    nees = metrics.pose_nees(error_state, drive.true_world_T_imu, poses, claimed).pose
    np.testing.assert_allclose(run.nees, nees, rtol=1e-9)
    np.testing.assert_allclose(run.measurement_nis, metrics.average_nis(steps))
    # The error that is shown is one of the body frame whatever the filter's own: position errors agree in length.
    np.testing.assert_allclose(
        np.linalg.norm(run.error[:, :3], axis=1), metrics.position_errors(drive.true_world_T_imu, poses), rtol=1e-2
    )


def test_the_panels_hold_error_and_three_sigma_of_the_setting(tuned):
    tuned.draw(**tuned.start | REPORT)
    run = tuned.outcome(**REPORT)
    (left, *left_edges), (heading, *heading_edges) = tuned.errors
    np.testing.assert_array_equal(left.get_ydata(), run.error[:, 1])
    np.testing.assert_array_equal(heading.get_ydata(), np.degrees(run.error[:, 5]))
    for edges, sigma in ((left_edges, run.sigma[:, 1]), (heading_edges, np.degrees(run.sigma[:, 5]))):
        np.testing.assert_allclose([edge.get_ydata() for edge in edges], [3 * sigma, -3 * sigma])
        assert [edge.get_linestyle() for edge in edges] == ["--", "--"]
    np.testing.assert_array_equal(tuned.nees[0].get_ydata(), run.nees)
    for line in (left, heading, *left_edges, *heading_edges):
        assert np.abs(line.get_ydata()).max() <= line.axes.get_ylim()[1]


def test_enlarged_ellipse_holds_the_truth_just_when_the_true_one_does(tuned, drive):
    verdicts = set()
    for state in ({}, REPORT, {"invariant": True}, {"start": 30.0}):
        tuned.draw(**tuned.start | state)
        run = tuned.outcome(**state)
        shown = np.linspace(0, drive.n_frames - 1, tuning.ELLIPSES).astype(int)
        for k, path in zip(shown, tuned.ellipses.get_paths()):
            off = drive.true_world_T_imu[k, :2, 3] - run.world_T_imu[k, :2, 3]
            inside = off @ np.linalg.solve(run.ground[k], off) < RADIUS2
            assert Path(path.vertices).contains_point(drive.true_world_T_imu[k, :2, 3]) == inside
            verdicts.add(bool(inside))
    assert verdicts == {True, False}


def test_true_noise_and_the_invariant_error_pass_what_the_report_fails(tuned):
    """The lesson of the chapter, with room for one drive's luck: a single run's 99.9 % band."""
    low, high = metrics.chi2_band(6, probability=0.999)
    assert low < tuned.outcome(invariant=True).nees.mean() < high
    assert tuned.outcome(**REPORT).nees.mean() > 5 * high
    assert 3.5 < tuned.outcome(invariant=True).measurement_nis < 4.5
    assert tuned.outcome(sigma_px=7.0).measurement_nis < 1.5


def test_each_setting_is_run_once(tuned, monkeypatch):
    first = tuned.outcome(**REPORT)
    monkeypatch.setattr(window_slam, "run", None)
    assert tuned.outcome(**tuned.start | REPORT) is first


def test_a_drive_without_truth_is_refused(drive):
    blind = dataclasses.replace(drive, truth_world_T_cam=None, truth_landmarks=None)
    with pytest.raises(ValueError, match="against the truth"):
        TuningPicture(blind, np.eye(4))


def test_decades_become_a_logarithmic_slider(tuned):
    panel = Panel(tuned)
    slider = panel.controls["sigma_omega"]
    assert slider.spec["kind"] == "decades"
    before = panel.image.value
    slider.value = 0.5
    assert panel.state["sigma_omega"] == 0.5
    assert panel.image.value != before
    slider.value = 1e9  # beyond the scale: its upper end
    assert slider.value == pytest.approx(tuned.controls["sigma_omega"].high)


def test_a_logarithmic_scale_cannot_hold_zero():
    with pytest.raises(ValueError, match="cannot begin at 0"):
        Decades("sigma", 0.0, 0.0, 1.0, 0.1)
