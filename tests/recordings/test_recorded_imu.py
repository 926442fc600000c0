"""Recordings with an accelerometer: the package's own layout, EuRoC's text, and the real IMU in the filter."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vislam_edu import Noise, imu, inertial, recordings, se3, simulate, window_slam
from vislam_edu.drive import DriveError
from vislam_edu.error_state import InverseDepth
from vislam_edu.stereo import StereoCamera

EUROC = Path(__file__).resolve().parents[3] / "shared" / "data" / "euroc_v101" / "imu_and_truth.npz"


def test_saved_and_loaded(tmp_path):
    drive, _, _ = simulate.inertial_loop(1, frames=30, noise=imu.ImuNoise(1e-3, 2e-3, 3e-3, 4e-3))
    recordings.save(drive, tmp_path / "a.npz")
    again = recordings.load(tmp_path / "a.npz").imu
    assert again.noise == drive.imu.noise
    for name in ("times", "gyro", "accelerometer"):
        assert np.array_equal(getattr(again, name), getattr(drive.imu, name))


def test_euroc_text(tmp_path):
    drive, _, _ = simulate.inertial_loop(1, frames=30)
    path = tmp_path / "data.csv"
    path.write_text("#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n0,1,2,3,4,5,6\n5000000,3,2,3,4,5,8\n")
    samples = recordings.load_imu(path, drive).imu
    assert samples.times.tolist() == [0.0, 0.005]
    assert samples.gyro.tolist() == [[2.0, 2.0, 3.0], [3.0, 2.0, 3.0]]
    assert samples.accelerometer[0].tolist() == [4.0, 5.0, 7.0]
    path.write_text("0,1,2\n")
    with pytest.raises(DriveError, match="3 numbers a row, expected 7"):
        recordings.load_imu(path, drive)


@pytest.mark.skipif(not EUROC.exists(), reason="no EuRoC recording beside the project")
def test_the_real_imu_with_simulated_tracks():
    """40 s of EuRoC V1_01: drift at most 0.5 %, NEES of the pose at most 12, with the noise its residuals show."""
    recording = np.load(EUROC)
    times = (recording["truth_time_ns"][:800] - recording["truth_time_ns"][0]) / 1e9
    R = Rotation.from_quat(recording["world_q_imu_wxyz"][:800], scalar_first=True).as_matrix()
    poses = se3.pose(R, recording["world_p_imu"][:800])
    cam_R_imu = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # EuRoC's camera, to a degree
    camera = StereoCamera(np.array([[458.0, 0, 367], [0, 458, 248], [0, 0, 1]]), 0.11,
                          se3.pose(cam_R_imu, [0.065, -0.021, -0.008]))
    drive = simulate.add_noise(
        simulate.along(poses, times, 0, camera=camera, image_size=(752, 480), depth=(1.0, 8.0), nearest=0.5,
                       life=(5, 200), mean_life=60.0), sigma_v=0, sigma_omega=0)
    values = np.hstack([recording["gyro"], recording["accelerometer"]])
    values = (values[:-1] + values[1:]) / 2
    imu_times = (recording["imu_time_ns"][:-1] - recording["truth_time_ns"][0]) / 1e9
    drive = drive.replace(imu=inertial.ImuSamples(imu_times, values[:, :3], values[:, 3:],
                                                  imu.ImuNoise(1.5e-3, 5e-2, 1e-4, 1e-2)))
    biases = np.hstack([recording["gyro_bias"], recording["accelerometer_bias"]])[:800]
    error_state, nees = InverseDepth(), []
    for step in window_slam.run(drive, Noise(), error_state, motion_model=inertial.AccelerometerDriven):
        if step.k == 0:
            true = inertial.true_states(step.posterior.world_T_imu, poses, recording["world_v_imu"][:800], biases)
        e = inertial.error(step.posterior, true[step.k], error_state)[:6]
        nees.append(e @ np.linalg.solve(step.posterior.pose_covariance, e))
    length = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    drift = np.linalg.norm(true[-1].position - step.posterior.world_T_imu[:3, 3]) / length
    assert drift < 0.005
    assert np.mean(nees) < 12
    assert np.abs(true[-1].gyro_bias - step.posterior.motion[3:6]).max() < 0.002
