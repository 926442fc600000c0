"""Simulated samples of a real IMU: integrated they give the path back, and noise and biases are those asked for."""

import numpy as np
import pytest

from vislam_edu import imu, se3, simulate

QUIET = imu.ImuNoise(0.0, 0.0, 0.0, 0.0)


def test_perfect_samples_lead_along_the_path():
    drive, velocity, _ = simulate.inertial_loop(1, frames=120, noise=QUIET, biases=np.zeros(6), sigma_px=0.0)
    world_T_imu = drive.truth_world_T_cam @ drive.camera.cam_T_imu
    state = imu.State(world_T_imu[0, :3, :3], world_T_imu[0, :3, 3], velocity[0], np.zeros(3), np.zeros(3))
    motion = imu.preintegrate(*drive.imu.between(drive.times[0], drive.times[-1]), np.zeros(3), np.zeros(3))
    end = imu.predict(state, motion)
    assert np.abs(se3.so3_log(world_T_imu[-1, :3, :3].T @ end.rotation)).max() < 1e-9
    assert np.abs(end.velocity - velocity[-1]).max() < 1e-9
    assert np.abs(end.position - world_T_imu[-1, :3, 3]).max() < 0.005  # of about 100 m: samples last 5 ms


def test_at_rest_an_accelerometer_shows_gravity():
    drive, velocity, _ = simulate.inertial_loop(1, frames=40, noise=QUIET, biases=np.zeros(6))
    still = drive.imu.times < 1.9
    assert np.allclose(np.linalg.norm(drive.imu.accelerometer[still], axis=1), 9.81, atol=1e-3)
    assert np.abs(drive.imu.gyro[still]).max() < 1e-3
    assert np.abs(velocity[-1]).max() > 1.0


def test_noise_and_bias_are_those_asked_for():
    """20,000 samples: a standard deviation is known to half a per cent, that of the walk by its 20,000 steps too."""
    noise = imu.ImuNoise(1e-3, 1e-2, 1e-4, 1e-3)
    times = np.arange(20_001) * 0.005
    poses = np.broadcast_to(np.eye(4), (11, 4, 4))
    path = simulate.SmoothPath(np.linspace(0, times[-1], 11), poses)
    samples, biases = simulate.measure(path, times, noise, seed=3, biases=np.full(6, 0.2))
    white = np.hstack([samples.gyro, samples.accelerometer - [0, 0, 9.81]])[:-1] - biases[:-1]
    expected = np.sqrt(noise.covariance(0.005).diagonal())
    assert white.std(axis=0) == pytest.approx(expected[:6], rel=0.02)
    assert np.diff(biases, axis=0).std(axis=0) == pytest.approx(expected[6:], rel=0.02)
    assert np.array_equal(biases[0], np.full(6, 0.2))


def test_cameras_along_any_path():
    """A road's own drive comes back from its poses and times alone."""
    road = simulate.perfect_street_loop(4, frames=60)
    again = simulate.along(road.truth_world_T_cam @ road.camera.cam_T_imu, road.times, 4)
    assert np.abs(again.pixels - road.pixels).max() < 1e-6
    assert np.array_equal(again.landmark, road.landmark)
