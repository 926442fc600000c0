"""`run` and `track` with a real IMU: gyro and accelerometer from EuRoC's csv, the start, and the frame of the truth."""

import json

import numpy as np
import pytest

from vislam_edu import cli, recordings, simulate
from vislam_edu.plots import report_figures


@pytest.fixture
def no_figures(monkeypatch):
    monkeypatch.setattr(report_figures, "FIGURES", {})


def recorded(folder, **options):
    """A drive as a file without its samples, and these as EuRoC's csv, whose values are those at an instant."""
    drive = simulate.inertial_loop(1, frames=80, **options)[0]
    recordings.save(drive.replace(imu=None), folder / "drive.npz")
    samples = drive.imu
    rows = np.column_stack([np.round(samples.times * 1e9), samples.gyro, samples.accelerometer])
    np.savetxt(folder / "imu.csv", rows, delimiter=",", fmt=["%d"] + 6 * ["%.12e"], header="timestamp [ns],w_x")
    files = [str(folder / name) for name in ("drive.npz", "imu.csv", "out")]
    return [files[0], "--accelerometer", files[1], "--out", files[2], "--quiet"]


def summary(folder):
    return json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("no_figures")
def test_run_filters_with_the_accelerometer_and_judges_in_the_world_of_the_estimate(tmp_path):
    arguments = recorded(tmp_path)
    assert cli.main(["run", *arguments]) == 0
    found = summary(tmp_path)
    assert found["position_rmse_m"] < 0.15
    assert found["nees_pose"] < 12
    assert found["warnings"] == []
    poses = np.load(tmp_path / "out" / "result.npz")["world_T_imu"]
    assert poses[0, 2, :3] @ [0, 0, 1] > 0.99  # z is up, however the car stands


@pytest.mark.usefixtures("no_figures")
def test_run_says_that_there_is_no_stand_still(tmp_path, capsys):
    assert cli.main(["run", *recorded(tmp_path, warp=lambda t: t + 3.0)]) == 0
    assert "does not begin at rest" in capsys.readouterr().err
    assert summary(tmp_path)["position_rmse_m"] < 0.3


def test_what_run_refuses(tmp_path, capsys):
    arguments = recorded(tmp_path)
    assert cli.main(["run", *arguments, "--audit"]) == 2
    assert "--audit judges an IMU that gives velocities" in capsys.readouterr().err
    lines = (tmp_path / "imu.csv").read_text().splitlines(keepends=True)
    other_clock = [f"-{10 - k}{line[line.index(','):]}" for k, line in enumerate(lines[1:4])]
    for wrong in (lines[:300], other_clock):
        (tmp_path / "imu.csv").write_text("".join(wrong))
        assert cli.main(["run", *arguments]) == 2
        assert "no samples between the frames" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_info_says_what_the_samples_are(tmp_path, capsys):
    recordings.save(simulate.inertial_loop(1, frames=30)[0], tmp_path / "drive.npz")
    assert cli.main(["info", str(tmp_path / "drive.npz")]) == 0
    assert "accelerometer             581 samples from 0.00 to 2.90 s" in capsys.readouterr().out
