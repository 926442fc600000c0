"""What an error of the calibration does to a path, and that the considered covariance expects it."""

from dataclasses import replace

import numpy as np
import pytest

from vislam_edu import metrics, robust, se3, simulate
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.simulate import faults
from vislam_edu.studies import calibration, pipeline, scale

OPTIONS = {"motion_model": robust.RealDrive, "process_frame": robust.process_frame}


def with_baseline(drive, factor):
    """The calibration's baseline is `factor` times the true one: everything looks that much larger."""
    return drive.replace(camera=replace(drive.camera, baseline=factor * drive.camera.baseline))


@pytest.fixture(scope="module")
def street():
    return simulate.street_loop(seed=3, frames=150)


def test_a_gauge_moves_nothing_at_the_start_but_the_start(street):
    path = street.true_world_T_imu
    for gauge in calibration.GAUGES:
        way = calibration.moved(path, calibration.turned(path, gauge))
        assert (np.abs(way[0]).max() < 1e-9) == (gauge[0] != "start"), gauge
        assert np.abs(way[-1]).max() > 1e-4


def test_a_wrong_mounting_turns_the_path_as_the_gauge_does(street):
    """The cameras' own path, seen through extrinsics that are off by the gauge's B."""
    small = np.r_[np.zeros(3), 0, calibration.BORESIGHT, 0]
    imu_T_cam = se3.exp(small) @ street.camera.imu_T_cam
    other = street.replace(camera=replace(street.camera, cam_T_imu=se3.inverse(imu_T_cam)))
    expected = calibration.turned(street.true_world_T_imu, ("boresight", 1))
    np.testing.assert_allclose(other.true_world_T_imu, expected, atol=1e-9)


def test_what_is_added_is_the_sum_of_what_moved(street):
    path = street.true_world_T_imu

    def find_path(drive):
        """Moves the last pose by as much as the first pixel has moved."""
        moved = path.copy()
        moved[-1, 0, 3] += drive.pixels[0, 0] - street.pixels[0, 0]
        return moved

    added = calibration.covariance(street, path, find_path)
    gauges = [calibration.moved(path, calibration.turned(path, gauge)) for gauge in calibration.GAUGES]
    without = sum(way[-1, :, None] * way[-1, None, :] for way in gauges)
    shifts = [faults.lens_error(street, **{knob: px}).pixels[0, 0] - street.pixels[0, 0]
              for knob, px in calibration.LENS_PX.items()]
    axis = path[-1, 0, :3]  # world x in the body frame
    np.testing.assert_allclose((added[-1] - without)[:3, :3], np.sum(np.square(shifts)) * np.outer(axis, axis),
                               atol=1e-9)


def test_lens_errors_make_a_filter_too_sure_and_turning_the_knobs_cures_it():
    """The sickness of real drives, planted: hundreds for NEES where 6 is right, single figures when considered."""
    drive = simulate.street_loop(seed=3, frames=250, visible=25)
    bent = with_baseline(faults.lens_error(drive, disparity_with_u_2=-3.0, row_saddle=-3.0), 1.008)
    noise, error_state = Noise(), RightInvariant()
    slam = pipeline.joint(bent, noise, error_state, **OPTIONS)
    path, P = slam.trajectory.world_T_imu, slam.trajectory.covariance

    def mean_nees(covariance):
        return metrics.pose_nees(RightPerturbation(), drive.true_world_T_imu, path, covariance).pose.mean()

    def find_path(other):
        return pipeline.joint_path(other, noise, error_state, **OPTIONS)

    assert mean_nees(P) > 20
    assert mean_nees(P + calibration.covariance(bent, path, find_path)) < 10


# --- whose metre --------------------------------------------------------------------------------------------


def test_the_imus_metre_is_found_while_driving(street):
    noise = Noise()
    wrong = with_baseline(street, 1.02)
    slam = pipeline.joint(wrong, noise, RightInvariant(), **OPTIONS)
    g = scale.running(slam.trajectory.world_T_imu, wrong, noise.sigma_v)
    assert g[0] == 1
    assert g[-1] == pytest.approx(1 / 1.02, abs=0.008)  # 0.5 m/s a sample, 150 samples at 10 m/s: 0.004
    np.testing.assert_array_equal(  # causal: the first half knows nothing of the second
        g[:70], scale.running(slam.trajectory.world_T_imu[:70], wrong.slice(0, 70), noise.sigma_v))


def test_another_metre_scales_path_and_map_alike(street):
    slam = pipeline.joint(street, Noise(), RightInvariant(), **OPTIONS)
    twice = scale.rescaled(slam, street, np.full(street.n_frames, 2.0))
    before, after = (s.trajectory.world_T_imu[:, :3, 3] for s in (slam, twice))
    np.testing.assert_allclose(after - after[0], 2 * (before - before[0]), atol=1e-9)
    seen = slam.map.seen
    expected = 2 * (slam.map.landmarks[seen] - before[0])
    np.testing.assert_allclose(twice.map.landmarks[seen] - after[0], expected, atol=1e-9)
    assert twice.metre == 2
