"""The command line: what it writes, what it says to bad input, and what it leaves when it is stopped."""

import json
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

from vislam_edu import cli, recordings
from vislam_edu.cli import outputs
from vislam_edu.cli.run import prepare
from vislam_edu.error_state import InverseDepth
from vislam_edu.noise import Noise
from vislam_edu.plots import report_figures
from vislam_edu.recordings import files as recorded
from vislam_edu.simulate import faults, street_loop
from vislam_edu.studies import pipeline, run_warnings

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
KEYS = ["frames", "duration_s", "landmarks", "landmarks_used", "measurements", "rejected_share", "filter_s",
        "real_time_factor", "metre", "end_sigma_m_without_calibration_error", "recommended"]
SENTENCES = ["changed", "warnings"]
TRUTH_KEYS = ["position_rmse_m", "ate_m", "dead_reckoning_position_rmse_m", "dead_reckoning_ate_m",
              "drift_percent", "drift_deg_per_m", "nees_pose", "inside_3_sigma"]
FILES = sorted([*(f"{layout}/{path}.txt" for layout in ("kitti", "tum") for path in ("trajectory", "dead_reckoning")),
                "result.npz", "summary.json",
                *(f"{name}.png" for name in report_figures.FIGURES)])


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def shared(name):
    path = SHARED / name
    missing = pytest.mark.skipif(not path.exists(), reason=f"{path} is not on this machine")
    return pytest.param(path, marks=missing)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "small.npz"
    recordings.save(street_loop(seed=5, frames=130, visible=20), path)
    return path


@pytest.fixture(scope="module")
def out(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "new" / "folder"
    assert cli.main(["run", str(recording), "--out", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture
def no_figures(monkeypatch):
    """For tests of what the filter did: drawing takes several times as long as filtering."""
    monkeypatch.setattr(report_figures, "FIGURES", {})


# --- run --------------------------------------------------------------------------------------------------


def test_run_writes_everything_and_nothing_else(out):
    assert files(out) == FILES
    for name in report_figures.FIGURES:
        png = (out / f"{name}.png").read_bytes()
        assert png.startswith(b"\x89PNG")
        assert b"Software" not in png


def test_summary_has_its_keys_and_says_what_the_filter_did(out, recording):
    summary = json.loads((out / "summary.json").read_text())
    assert sorted(summary) == sorted(KEYS + TRUTH_KEYS + SENTENCES)
    drive = recordings.load(recording)
    result = pipeline.run_pipeline(drive, Noise(), InverseDepth())
    assert summary["frames"] == 130
    assert summary["landmarks"] == drive.n_landmarks
    assert summary["landmarks_used"] == result.slam.map.seen.sum()
    assert summary["measurements"] == result.slam.measurements
    assert summary["rejected_share"] == result.slam.rejected_share
    assert summary["real_time_factor"] == pytest.approx(drive.duration / summary["filter_s"])
    apart = result.slam.trajectory.world_T_imu[:, :3, 3] - drive.true_world_T_imu[:, :3, 3]
    assert summary["position_rmse_m"] == pytest.approx(np.sqrt((apart**2).sum(axis=1).mean()))
    assert summary["drift_percent"] > 0  # 130 m: one of KITTI's lengths fits


def test_trajectories_are_camera_poses_that_other_programs_read(out, recording):
    drive = recordings.load(recording)
    kitti = file_interface.read_kitti_poses_file(out / "kitti" / "trajectory.txt")
    tum = file_interface.read_tum_trajectory_file(out / "tum" / "trajectory.txt")
    np.testing.assert_allclose(kitti.poses_se3[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(np.array(tum.poses_se3), np.array(kitti.poses_se3), atol=1e-8)
    np.testing.assert_allclose(tum.timestamps, drive.times, atol=1e-9)
    truth = PoseTrajectory3D(poses_se3=list(drive.truth_world_T_cam), timestamps=drive.times)
    tum.align(truth)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((truth, tum))
    summary = json.loads((out / "summary.json").read_text())
    assert ape.get_statistic(evo_metrics.StatisticsType.rmse) == pytest.approx(summary["ate_m"], rel=1e-6)
    # Written trajectories are ground truth that the package reads back: a camera in front of the turning IMU.
    again = recordings.load_ground_truth(out / "kitti" / "trajectory.txt", drive)
    with np.load(out / "result.npz", allow_pickle=False) as result:
        np.testing.assert_allclose(again.true_world_T_imu, result["world_T_imu"], atol=1e-6)


def test_result_holds_poses_and_landmarks_with_covariances(out, recording):
    drive = recordings.load(recording)
    with np.load(out / "result.npz", allow_pickle=False) as result:
        n = len(result["landmark_ids"])
        assert n == json.loads((out / "summary.json").read_text())["landmarks_used"]
        assert result["landmarks"].shape == (n, 3)
        assert (np.linalg.eigvalsh(result["landmark_covariance"]) > 0).all()
        assert (np.linalg.eigvalsh(result["pose_covariance"]) > 0).all()
        assert result["world_T_imu"].shape == result["dead_reckoning_world_T_imu"].shape == (130, 4, 4)
        error = np.linalg.norm(result["landmarks"] - drive.true_landmarks[result["landmark_ids"]], axis=1)
    assert np.median(error) < 1.0  # m; rows of other landmarks would be tens of metres away


def test_run_as_a_program_with_a_progress_bar_and_a_printed_summary(recording, tmp_path):
    done = subprocess.run([sys.executable, "-m", "vislam_edu", "run", recording, "--out", tmp_path / "out"],
                          capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert done.returncode == 0
    assert "130/130" in done.stderr
    for key in KEYS + TRUTH_KEYS:
        assert key in done.stdout
    assert files(tmp_path / "out") == FILES


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("options", [
    ["--error-state", "invariant"],
    ["--error-state", "right"],
    ["--initialisation", "as-report"],
    ["--report-noise"],
    ["--sigma-px", "2"],
    ["--sigma-v", "0.1"],
    ["--sigma-omega", "0.01"],
    ["--gate", "0.5"],
    ["--min-disparity", "12", "--error-state", "cartesian"],
    ["--every", "3"],
], ids=lambda o: " ".join(o))
def test_every_option_reaches_the_filter(options, out, recording, tmp_path):
    assert cli.main(["run", str(recording), "--out", str(tmp_path), "--quiet", *options]) == 0
    with np.load(out / "result.npz") as plain, np.load(tmp_path / "result.npz") as changed:
        assert not np.array_equal(plain["world_T_imu"], changed["world_T_imu"])


def test_report_noise_is_the_reports_unless_a_value_is_given():
    words = ["run", "--out", "x", "--report-noise", "--sigma-px", "1"]
    _, noise, *_ = prepare(cli.parser(words).parse_args(words))
    assert (noise.sigma_v, noise.sigma_omega, noise.sigma_px) == (
        Noise.from_report().sigma_v, Noise.from_report().sigma_omega, 1)


def test_batch_without_noise_of_the_imu_is_refused_before_the_filter_runs(recording, tmp_path, capsys):
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "out"), "--batch", "--sigma-v", "0"]) == 2
    assert "sigma_v 0 m/s" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_batch_adds_its_figure_and_its_numbers_and_nothing_else(out, recording, tmp_path):
    assert cli.main(["run", str(recording), "--out", str(tmp_path), "--quiet", "--batch"]) == 0
    assert set(files(tmp_path)) - set(files(out)) == {"fig8_batch.png"}
    with_batch, without = (json.loads((folder / "summary.json").read_text()) for folder in (tmp_path, out))
    assert set(with_batch) - set(without) == {
        "batch_s", "batch_iterations", "batch_position_rmse_m", "batch_ate_m", "batch_drift_percent", "batch"}
    assert with_batch["batch"]["converged"]
    assert set(with_batch["batch"]) == {"cost_per_dof", "converged", "end_sigma_m", "nees_pose", "inside_3_sigma"}
    assert with_batch["batch_position_rmse_m"] < with_batch["dead_reckoning_position_rmse_m"]


def test_quiet_says_nothing(recording, tmp_path, capfd):
    assert cli.main(["run", str(recording), "--out", str(tmp_path), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("no_figures")
def test_street_loop_is_the_default_and_slam_beats_dead_reckoning_tenfold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # found beside the package, not in the working directory
    assert cli.main(["run", "--out", "out", "--quiet"]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames"] == 500
    assert summary["position_rmse_m"] < summary["dead_reckoning_position_rmse_m"] / 10
    assert summary["ate_m"] < summary["dead_reckoning_ate_m"] / 10


@pytest.mark.parametrize("path", [shared("03.npz")])
def test_real_recording_without_truth(path, tmp_path):
    assert cli.main(["run", str(path), "--out", str(tmp_path), "--quiet", "--every", "20"]) == 0
    assert files(tmp_path) == FILES
    assert sorted(json.loads((tmp_path / "summary.json").read_text())) == sorted(KEYS + SENTENCES)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("path", [shared("0027.npz")])
def test_real_recording_whose_truth_ends_early(path, tmp_path):
    truth = SHARED / "0027_ground_truth.txt"
    assert cli.main(["run", str(path), "--ground-truth", str(truth), "--out", str(tmp_path), "--quiet",
                     "--every", "20"]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert sorted(summary) == sorted(KEYS + TRUTH_KEYS + SENTENCES)
    # With the sample k+1 dead reckoning has an ATE of 16 m on this drive; here it is the sample k.
    assert 10 < summary["dead_reckoning_ate_m"] < 25


def test_drive_too_short_for_kitti_drift_gets_null_which_is_valid_json(recording, tmp_path):
    recordings.save(recordings.load(recording).slice(0, 1), tmp_path / "one.npz")
    assert cli.main(["run", str(tmp_path / "one.npz"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    text = (tmp_path / "out" / "summary.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["drift_percent"] is None


def test_truth_that_starts_late_is_told_in_the_frame_of_its_first_pose(recording):
    drive = recordings.load(recording)
    truth = drive.truth_world_T_cam.copy()
    truth[:40] = np.nan
    late = drive.replace(truth_world_T_cam=truth)
    result = pipeline.run_pipeline(late, Noise())
    assert outputs.summary(result)["position_rmse_m"] < 1.0  # m; 40 m away without the change of frame


# --- stopped ----------------------------------------------------------------------------------------------


def stop(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.parametrize("where", ["studies.pipeline.run_pipeline", "cli.outputs.recordings.save_tum",
                                   "cli.outputs.np.savez_compressed"])
def test_interrupted_run_leaves_things_as_they_were(where, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(f"vislam_edu.{where}", stop)
    new, old = tmp_path / "new", tmp_path / "old"
    old.mkdir()
    (old / "summary.json").write_text("from before")
    for folder in (new, old):
        assert cli.main(["run", str(recording), "--out", str(folder), "--quiet"]) == 130
        assert capsys.readouterr().err == "interrupted; nothing was written\n"
    assert not new.exists()
    assert files(old) == ["summary.json"]
    assert (old / "summary.json").read_text() == "from before"


def listen_to_ctrl_c():
    """A test run in the background has inherited a shell's "ignore Ctrl-C"; a program started by hand has not."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)])
def test_a_signal_stops_the_program(number, tmp_path):
    recordings.save(street_loop(seed=6, frames=500), tmp_path / "long.npz")
    process = subprocess.Popen(
        [sys.executable, "-m", "vislam_edu", "run", "long.npz", "--out", "out"], cwd=tmp_path,
        stderr=subprocess.PIPE, text=True, preexec_fn=listen_to_ctrl_c if os.name == "posix" else None)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("out/.run.part-*")):  # it works from here on, for seconds
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.endswith("interrupted; nothing was written\n")
    assert os.listdir(tmp_path) == ["long.npz"]


@pytest.mark.skipif(os.name != "posix", reason="there is no SIGHUP")
def test_under_nohup_the_end_of_the_terminal_is_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with cli._terminable():
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) not in (signal.SIG_DFL, signal.SIG_IGN)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_while_the_scratch_folder_is_made_leaves_nothing(tmp_path, monkeypatch):
    make = Path.mkdir

    def interrupted(path, *arguments, **options):
        make(path, *arguments, **options)
        if ".run.part-" in path.name:
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", interrupted)
    with pytest.raises(KeyboardInterrupt), outputs.appearing_in(tmp_path / "new" / "folder"):
        pass
    assert not list(tmp_path.iterdir())


def test_what_an_earlier_run_left_and_this_one_does_not_write_goes(tmp_path):
    for name in (*outputs.SOMETIMES, "summary.json", "mine.png"):
        (tmp_path / name).write_text("from before")
    with outputs.appearing_in(tmp_path) as part:
        (part / "summary.json").write_text("new")
        (part / "lens.json").write_text("new")
    assert files(tmp_path) == ["lens.json", "mine.png", "summary.json"]
    assert (tmp_path / "lens.json").read_text() == "new"


def test_covariances_are_written_symmetric(recording, tmp_path, no_figures):
    options = ["--batch", "--error-state", "inverse-depth", "--sigma-px", "5"]
    assert cli.main(["run", str(recording), *options, "--out", str(tmp_path), "--quiet"]) == 0
    with np.load(tmp_path / "result.npz") as result:
        found = {name: result[name] for name in result if "covariance" in name}
    assert len(found) == 3
    for name, covariance in found.items():
        np.testing.assert_array_equal(covariance, covariance.mT, err_msg=name)


@pytest.mark.parametrize("words", [
    ["audit", "a.npz", "--cured", "a.npz"], ["audit", "a.npz", "--cured", "sub/../a.npz"],
    ["audit", "a", "--cured", "a.npz"],
    ["track", "images", "--calibration", "a.npz", "--imu", "b.npz", "--out", "a.npz"],
    ["run", "result.npz", "--out", "."]], ids=" ".join)
def test_a_recording_is_not_written_over(words, recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    for name in ("a.npz", "b.npz", "result.npz"):
        (tmp_path / name).write_bytes(recording.read_bytes())
    assert cli.main(words) == 2
    assert "would be written over" in capsys.readouterr().err
    assert all((tmp_path / name).read_bytes() == recording.read_bytes() for name in ("a.npz", "result.npz"))


@pytest.mark.skipif(os.name != "posix", reason="a shell closes stderr")
@pytest.mark.parametrize("words", ["run a.npz --out out", "consistency --seeds 1 --frames 10 --out out",
                                   "exercises --report a.ipynb --out out"])
def test_a_closed_stderr_stops_nothing(words, tmp_path):
    recordings.save(recordings.load("first_steps").slice(0, 10), tmp_path / "a.npz")
    (tmp_path / "a.ipynb").write_text('{"cells": [], "metadata": {}, "nbformat": 4, "nbformat_minor": 5}')
    command = f"exec {sys.executable} -m vislam_edu {words} 2>&-"
    ended = subprocess.run(["/bin/sh", "-c", command], cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=False)
    assert (ended.returncode, ended.stdout.count("unforeseen")) == (0, 0)
    assert list((tmp_path / "out").iterdir())


def test_a_target_that_cannot_be_replaced_leaves_everything_as_it_was(tmp_path):
    (tmp_path / "summary.json").write_text("from before")
    (tmp_path / "tum").write_text("no folder")
    def write():
        with outputs.appearing_in(tmp_path) as part:
            (part / "summary.json").write_text("new")
            (part / "tum").mkdir()

    with pytest.raises(OSError, match="is in the way of a new folder"):
        write()
    assert files(tmp_path) == ["summary.json", "tum"]
    assert (tmp_path / "summary.json").read_text() == "from before"


@pytest.mark.skipif(os.name != "posix", reason="where processes cannot be asked for, nothing is removed")
def test_what_a_killed_run_left_is_removed_by_the_next_and_nothing_else(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    stale, living, foreign = (recorded.part_of(tmp_path, "run").with_name(name) for name in (
        f".run.part-{platform.node()}-{ended.pid}", f".run.part-{platform.node()}-{os.getppid()}", ".run.part-other-1"))
    for path in (stale, living, foreign):
        path.mkdir()
        (path / "half").touch()
    (tmp_path / f".a.npz.part-{platform.node()}-{ended.pid}").touch()
    with outputs.appearing_in(tmp_path), recorded.replacing(tmp_path / "a.npz"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([living.name, foreign.name, "a.npz"])


def test_ctrl_c_during_an_import_is_one_line(monkeypatch, capsys):
    def interrupted(*_):
        try:
            stop()
        except KeyboardInterrupt:
            raise ImportError("numpy was not loaded") from None  # what a package may make of it

    for import_module in (stop, interrupted):
        monkeypatch.setattr("vislam_edu.cli.import_module", import_module)
        assert cli.main(["exercises", "--museum"]) == 130
        assert capsys.readouterr().err == "interrupted; nothing was written\n"


def test_stopped_simulation_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("vislam_edu.recordings.layouts.np.savez_compressed", stop)
    assert cli.main(["simulate", "--out", str(tmp_path / "a.npz"), "--frames", "20"]) == 130
    assert files(tmp_path) == []


# --- bad input --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bad_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    (folder / "text.npz").write_text("no arrays here")
    (folder / "rows.txt").write_text("1 2 3\n")
    np.savez(folder / "empty.npz")
    street = street_loop(seed=1, frames=20)
    recordings.save(street, folder / "good.npz")
    with np.load(folder / "good.npz") as fields:
        values = dict(fields)
    values["twists"] = values["twists"].copy()
    values["twists"][3, 2] = np.nan
    np.savez(folder / "nan.npz", **values)
    (folder / "cut.npz").write_bytes((folder / "good.npz").read_bytes()[:2000])
    return folder


@pytest.mark.parametrize(("arguments", "said"), [
    (["run", "nowhere.npz", "--out", "out"], "nowhere.npz: no such file"),
    (["info", "nowhere"], "nowhere: no such file"),
    (["run", ".", "--out", "out"], "directory"),
    (["run", "text.npz", "--out", "out"], "text.npz"),
    (["run", "cut.npz", "--out", "out"], "cut.npz"),
    (["info", "empty.npz"], "empty.npz"),
    (["run", "nan.npz", "--out", "out"], "twists: nan at index (3, 2)"),
    (["run", "good.npz", "--ground-truth", "rows.txt", "--out", "out"], "rows.txt"),
    (["run", "good.npz", "--ground-truth", "none.txt", "--out", "out"], "none.txt: no such file"),
    (["run", "good.npz", "--out", "rows.txt"], "rows.txt: is a file, expected a folder"),
    (["run", "good.npz", "--out", "rows.txt/below"], "rows.txt"),
    (["run", "good.npz"], "--out"),
    (["run", "good.npz", "--out", "out", "--gate", "1.5"], "--gate: 1.5 is not a number above 0 and at most"),
    (["run", "good.npz", "--out", "out", "--gate", "0"], "--gate: 0 is not a number above 0"),
    (["run", "good.npz", "--out", "out", "--sigma-px", "0"], "--sigma-px: 0 is not a number above 0"),
    (["run", "good.npz", "--out", "out", "--sigma-v", "-1"], "--sigma-v"),
    (["run", "good.npz", "--out", "out", "--sigma-omega", "nan"], "nan is not a finite number"),
    (["run", "good.npz", "--out", "out", "--sigma-omega", "inf"], "inf is not a finite number"),
    (["run", "good.npz", "--out", "out", "--sigma-v", "fast"], "--sigma-v: invalid number value: 'fast'"),
    (["run", "good.npz", "--out", "out", "--min-disparity", "-1"], "--min-disparity"),
    (["run", "good.npz", "--out", "out", "--every", "0"], "--every: 0 is not a whole number of at least 1"),
    (["run", "good.npz", "--out", "out", "--every", "1.5"], "--every: invalid whole number value"),
    (["run", "good.npz", "--out", "out", "--error-state", "left"], "--error-state: invalid choice: 'left'"),
    (["run", "good.npz", "--out", "out", "--error-state", "inverse-depth", "--initialisation", "as-report"],
     "as-report gives a landmark 2 m^2 per axis"),
    (["simulate", "--out", "a.npz", "--frames", "3"], "frames"),
    (["simulate", "--out", "a.npz", "--outlier-share", "2"], "--outlier-share"),
    (["simulate", "--out", "a.npz", "--gyro-bias", "nan", "0", "0"], "--gyro-bias"),
    (["simulate", "--out", "a.txt"], "ends in .npz"),
    (["simulate", "--out", "rows.txt/a.npz"], "rows.txt"),
    (["fly"], "fly"),
    ([], "COMMAND"),
], ids=lambda value: " ".join(value) if isinstance(value, list) else "")
def test_bad_input_is_one_line_and_status_2(arguments, said, bad_files, monkeypatch, capsys):
    monkeypatch.chdir(bad_files)
    before = sorted(bad_files.rglob("*"))
    try:
        status = cli.main(arguments)
    except SystemExit as stopped:  # argparse leaves this way
        status = stopped.code
    assert status == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert said in captured.err
    assert sorted(bad_files.rglob("*")) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission(recording, tmp_path, capsys):
    (tmp_path / "closed").mkdir(mode=0o500)
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "closed"), "--quiet"]) == 2
    assert "Permission denied" in capsys.readouterr().err


def test_disk_error_while_writing_is_named(recording, tmp_path, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "result.npz")

    monkeypatch.setattr("vislam_edu.cli.outputs.np.savez_compressed", full)
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert capsys.readouterr().err == "vislam_edu: result.npz: No space left on device\n"
    assert not (tmp_path / "out").exists()


def test_filter_that_breaks_down_is_one_line(recording, tmp_path, monkeypatch, capsys):
    def broken(*_, **__):
        raise np.linalg.LinAlgError("17-th leading minor not positive definite")

    monkeypatch.setattr("vislam_edu.studies.pipeline.run_pipeline", broken)
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "the filter broke down (17-th leading minor not positive definite), neither a gap nor" in said
    assert said.count("\n") == 1


@pytest.fixture(scope="module")
def gap(recording, tmp_path_factory):
    drive = recordings.load(recording)
    path = tmp_path_factory.mktemp("gap") / "gap.npz"
    recordings.save(drive.replace(times=drive.times + 1e6 * (np.arange(drive.n_frames) > 30)), path)
    return path


@pytest.mark.parametrize(("options", "reason"), [
    (["--sigma-v", "1e8"], "because the assumed noise is huge: sigma_v is 1e+08"),
    (["--sigma-px", "1e-6"], "because the assumed noise is tiny: sigma_px is 1e-06; assume more"),
    (["--sigma-px", "1e-8", "--initialisation", "as-report"], "because the assumed noise is tiny: sigma_px is 1e-08"),
    (["gap"], "because of the gap of 1e+06 s after frame 30: use the part before (--to 31) or after")], ids=" ".join)
def test_a_filter_that_breaks_down_says_what_is_likely(options, reason, recording, gap, tmp_path, capsys):
    path, options = (gap, []) if options == ["gap"] else (recording, options)
    assert cli.main(["run", str(path), "--out", str(tmp_path / "out"), "--quiet", *options]) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_indefinite_covariance_is_found_in_every_estimate(recording):
    result = pipeline.run_pipeline(recordings.load(recording).slice(0, 20), Noise())
    assert run_warnings.unusable(result) == []

    def spoiled(covariance, value):
        changed = covariance.copy()
        changed[-1] = -value * np.eye(len(changed[-1]))
        return changed

    for value in (1e-9, np.nan):
        walk, path, found = result.dead_reckoning, result.slam.trajectory, result.slam.map
        mapped = result.mapped.map
        assert run_warnings.unusable(replace(result, dead_reckoning=replace(
            walk, covariance=spoiled(walk.covariance, value)))) == ["dead reckoning"]
        assert run_warnings.unusable(replace(result, slam=replace(result.slam, trajectory=replace(
            path, covariance=spoiled(path.covariance, value))))) == ["the path"]
        for name, change in (("the map", lambda new: replace(result, slam=replace(result.slam, map=new))),
                             ("the map on the poses of dead reckoning",
                              lambda new: replace(result, mapped=replace(result.mapped, map=new)))):
            old = found if name == "the map" else mapped
            covariance = old.covariance.copy()
            covariance[np.flatnonzero(old.seen)[-1]] = -value * np.eye(3)
            assert run_warnings.unusable(change(replace(old, covariance=covariance))) == [name]


# --- the other commands -----------------------------------------------------------------------------------


def test_info_tells_what_is_in_a_recording(recording, capsys):
    drive = recordings.load(recording)
    assert cli.main(["info", str(recording)]) == 0
    text = capsys.readouterr().out
    for fact in ("130 in 12.9", f"{drive.n_landmarks}, in view", f"{len(drive.pixels)}, ", "baseline 0.54",
                 "poses of 130 frames, landmarks"):
        assert fact in text


def test_simulate_is_street_loop(tmp_path, capsys):
    path = tmp_path / "sub" / "a.npz"
    assert cli.main(["simulate", "--out", str(path), "--seed", "7", "--frames", "40", "--sigma-px", "0.3",
                     "--gyro-bias", "0", "0", "-0.01"]) == 0
    drive = street_loop(seed=7, frames=40, sigma_px=0.3, gyro_bias=(0, 0, -0.01))
    loaded = recordings.load(path)
    np.testing.assert_array_equal(loaded.twists, drive.twists)
    np.testing.assert_array_equal(loaded.pixels, drive.pixels)


@pytest.mark.parametrize("arguments", [[], *([name] for name in cli.COMMANDS)], ids=str)
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main([*arguments, "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    wanted = cli.COMMANDS if not arguments else [f"usage: python -m vislam_edu {arguments[0]}"]
    assert all(word in text for word in wanted)


# --- run --audit ------------------------------------------------------------------------------------------


def faulty(path):
    """A drive whose IMU is late and has a bias, and whose axes are flipped: the audit has something to find."""
    drive = street_loop(seed=2, frames=150, visible=40, gyro_bias=(0.02, -0.015, 0.01))
    recordings.save(faults.delay_imu(faults.flip_imu_axes(drive)), path)
    return path


@pytest.mark.usefixtures("no_figures")
def test_audit_cures_what_it_names_and_says_so(tmp_path, capsys):
    path = faulty(tmp_path / "faulty.npz")
    results = {}
    for name, options in {"as it is": [], "cured": ["--audit"], "causal": ["--audit", "--causal"]}.items():
        assert cli.main(["run", str(path), "--out", str(tmp_path / name), *options]) == 0
        results[name] = json.loads((tmp_path / name / "summary.json").read_text()), capsys.readouterr().out
    planted = results["as it is"][0]["changed"]
    for name in ("cured", "causal"):
        summary, said = results[name]
        cures = summary["changed"][len(planted):]
        assert any("diag(1, -1, -1)" in cure for cure in cures)
        assert any("k+1" in cure for cure in cures)
        assert all(cure in said for cure in cures)
        assert summary["ate_m"] < results["as it is"][0]["ate_m"] / 4
    assert any("gyro bias" in cure for cure in results["cured"][0]["changed"][len(planted):])
    assert not any("gyro bias" in cure for cure in results["causal"][0]["changed"][len(planted):])


@pytest.mark.usefixtures("no_figures")
def test_calibration_widens_the_covariance_and_leaves_the_path(recording, tmp_path, out):
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "x"), "--quiet", "--calibration"]) == 0
    summary = json.loads((tmp_path / "x" / "summary.json").read_text())
    plain = json.loads((out / "summary.json").read_text())
    assert summary["nees_pose_with_calibration"] < summary["nees_pose"] == pytest.approx(plain["nees_pose"])
    assert summary["inside_3_sigma_with_calibration"] >= summary["inside_3_sigma"]
    assert summary["end_sigma_m_with_calibration_error"] > summary["end_sigma_m_without_calibration_error"]
    with np.load(tmp_path / "x" / "result.npz") as result:
        assert (np.linalg.eigvalsh(result["calibration_covariance"]) > -1e-9).all()
        assert result["calibration_covariance"].shape == result["pose_covariance"].shape


def test_audit_prints_or_gives_json(tmp_path, capsys):
    path = str(faulty(tmp_path / "faulty.npz"))
    assert cli.main(["audit", path]) == 0
    assert "IMU axes" in capsys.readouterr().out
    assert cli.main(["audit", path, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["findings"]
    assert {"IMU axes", "IMU timing"} <= {finding["fault"] for finding in found}


def test_causal_needs_audit(recording, tmp_path, capfd):
    assert cli.main(["run", str(recording), "--out", str(tmp_path / "x"), "--causal"]) == 2
    assert "--audit" in capfd.readouterr().err


@pytest.mark.usefixtures("no_figures")
def test_a_filter_that_rejects_a_lot_says_so(tmp_path, capfd):
    recordings.save(street_loop(seed=1, frames=100, visible=20, outlier_share=0.3), tmp_path / "bad.npz")
    assert cli.main(["run", str(tmp_path / "bad.npz"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert "warning: the gate kept out" in capfd.readouterr().err
    written = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert written[0].startswith("the recording was not audited; the quick part of the audit finds behind infinity")
    assert written[1].startswith("the gate kept out")


# --- the commands -----------------------------------------------------------------------------------------


def test_listing_the_commands_imports_no_filter():
    code = ("import sys; from vislam_edu.cli import parser; parser([]);"
            "print(sorted({'numpy', 'matplotlib', 'vislam_edu.window_slam'} & set(sys.modules)))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr
