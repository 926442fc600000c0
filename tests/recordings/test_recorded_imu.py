"""Recordings with an accelerometer: the package's own layout, EuRoC's text, and the real IMU in the filter."""

from pathlib import Path

import numpy as np
import pytest

from vislam_edu import imu, recordings, simulate
from vislam_edu.drive import DriveError
from vislam_edu.error_state import InverseDepth
from vislam_edu.recordings import shipped

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
def test_the_real_imu_with_simulated_tracks(monkeypatch):
    """20 s of EuRoC V1_01's second half, begun in flight, with the noise that residuals of its first half show.

    Over the whole half and four seeds the mean NEES of the pose is below 12, the drift below 0.5 % (stored results).
    """
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
    import real_imu

    stored = shipped.results("real_imu")["euroc"]
    noise = real_imu.noise_of(*real_imu.euroc(EUROC, slice(None, real_imu.HALF)), 2)
    assert list(vars(noise).values()) == pytest.approx(stored["noise"]["residuals of 2 s"])
    frames = slice(real_imu.HALF, real_imu.HALF + 400, 2)
    rows = real_imu.judged(*real_imu.euroc(EUROC, frames, noise=noise), InverseDepth())
    assert np.mean([row[1] for row in rows]) < 12
    assert rows[-1][2] < 0.05  # m, of 10 m
    nees, drift = np.mean(stored["runs"]["residuals of 2 s"], axis=0)
    assert nees < 12
    assert drift < 0.5
