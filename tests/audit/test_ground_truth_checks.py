"""Each mistake that is met in files of ground truth is named with what undoes it; right ones are left in peace."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vislam_edu import cli, recordings, se3, simulate
from vislam_edu.audit.ground_truth_checks import doubt
from vislam_edu.recordings.extrinsics import REGULAR_T_OPTICAL

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
needs_recordings = pytest.mark.skipif(not SHARED.is_dir(), reason="the course's recordings are not here")


def _w_first(poses):
    read = poses.copy()  # [w, x, y, z] read as [x, y, z, w]
    read[:, :3, :3] = Rotation.from_quat(Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]).as_matrix()
    return read


def _with(poses, *, positions=1.0, rotations=None):
    poses = poses.copy()
    poses[:, :3, 3] *= positions
    if rotations is not None:
        poses[:, :3, :3] = rotations
    return poses


def _shifted(poses, by):
    return np.full_like(poses, np.nan) if not by else np.concatenate([poses[by:], np.full((by, 4, 4), np.nan)])


MISTAKES = {
    "w first": (lambda W, c: _w_first(W), "w first in its quaternions: put it last"),
    "IMU": (lambda W, c: W @ c.cam_T_imu, "poses of the IMU: multiply each by imu_T_cam from the right"),
    "regular": (lambda W, c: W @ se3.inverse(REGULAR_T_OPTICAL), "x forward, y left, z up: multiply each"),
    "inverse": (lambda W, c: se3.inverse(W), "inverse poses, cam_T_world: invert each"),
    "millimetres": (lambda W, c: _with(W, positions=1000), "positions in millimetres: divide them by 1000"),
    "scaled": (lambda W, c: _with(W, positions=1.7), r"positions 1\.\d+ times too long: divide them by 1\.\d"),
    "unit rotations": (lambda W, c: _with(W, rotations=np.eye(3)), "one rotation for all poses: only its positions"),
    "early": (lambda W, c: _shifted(W, 5), r"frame k belongs to frame k\+5: move it by \+5"),
    "late": (lambda W, c: _shifted(W[::-1], 3)[::-1], "frame k belongs to frame k-3: move it by -3"),
    "one row missing": (lambda W, c: np.concatenate([W[:20], _shifted(W[20:], 1)]),
                        "lacks the row of frame 20, .*: insert that row"),
    "of another drive": (lambda W, c: se3.exp(np.cumsum(np.full((len(W), 6), 0.3), axis=0)),
                         "moves neither as the cameras nor as the IMU say"),
}


@pytest.mark.parametrize("name", ["first_steps", "street_loop"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_with_what_undoes_it(mistake, name):
    drive, (make, said) = recordings.load(name), MISTAKES[mistake]
    wrong = drive.replace(truth_world_T_cam=make(drive.truth_world_T_cam, drive.camera))
    text = doubt(wrong)
    assert text is not None
    assert re.search(said, text), text
    assert "drift and NEES are not meaningful" in text


def test_the_w_of_a_rectified_left_camera_is_put_last_too():
    """The mistake is in the poses of the camera as mounted."""
    drive = recordings.load("street_loop")
    left_T_cam = se3.pose(se3.so3_exp([0.02, -0.1, 0.03]), np.zeros(3))
    mounted = drive.truth_world_T_cam @ se3.inverse(left_T_cam)
    drive = drive.replace(left_T_cam=left_T_cam)
    assert doubt(drive) is None
    assert "w first" in doubt(drive.replace(truth_world_T_cam=_w_first(mounted) @ left_T_cam))


@pytest.mark.parametrize("seed", range(6))
def test_right_truth_is_left_in_peace(seed):
    assert doubt(simulate.street_loop(seed=seed, frames=150, gyro_bias=(0.005, -0.005, 0.005))) is None


def test_truth_with_a_gap_or_none_is_left_in_peace():
    drive = recordings.load("first_steps")
    poses = drive.truth_world_T_cam.copy()
    poses[20:35] = np.nan
    assert doubt(drive.replace(truth_world_T_cam=poses)) is None
    assert doubt(drive.replace(truth_world_T_cam=None, truth_landmarks=None)) is None
    for unknown in (slice(10, None), slice(None, -10), slice(None, None, 2), slice(1, None)):
        poses = drive.truth_world_T_cam.copy()
        poses[unknown] = np.nan
        assert doubt(drive.replace(truth_world_T_cam=poses)) is None
    assert doubt(drive.slice(0, 1)) is None
    assert doubt(drive.slice(0, 2)) is None


def test_truth_that_fits_the_imu_is_believed_when_the_cameras_are_wrong():
    """Tracks made on images of half the size: motions of the cameras are wrong, the truth is not."""
    drive = recordings.load("street_loop")
    assert doubt(drive.replace(pixels=drive.pixels / 2)) is None


@needs_recordings
def test_real_truth_is_left_in_peace():
    drive = recordings.load_ground_truth(SHARED / "0027_ground_truth.txt", recordings.load(SHARED / "0027.npz"))
    assert doubt(drive) is None
    for name in ("regular", "optical_same_K"):
        drive = recordings.load(SHARED / "course_2025" / f"{name}.npy")
        truth = SHARED / "course_2025" / f"{name}_truth_of_left_camera.txt"
        assert doubt(recordings.load_ground_truth(truth, drive)) is None


def test_the_command_line_warns(tmp_path, capsys):
    drive = recordings.load("first_steps")
    recordings.save_kitti(tmp_path / "right.txt", drive.truth_world_T_cam)
    recordings.save_kitti(tmp_path / "inverse.txt", se3.inverse(drive.truth_world_T_cam))
    assert cli.main(["info", "first_steps", "--ground-truth", str(tmp_path / "right.txt")]) == 0
    assert not capsys.readouterr().err
    assert cli.main(["info", "first_steps", "--ground-truth", str(tmp_path / "inverse.txt")]) == 0
    assert "inverse.txt: the ground truth holds inverse poses" in capsys.readouterr().err
    assert cli.main(["run", "first_steps", "--ground-truth", str(tmp_path / "inverse.txt"), "--quiet", "--out",
                     str(tmp_path / "out")]) == 0
    warning = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"][0]
    assert "holds inverse poses, cam_T_world: invert each" in warning


# Reading


@pytest.mark.parametrize("columns", [8, 17], ids=["TUM-VI", "EuRoC"])
def test_csv_of_euroc_and_tum_vi_holds_poses_of_the_imu(tmp_path, columns):
    drive = recordings.load("first_steps")
    drive = drive.replace(times=1403715273.0 + drive.times)
    world_T_imu = drive.true_world_T_imu
    q = Rotation.from_matrix(world_T_imu[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    rest = np.zeros((len(q), columns - 8))
    lines = [",".join([str(round(t * 1e9)), *map(repr, map(float, row))]) for t, row in
             zip(drive.times, np.hstack([world_T_imu[:, :3, 3], q, rest]))]
    path = tmp_path / "data.csv"
    path.write_text("\ufeff#timestamp [ns], p_RS_R_x [m], ...\n" + "\n".join(lines) + "\n", encoding="utf-8")
    again = recordings.load_ground_truth(path, drive)
    assert again.true_world_T_imu == pytest.approx(world_T_imu, abs=1e-9)


def test_a_byte_order_mark_is_no_reason_to_refuse_a_file(tmp_path):
    drive = recordings.load("first_steps")
    recordings.save_tum(tmp_path / "truth.txt", drive.times, drive.truth_world_T_cam)
    (tmp_path / "truth.txt").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "truth.txt").read_bytes())
    again = recordings.load_ground_truth(tmp_path / "truth.txt", drive)
    assert again.truth_world_T_cam == pytest.approx(drive.truth_world_T_cam, abs=1e-9)
