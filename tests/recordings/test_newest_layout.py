"""The layout of 2025 and 2026, written in every reading that is met: the camera that comes out is the true one."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from memory import peak

from vislam_edu import cli, metrics, recordings, se3
from vislam_edu.drive import DriveError
from vislam_edu.recordings import extrinsics

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "course_2025"
TRUE = recordings.load("first_steps")
POINTS = se3.transform(se3.inverse(TRUE.true_world_T_imu[TRUE.frame]), TRUE.true_landmarks[TRUE.landmark])  # IMU frame
K_RIGHT = TRUE.camera.K * [[1.02], [1.019], [1]] + [[0, 0, 1.5], [0, 0, -3], [0, 0, 0]]
SAME, PARALLEL = np.eye(4), np.zeros((2, 3))
TURNED = np.radians([[0.4, -0.9, 0.3], [-0.2, 0.8, -0.6]])  # each camera about its centre


def cameras(turned):
    """Poses of both optical frames in the IMU frame."""
    left = TRUE.camera.imu_T_cam
    right = left @ se3.pose(np.eye(3), np.array([TRUE.camera.baseline, 0, 0]))
    return [T @ se3.pose(se3.so3_exp(phi), np.zeros(3)) for T, phi in zip((left, right), turned)]


def pinhole(K, imu_T_cam):
    q = se3.transform(se3.inverse(imu_T_cam), POINTS) @ K.T
    return q[:, :2] / q[:, 2:]


def written(path, reading, K_right=TRUE.camera.K, turned=PARALLEL, body=SAME, **changed):
    """The file of a drive without pixel noise, its cameras turned and its extrinsics written as `reading` says.

    body : the IMU's frame in that of the drive's IMU, both at one place.
    """
    pair = cameras(turned)
    features = np.full((4, TRUE.n_landmarks, TRUE.n_frames), -1.0)
    features[:2, TRUE.landmark, TRUE.frame] = pinhole(TRUE.camera.K, pair[0]).T
    features[2:, TRUE.landmark, TRUE.frame] = pinhole(K_right, pair[1]).T
    pair = [se3.inverse(body) @ T for T in pair]
    if "regular" in reading:
        pair = [T @ se3.inverse(extrinsics.REGULAR_T_OPTICAL) for T in pair]
    if reading.endswith("_T_imu"):
        pair = [se3.inverse(T) for T in pair]
    fields = {"timestamps": 1.66e9 + TRUE.times, "features": features, "v_t": TRUE.twists[:, :3] @ body[:3, :3],
              "w_t": TRUE.twists[:, 3:] @ body[:3, :3], "K_l": TRUE.camera.K, "K_r": K_right, "extL_T_imu": pair[0],
              "extR_T_imu": pair[1]} | changed
    np.save(path, fields)
    return path


def assert_sees_what_it_should(drive):
    predicted, ok = drive.camera.project(se3.transform(drive.camera.cam_T_imu, POINTS))
    assert ok.all()
    assert drive.pixels == pytest.approx(predicted, abs=1e-6)


@pytest.mark.parametrize("K_right", [TRUE.camera.K, K_RIGHT], ids=["one K", "two K"])
@pytest.mark.parametrize("turned", [PARALLEL, TURNED], ids=["parallel", "turned"])
@pytest.mark.parametrize("reading", extrinsics.READINGS)
def test_every_reading_gives_the_true_camera_and_exact_pixels(tmp_path, reading, turned, K_right):
    path = written(tmp_path / "dataset00.npy", reading, K_right, turned)
    drive = recordings.load(path)
    assert_sees_what_it_should(drive)
    assert drive.camera.baseline == pytest.approx(TRUE.camera.baseline, rel=1e-9)
    assert drive.history[0].startswith(f"extrinsics read as {reading}: the only reading")
    needed = bool(np.any(turned)) or K_right is K_RIGHT
    assert needed == any("pixels rectified" in line for line in drive.history)
    assert needed == (drive.left_T_cam is not None)
    recordings.save_tum(tmp_path / "truth.txt", TRUE.times, TRUE.true_world_T_imu @ cameras(turned)[0])
    with_truth = recordings.load_ground_truth(tmp_path / "truth.txt", drive)
    assert with_truth.true_world_T_imu == pytest.approx(TRUE.true_world_T_imu, abs=1e-6)
    recordings.save(drive, tmp_path / "own.npz")  # the truth of the left camera as mounted still fits
    again = recordings.load_ground_truth(tmp_path / "truth.txt", recordings.load(tmp_path / "own.npz"))
    assert again.true_world_T_imu == pytest.approx(TRUE.true_world_T_imu, abs=1e-6)


def test_pixels_of_parallel_cameras_stay_although_the_extrinsics_are_turned(tmp_path):
    """As in KITTI-360: the extrinsics are older than the rectification of the images."""
    turned = [se3.inverse(T) for T in cameras(TURNED)]
    drive = recordings.load(written(tmp_path / "a.npy", "optical_T_imu", extL_T_imu=turned[0], extR_T_imu=turned[1]))
    assert drive.left_T_cam is None
    assert len(drive.history) == 1


@pytest.mark.parametrize(("reading", "phi"), [("optical_T_imu", [np.pi, 0, 0]), ("imu_T_regular", [0, 0, np.pi / 2])],
                         ids=["IMU forward, right, down", "IMU turned to the side"])
def test_tracks_decide_between_readings_that_both_put_the_right_camera_right(tmp_path, reading, phi):
    body = se3.pose(se3.so3_exp(phi), np.zeros(3))
    drive = recordings.load(written(tmp_path / "a.npy", reading, body=body))
    assert drive.history[0].startswith(f"extrinsics read as {reading}: of imu_T_regular and optical_T_imu the one")
    assert drive.camera.imu_T_cam == pytest.approx(se3.inverse(body) @ TRUE.camera.imu_T_cam, abs=1e-9)


def test_a_reading_can_be_forced(tmp_path, capsys):
    path = written(tmp_path / "a.npy", "imu_T_regular")
    assert "as asked for" in recordings.load(path, extrinsics="imu_T_regular").history[0]
    with pytest.raises(DriveError, match=r"no reading puts the right camera .*optical_T_imu: \[0.0, 0"):
        recordings.load(path, extrinsics="optical_T_imu")
    with pytest.raises(DriveError, match="'x', expected one of imu_T_regular"):
        recordings.load(path, extrinsics="x")
    with pytest.raises(DriveError, match="extrinsics: can be chosen only for"):
        recordings.load("first_steps", extrinsics="imu_T_regular")
    assert cli.main(["info", str(path), "--extrinsics", "imu_T_regular", "--from", "10", "--to", "30"]) == 0
    said = capsys.readouterr().out
    assert "frames                    20 in" in said
    assert "extrinsics read as imu_T_regular: as asked for" in said


def test_swapped_cameras_are_refused(tmp_path):
    left, right = (se3.inverse(T) for T in cameras(PARALLEL))
    for swapped in (("optical_T_imu", right, left), ("imu_T_optical", *map(se3.inverse, (right, left)))):
        path = written(tmp_path / "a.npy", swapped[0], extL_T_imu=swapped[1], extR_T_imu=swapped[2])
        with pytest.raises(DriveError, match=r"extL_T_imu, extR_T_imu: .*swapped"):
            recordings.load(path)


def test_a_landmark_that_comes_back_is_another_one(tmp_path):
    longest = int(np.argmax(TRUE.last_seen - TRUE.first_seen))
    first = TRUE.first_seen[longest]
    path = written(tmp_path / "a.npy", "imu_T_regular")
    fields = np.load(path, allow_pickle=True).item()
    fields["features"][:, longest, [first + 2, first + 5]] = -1
    np.save(path, fields)
    drive = recordings.load(path)
    assert drive.n_landmarks == TRUE.n_landmarks + 2
    assert drive.last_seen[longest] == first + 1
    assert drive.first_seen[-2:].tolist() == [first + 3, first + 6]
    assert drive.last_seen[-1] == TRUE.last_seen[longest]
    assert any("2 times a landmark comes back" in line for line in drive.history)
    np.savez(tmp_path / "a.npz", **fields)  # read in pieces
    again = recordings.load(tmp_path / "a.npz")
    assert np.array_equal(again.landmark, drive.landmark)
    assert np.array_equal(again.pixels, drive.pixels)


@pytest.mark.parametrize("features", [None, [], np.full((4, 3, TRUE.n_frames), -1.0)], ids=["None", "empty", "unseen"])
def test_a_recording_of_images_only_says_what_to_do(tmp_path, features):
    path = written(tmp_path / "a.npy", "imu_T_regular", features=features)
    with pytest.raises(DriveError, match=r"a.npy: features: .*`vislam_edu track` makes tracks"):
        recordings.load(path)


def test_a_file_of_images_and_one_without_features_say_what_to_do(tmp_path):
    np.save(tmp_path / "imgs.npy", {"cam_imgs_L": [np.zeros((2, 3), np.uint8)] * 2, "cam_imgs_R": []})
    with pytest.raises(DriveError, match=r"imgs.npy: holds images, not a recording; `vislam_edu track`"):
        recordings.load(tmp_path / "imgs.npy")
    fields = np.load(written(tmp_path / "a.npy", "imu_T_regular"), allow_pickle=True).item()
    fields.pop("features")
    for path, write in ((tmp_path / "a.npy", np.save), (tmp_path / "a.npz", lambda path, d: np.savez(path, **d))):
        write(path, fields)
        with pytest.raises(DriveError, match=rf"{path.name}: features: missing, .* `vislam_edu track`"):
            recordings.load(path)


def test_a_bare_pickle_is_read(tmp_path):
    fields = np.load(written(tmp_path / "a.npy", "imu_T_regular"), allow_pickle=True).item()
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(fields))
    assert_sees_what_it_should(recordings.load(tmp_path / "a.pkl"))


def test_a_pickled_recording_needs_far_less_memory_than_its_dense_array(tmp_path):
    """One of the course's has (4, 5376, 3755) entries, 646 MB: they are read from the file a piece at a time."""
    n_landmarks, n_frames, life = 2000, 2000, 40
    features = np.full((4, n_landmarks, n_frames), -1.0)
    for i in range(n_landmarks):
        features[:, i, (first := i * (n_frames - life) // n_landmarks):first + life] = 300.0
    path = written(tmp_path / "a.npy", "imu_T_regular", K_RIGHT, TURNED, features=features, v_t=np.zeros((n_frames, 3)),
                   w_t=np.zeros((n_frames, 3)), timestamps=0.03 * np.arange(n_frames))
    del features
    assert peak(lambda: recordings.load(path, extrinsics="imu_T_regular")) < 32 * n_landmarks * n_frames / 2


@pytest.mark.parametrize("scale", [1e3, 1e9])
def test_times_in_other_units_and_in_float32(tmp_path, scale):
    with pytest.raises(DriveError, match=r"timestamps: 1.66e\+\d\d, expected seconds"):
        recordings.load(written(tmp_path / "a.npy", "imu_T_regular", timestamps=scale * (1.66e9 + TRUE.times)))
    with pytest.raises(DriveError, match=r"timestamps: do not increase; .* only to 1.3e\+02 s: store float64"):
        recordings.load(written(tmp_path / "a.npy", "imu_T_regular", timestamps=np.float32(1.66e9 + TRUE.times)))


def test_what_is_met_in_place_of_a_recording(tmp_path):
    for start, said in {b"MATLAB 5.0 MAT-file": "MATLAB file; read it with", b"\x89HDF\r\n\x1a\n": "HDF5",
                        b"version https://git-lfs.github.com/spec/v1": "git lfs pull",
                        b"\n<!DOCTYPE html>": "web page"}.items():
        (tmp_path / "a.npz").write_bytes(start + bytes(100))
        with pytest.raises(DriveError, match=said):
            recordings.load(tmp_path / "a.npz")


@pytest.mark.skipif(not SHARED.is_dir(), reason="the made files of course_2025 are not here")
@pytest.mark.parametrize(("name", "reading"), [("regular", "imu_T_regular"), ("optical_same_K", "imu_T_optical")])
def test_made_files_of_the_course_load_and_drift_little(name, reading):
    drive = recordings.load(SHARED / f"{name}.npy")
    drive = recordings.load_ground_truth(SHARED / f"{name}_truth_of_left_camera.txt", drive)
    assert drive.history[0].startswith(f"extrinsics read as {reading}")
    assert np.median(np.abs(drive.pixels[:, 1] - drive.pixels[:, 3])) < 0.55  # 0.5 px in each row
    world_T_imu = [np.eye(4)]
    for step in se3.exp(drive.step_twists * drive.taus[:, None]):
        world_T_imu.append(world_T_imu[-1] @ step)
    assert metrics.ate(drive.true_world_T_imu, np.array(world_T_imu)) < 0.03
