"""Chapter 09: its figures, and the report's second recording as a simulated drive."""

import numpy as np
import picture_checks
import pytest

from vislam_edu import recordings, simulate
from vislam_edu.course.ch09 import figures, second_recording
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.mapping import MapBelief
from vislam_edu.noise import Noise


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(frames=30, visible=12, loop_length=250)


def test_landmarks_of_window_and_dense_filter():
    figure = figures.landmarks_carried(5 + np.arange(4.0), [3, 4, 4, 3], [3, 5, 7, 9])
    dense, window = figure.axes[0].get_lines()
    np.testing.assert_array_equal(dense.get_xydata(), [[0, 3], [1, 5], [2, 7], [3, 9]])
    np.testing.assert_array_equal(window.get_ydata(), [3, 4, 4, 3])
    assert "window holds 3 landmarks, the dense filter 9" in figure.axes[0].get_title(loc="left")
    picture_checks.is_large_enough(figure)


def test_the_six_landmarks_that_shrink_most_around_their_truth():
    rng = np.random.default_rng(0)
    truth, factor = rng.normal(size=(8, 3)), np.array([0.9, 0.2, 0.3, 0.8, 0.4, 0.5, 0.6, 0.7])
    before = MapBelief(truth + 0.1, np.tile(np.eye(3), (8, 1, 1)), np.ones(8, bool))
    after = MapBelief(truth - 0.1, factor[:, None, None] ** 2 * np.eye(3), np.ones(8, bool))
    figure = figures.before_and_after(truth, before, after)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        f"landmark {j}: -{1 - factor[j]:.0%}" for j in np.argsort(factor)[:6]]
    for axes in figure.axes:
        cross, old, _, new, _ = axes.get_lines()
        np.testing.assert_allclose(cross.get_xydata(), [[0, 0]])
        np.testing.assert_allclose(old.get_xydata(), [[0.1, 0.1]])
        np.testing.assert_allclose(new.get_xydata(), [[-0.1, -0.1]])
    assert f"by {1 - np.median(factor):.0%} (median)" in figure.get_suptitle()
    picture_checks.is_large_enough(figure)


def test_a_street_stands_for_the_second_recording_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(recordings, "find", lambda name: None)
    drive = second_recording.load(frames=20)
    assert drive.n_frames == 20
    assert drive.has_truth


def test_the_recording_itself_is_taken_where_it_is(monkeypatch, drive):
    monkeypatch.setattr(recordings, "find", {"10.npz": "there"}.get)
    monkeypatch.setattr(recordings, "load", {"there": drive}.get)
    assert second_recording.load(frames=20).n_landmarks == drive.slice(0, 20).n_landmarks


def test_ten_figures_and_the_worse_path_in_the_last_three(drive):
    drawn = dict(second_recording.figures(drive, Noise(), RightInvariant()))
    assert list(drawn) == [8, 9, 10, 11, 12, 13, 14, 18, 19, 20]
    good, bad = drawn[12].axes[0].get_title(loc="left"), drawn[18].axes[0].get_title(loc="left")
    assert good != bad


def test_a_smaller_w_makes_the_report_surer_and_no_better(drive):
    assert second_recording.paths(drive, Noise(), RightPerturbation())[1].method == "slam"
    _, good = second_recording.paths(drive, Noise(), RightInvariant())
    bad, truth = second_recording.suboptimal(drive), drive.true_world_T_imu[-1, :3, 3]
    sigma = [np.sqrt(np.trace(slam.trajectory.covariance[-1, :3, :3])) for slam in (bad, good)]
    off = [np.linalg.norm(slam.trajectory.world_T_imu[-1, :3, 3] - truth) for slam in (bad, good)]
    assert sigma[0] < sigma[1]
    assert off[0] > off[1]
