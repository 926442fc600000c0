"""The record of a run: what it keeps of the steps, and where it ends."""

import numpy as np
import pytest

from vislam_edu import metrics, simulate, window_slam
from vislam_edu.error_state import RightInvariant, RightPerturbation, right_pose_covariance
from vislam_edu.noise import Noise
from vislam_edu.studies.runs import attempt, record


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=2, frames=10, visible=6)


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()], ids=lambda e: e.role)
def test_a_run_holds_what_the_steps_said(drive, error_state):
    steps = list(window_slam.run(drive, Noise(), error_state, gate=0.5))
    run, true = record(steps, error_state), drive.true_world_T_imu
    beliefs = [step.posterior for step in steps]
    covariances = np.array([belief.pose_covariance for belief in beliefs])
    np.testing.assert_array_equal(run.world_T_imu, [belief.world_T_imu for belief in beliefs])
    np.testing.assert_allclose(run.right_covariance, [right_pose_covariance(b, error_state) for b in beliefs])
    nees = metrics.pose_nees(error_state, true, run.world_T_imu, covariances)
    np.testing.assert_array_equal(run.nees(true), nees.pose)
    for k, step in enumerate(steps):
        seen, here = step.innovation, run.frame == k
        for name in ("ids", "residual", "nis", "accepted"):
            np.testing.assert_array_equal(getattr(run, name)[here], getattr(seen, name))
    assert run.mean_nis == metrics.average_nis(steps)
    assert np.isnan(run.frame_nis[0])
    assert 0 < run.used < 1
    assert run.stopped is None


def test_a_run_that_fails_ends_before_that_frame(drive):
    def failing():
        for step in window_slam.run(drive, Noise()):
            if step.k == 4:
                raise np.linalg.LinAlgError("no covariance")
            yield step

    run = attempt(failing())
    assert run.stopped == len(run.world_T_imu) == len(run.frame_nis) == 4
    with pytest.raises(np.linalg.LinAlgError, match="no covariance"):
        record(failing())
    assert attempt([]).stopped is None


def test_nees_is_infinite_where_a_covariance_is_none(drive):
    run = record(window_slam.run(drive, Noise()))
    run.covariance[3] *= -1
    nees = run.nees(drive.true_world_T_imu)
    assert nees[3] == np.inf
    assert np.isfinite(np.delete(nees, 3)).all()
