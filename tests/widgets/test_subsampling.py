"""The slider over the number of landmarks: what it shows is the filter run on that many."""

import numpy as np
import picture_checks
import pytest

from vislam_edu import simulate, window_slam
from vislam_edu.course.ch09.panel import SubsamplingPicture
from vislam_edu.error_state import RightInvariant
from vislam_edu.noise import Noise
from vislam_edu.widgets import Panel

NOISE = Noise()


@pytest.fixture(scope="module")
def panel():
    return Panel(SubsamplingPicture(simulate.street_loop(seed=4, frames=60, visible=40, loop_length=400.0), NOISE))


@pytest.mark.parametrize("every", [1, 4])
def test_shows_the_filter_over_every_nth_landmark(panel, every):
    panel.controls["every"].value = every
    picture, drive = panel.picture, panel.picture.drive
    part = drive.keep_landmarks(np.arange(drive.n_landmarks) % every == 0)
    path = np.array([step.posterior.world_T_imu[:3, 3] for step in window_slam.run(part, NOISE, RightInvariant())])
    np.testing.assert_allclose(picture.path.get_xydata(), path[:, :2])
    true = drive.true_world_T_imu[:, :3, 3]
    np.testing.assert_allclose(picture.error.get_ydata(), np.linalg.norm(path - true, axis=1))
    assert len(picture.points.get_xydata()) <= part.n_landmarks
    assert str(part.n_landmarks) in panel.text.value


def test_fewer_landmarks_claim_less(panel):
    few, every_one = panel.picture.run(8), panel.picture.run(1)
    assert np.all(few.claimed[1:] > every_one.claimed[1:])


def test_each_share_is_filtered_once_and_stays_on_the_curve(panel):
    for every in (5, 1, 5):
        panel.controls["every"].value = every
    picture = panel.picture
    assert picture.run(5) is picture.run(5)
    every, rms = picture.others.get_xydata().T
    assert {1, 5} <= set(every)
    np.testing.assert_allclose(rms, [picture.run(int(e)).rms for e in every])


@pytest.mark.parametrize("check", [picture_checks.lettering_is_legible, picture_checks.can_be_said_and_shown],
                         ids=lambda check: check.__name__)
def test_what_every_picture_must_stand(check, panel):
    """But one thing: this one remembers what has been tried."""
    check(panel.picture, [{"every": every} for every in (1, 2, 10)])
