"""Files: every published layout is read, the own one comes back bit for bit, a bad file is named."""

import io
import os
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from memory import peak
from numpy.lib import format as npy

from vislam_edu import recordings, se3
from vislam_edu.drive import DriveError

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
N_FRAMES = 6
TRACKS = {0: (0, 2), 1: (1, 4), 2: (5, 5)}


def measured():
    rng = np.random.default_rng(3)
    features = np.full((4, len(TRACKS), N_FRAMES), -1.0)
    for i, (first, last) in TRACKS.items():
        features[:, i, first:last + 1] = rng.uniform(0, 1000, (4, last + 1 - first))
    times = 1.3e9 + np.array([0, 0.1, 0.21, 0.3, 0.4, 0.5])
    return times, features, rng.normal(size=(3, N_FRAMES)), rng.normal(size=(3, N_FRAMES))


TIMES, FEATURES, LINEAR, ANGULAR = measured()
K = np.array([[550.0, 0, 680], [0, 540, 240], [0, 0, 1]])
CAM_T_IMU = se3.inverse(se3.pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([1.5, 0.1, -0.6])))
IMU_T_CAM = se3.inverse(CAM_T_IMU)
NPZ = {"time_stamps": TIMES[None], "features": FEATURES, "linear_velocity": LINEAR,
       "angular_velocity": ANGULAR, "K": K, "b": np.array(0.6), "imu_T_cam": IMU_T_CAM}
# as in KITTI-360: the cameras are parallel to about a degree only
RIGHT_T_LEFT = se3.pose(se3.so3_exp([0.002, 0.018, -0.001]), np.array([-0.6, 0.004, 0.002]))
PICKLED = {"timestamps": TIMES, "features": FEATURES, "v_t": LINEAR.T, "w_t": ANGULAR.T, "K_l": K, "K_r": K,
           "extL_T_imu": CAM_T_IMU, "extR_T_imu": RIGHT_T_LEFT @ CAM_T_IMU}


def without(fields, *keys):
    return {key: value for key, value in fields.items() if key not in keys}


def put(array, index, value):
    array = np.array(array, dtype=float)
    array[index] = value
    return array


@pytest.fixture
def npz(tmp_path):
    def write(fields):
        np.savez(tmp_path / "drive.npz", **fields)
        return tmp_path / "drive.npz"
    return write


@pytest.fixture
def npy_pickle(tmp_path):
    """Writes what `np.save` writes for an object: the header and then a pickle."""
    def write(pickled):
        data = pickled if isinstance(pickled, bytes) else pickle.dumps(np.array(pickled, object), protocol=4)
        path = tmp_path / "dataset00.npy"
        with open(path, "wb") as file:
            npy.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": ()})
            file.write(data)
        return path
    return write


def assert_is_the_measured_drive(drive):
    assert np.array_equal(drive.times, TIMES)
    assert np.array_equal(drive.twists, np.vstack([LINEAR, ANGULAR]).T)
    assert np.array_equal(np.nan_to_num(drive.features, nan=-1), FEATURES)
    assert np.array_equal(drive.camera.K, K)
    assert drive.camera.cam_T_imu == pytest.approx(CAM_T_IMU, abs=1e-12)
    assert drive.truth_world_T_cam is None


# Layouts


def test_layout_of_dataset_3(npz):
    drive = recordings.load(npz(NPZ))
    assert_is_the_measured_drive(drive)
    assert drive.camera.baseline == 0.6
    assert (drive.name, drive.source) == ("drive", "UCSD ECE276A, drive.npz")


def test_older_layout(npz):
    kept = without(NPZ, "angular_velocity", "imu_T_cam")
    path = npz(kept | {"rotational_velocity": ANGULAR, "cam_T_imu": CAM_T_IMU})
    assert_is_the_measured_drive(recordings.load(path))


@pytest.mark.parametrize("turn", [lambda a: a, np.transpose], ids=["frames first", "axes first"])
def test_newest_layout(npy_pickle, turn):
    drive = recordings.load(npy_pickle(PICKLED | {"v_t": turn(PICKLED["v_t"]), "w_t": turn(PICKLED["w_t"])}))
    assert_is_the_measured_drive(drive)
    # the right camera's position in the left camera's frame, along x
    R, p = RIGHT_T_LEFT[:3, :3], RIGHT_T_LEFT[:3, 3]
    assert drive.camera.baseline == pytest.approx((-R.T @ p)[0], abs=1e-12)
    assert drive.camera.baseline == pytest.approx(0.6, rel=1e-3)


def test_newest_layout_as_numpy_writes_it(tmp_path):
    np.save(tmp_path / "dataset00.npy", PICKLED | {"timestamps": TIMES[None], "note": np.float64(1.5)})
    assert_is_the_measured_drive(recordings.load(tmp_path / "dataset00.npy"))


def test_newest_layout_as_numpy_1_wrote_it(npy_pickle):
    written = pickle.dumps(np.array(PICKLED, dtype=object), protocol=2 + 1)
    assert b"numpy._core.multiarray" in written
    assert_is_the_measured_drive(recordings.load(npy_pickle(
        written.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n"))))


def test_extrinsics_with_seven_digits_are_made_rigid(npz):
    written = np.array([[float(f"{x:.6e}") for x in row] for row in se3.exp([1, 2, 3, 0.3, -0.8, 1.1])])
    assert np.abs(written[:3, :3] @ written[:3, :3].T - np.eye(3)).max() > 1e-8
    rotation = recordings.load(npz(NPZ | {"imu_T_cam": written})).camera.imu_T_cam[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert rotation == pytest.approx(written[:3, :3], abs=1e-6)


def test_own_layout_comes_back_bit_for_bit(tmp_path):
    drive = recordings.load_ground_truth(_kitti(tmp_path, POSES[:4]), _drive(tmp_path))
    drive = drive.replace(truth_landmarks=np.arange(9.0).reshape(3, 3) / 7, imu_sample="k+1", name="näme",
                          source="somewhere", history=("ended tracks", "flipped axes"))
    recordings.save(drive, tmp_path / "own.npz")
    again = recordings.load(tmp_path / "own.npz")
    arrays = "times", "twists", "frame_start", "landmark", "pixels", "truth_world_T_cam", "truth_landmarks"
    for field in arrays:
        was, is_now = getattr(drive, field), getattr(again, field)
        assert was.tobytes() == is_now.tobytes(), field
    for field in ("n_landmarks", "name", "source", "imu_sample", "history"):
        was, is_now = getattr(drive, field), getattr(again, field)
        assert was == is_now, field
    for field in ("K", "baseline", "cam_T_imu"):
        assert np.array_equal(getattr(again.camera, field), getattr(drive.camera, field)), field
    with np.load(tmp_path / "own.npz", allow_pickle=False) as fields:
        assert all(fields[key].dtype.kind in "fiU" for key in fields)


def test_own_layout_without_truth_and_history(tmp_path):
    recordings.save(_drive(tmp_path), tmp_path / "own.npz")
    again = recordings.load(tmp_path / "own.npz")
    assert_is_the_measured_drive(again)
    assert again.history == ()
    assert again.truth_landmarks is None


def test_a_failed_save_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    drive = _drive(tmp_path)
    path = tmp_path / "own.npz"
    recordings.save(drive, path)
    before, files = path.read_bytes(), sorted(tmp_path.iterdir())

    def half_written(file, **fields):
        file.write(b"PK")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", half_written)
    with pytest.raises(OSError, match="disk full"):
        recordings.save(drive.subsample(2), path)
    assert path.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == files


# Refusals


NAN_SAMPLE = put(LINEAR, (1, 4), np.nan)
BROKEN_NPZ = {
    "no K": (without(NPZ, "K"), "K: missing; the file has time_stamps, features"),
    "no extrinsics": (without(NPZ, "imu_T_cam"), "imu_T_cam or cam_T_imu: missing"),
    "no gyro": (without(NPZ, "angular_velocity"), "angular_velocity or rotational_velocity or w_t: missing"),
    "no features": (without(NPZ, "features"), "features: missing"),
    "nothing": ({}, "time_stamps or timestamps: missing; the file has nothing"),
    "times in a square": (NPZ | {"time_stamps": TIMES.reshape(2, 3)}, r"time_stamps: shape \(2, 3\)"),
    "times stand still": (NPZ | {"time_stamps": put(TIMES, 3, TIMES[2])}, "times: do not increase, frame 2"),
    "times nan": (NPZ | {"time_stamps": put(TIMES, 3, np.nan)}, r"times: nan at index \(3,\)"),
    "samples too few": (NPZ | {"linear_velocity": LINEAR[:, :5]}, r"linear_velocity: shape \(3, 5\)"),
    "samples nan": (NPZ | {"linear_velocity": NAN_SAMPLE}, "linear_velocity: nan in frame 4 on the y axis"),
    "features too few": (NPZ | {"features": FEATURES[:, :, :5]}, r"features: shape \(4, 3, 5\)"),
    "features flat": (NPZ | {"features": FEATURES[0]}, r"features: shape \(3, 6\)"),
    "features text": (NPZ | {"features": FEATURES.astype(str)}, "features: holds <U"),
    "features objects": (NPZ | {"features": FEATURES.astype(object)}, "features: holds Python objects"),
    "features partial": (NPZ | {"features": put(FEATURES, (2, 1, 3), -1)}, "features: landmark 1, frame 3"),
    "never seen": (NPZ | {"features": np.full_like(FEATURES, -1)}, "features: the recording is empty"),
    "no frame": (NPZ | {"time_stamps": np.empty((1, 0)), "features": np.empty((4, 3, 0)),
                        "linear_velocity": np.empty((3, 0)), "angular_velocity": np.empty((3, 0))},
                 "features: missing"),
    "K not a matrix": (NPZ | {"K": K[:2]}, "K"),
    "K transposed": (NPZ | {"K": K.T}, "K"),
    "K negative": (NPZ | {"K": put(K, (0, 0), -1)}, "K"),
    "b two": (NPZ | {"b": np.ones(2)}, r"b: shape \(2,\)"),
    "b negative": (NPZ | {"b": np.array(-0.6)}, "baseline"),
    "extrinsics shape": (NPZ | {"imu_T_cam": np.eye(3)}, r"imu_T_cam: shape \(3, 3\)"),
    "extrinsics mirror": (NPZ | {"imu_T_cam": np.diag([1.0, 1, -1, 1])}, "imu_T_cam: not a rigid motion"),
    "extrinsics scaled": (NPZ | {"imu_T_cam": np.diag([1.01, 1, 1, 1])}, "imu_T_cam: not a rigid motion"),
    "extrinsics nan": (NPZ | {"imu_T_cam": put(IMU_T_CAM, (0, 3), np.nan)}, "imu_T_cam: not a rigid motion"),
    "extrinsics transposed": (NPZ | {"imu_T_cam": IMU_T_CAM.T}, "imu_T_cam: not a rigid motion"),
    "format unknown": ({"format": "vislam_edu drive 9"}, "format: 'vislam_edu drive 9'"),
}


@pytest.mark.parametrize("case", BROKEN_NPZ)
def test_broken_npz_is_named(npz, case):
    fields, message = BROKEN_NPZ[case]
    path = npz(fields)
    with pytest.raises(DriveError, match=f"{re.escape(str(path))}: .*{message}"):
        recordings.load(path)


BROKEN_PICKLED = {
    "no K_r": (without(PICKLED, "K_r"), "K_r: missing; the file has timestamps"),
    "K_r not a matrix": (PICKLED | {"K_r": K[:2]}, "K_r: "),
    "cameras cross-eyed": (PICKLED | {"extR_T_imu": se3.exp([0, 0, 0, 0, 0.3, 0]) @ PICKLED["extR_T_imu"]},
                           "extL_T_imu, extR_T_imu: no reading puts the right camera"),
    "ragged": (PICKLED | {"v_t": [[1, 2], [3]]}, "v_t: "),
    "not a dictionary": ([1, 2], "its pickle holds a list, expected a dictionary"),
}


@pytest.mark.parametrize("case", BROKEN_PICKLED)
def test_broken_pickled_dictionary_is_named(npy_pickle, case):
    fields, message = BROKEN_PICKLED[case]
    path = npy_pickle(fields)
    with pytest.raises(DriveError, match=f"{re.escape(str(path))}: {message}"):
        recordings.load(path)


def test_what_is_no_recording_at_all(tmp_path, npz):
    whole = npz(NPZ).read_bytes()
    files = {"cut.npz": whole[:-30], "half.npz": whole[:len(whole) // 2], "text.npz": b"time x y z\n",
             "empty.npz": b"", "short.npy": b"\x93NUMPY", "header.npy": b"\x93NUMPY\x01\x00\xff\xff{"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DriveError, match=f"{name}: .*(cut short|cannot be read)"):
            recordings.load(tmp_path / name)
    np.save(tmp_path / "array.npy", FEATURES)
    with pytest.raises(DriveError, match=r"array.npy: holds an array of float64, shape \(4, 3, 6\)"):
        recordings.load(tmp_path / "array.npy")
    with pytest.raises(DriveError, match=r"missing.npz: no such file"):
        recordings.load(tmp_path / "missing.npz")
    with pytest.raises(DriveError, match="is a directory"):
        recordings.load(tmp_path)


def test_damaged_content_of_an_npz_is_named(npz):
    path = npz(NPZ)
    content = bytearray(path.read_bytes())
    start = content.index(LINEAR.tobytes())
    content[start:start + 8] = b"damaged!"
    path.write_bytes(content)
    with pytest.raises(DriveError, match=r"linear_velocity: cannot be read \(Bad CRC"):
        recordings.load(path)


# Pickles


class Call:
    """Pickles as a call of `function(*arguments)` that happens when it is unpickled."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("function", ["os.system", "builtins.eval", "builtins.open", "numpy.save"])
@pytest.mark.parametrize("place", ["alone", "in the dictionary"])
def test_a_pickle_that_would_run_code_runs_nothing(tmp_path, npy_pickle, protocol, function, place):
    mark = tmp_path / "mark.npy"
    call = {"os.system": Call(os.system, f"echo > {mark}"),
            "builtins.eval": Call(eval, f"open({str(mark)!r}, 'w')"),
            "builtins.open": Call(open, str(mark), "w"),
            "numpy.save": Call(np.save, str(mark), 1)}[function]
    data = pickle.dumps(call if place == "alone" else PICKLED | {"note": call}, protocol=protocol)
    path = npy_pickle(data)
    with pytest.raises(DriveError, match=r"asks for .*, which could run code; nothing of it was run"):
        recordings.load(path)
    assert not mark.exists()


def test_the_attack_above_is_a_real_one(tmp_path):
    mark = tmp_path / "mark"
    pickle.loads(pickle.dumps(Call(os.system, f"echo > {mark}")))
    assert mark.exists()


@pytest.mark.parametrize("name", ["ndarray.tofile", "load", "lib", "ndarray.__class__"])
def test_no_other_name_of_numpy_is_admitted(npy_pickle, name):
    data = b"\x80\x04\x8c\x05numpy\x8c" + bytes([len(name)]) + name.encode() + b"\x93."
    with pytest.raises(DriveError, match=f"asks for numpy.{name}, which could run code"):
        recordings.load(npy_pickle(data))


def test_a_truncated_pickle_anywhere(npy_pickle):
    data = pickle.dumps(np.array(PICKLED, dtype=object), protocol=4)
    for size in range(0, len(data), 37):
        with pytest.raises(DriveError, match="pickle is damaged or cut short"):
            recordings.load(npy_pickle(data[:size]))


# Ground truth


def _drive(folder):
    np.savez(folder / "drive.npz", **NPZ)
    return recordings.load(folder / "drive.npz")


def _kitti(folder, poses):
    recordings.save_kitti(folder / "poses.txt", poses)
    return folder / "poses.txt"


POSES = se3.exp(np.random.default_rng(5).normal(size=(N_FRAMES, 6)))


@pytest.fixture
def drive(tmp_path):
    return _drive(tmp_path)


@pytest.fixture
def text(tmp_path):
    def write(content):
        (tmp_path / "truth.txt").write_text(content)
        return tmp_path / "truth.txt"
    return write


def test_kitti_poses_may_end_early(tmp_path, drive):
    truth = recordings.load_ground_truth(_kitti(tmp_path, POSES[:4]), drive)
    assert truth.truth_world_T_cam[:4] == pytest.approx(POSES[:4], abs=1e-11)
    assert np.isnan(truth.truth_world_T_cam[4:]).all()
    assert truth.true_world_T_imu[0] == pytest.approx(np.eye(4), abs=1e-12)
    expected = IMU_T_CAM @ se3.inverse(POSES[0]) @ POSES[3] @ CAM_T_IMU
    assert truth.true_world_T_imu[3] == pytest.approx(expected, abs=1e-10)


def test_kitti_poses_with_seven_digits_are_made_rigid(text, drive):
    rows = "".join(" ".join(f"{x:.6e}" for x in pose[:3].ravel()) + "\n" for pose in POSES)
    rotations = recordings.load_ground_truth(text(rows), drive).truth_world_T_cam[:, :3, :3]
    identities = np.broadcast_to(np.eye(3), rotations.shape)
    assert rotations @ rotations.mT == pytest.approx(identities, abs=1e-14)
    assert rotations == pytest.approx(POSES[:, :3, :3], abs=1e-6)


def test_kitti_poses_of_another_drive(tmp_path, drive):
    path = _kitti(tmp_path, POSES)
    with pytest.raises(DriveError, match=f"{re.escape(str(path))}: 6 poses for a drive of 5 frames"):
        recordings.load_ground_truth(path, drive.slice(1))


@pytest.mark.parametrize("start", [0.0, TIMES[0]], ids=["since start", "absolute"])
def test_tum_rows_go_to_the_nearest_frame(tmp_path, drive, start):
    # frame 2 has no row within half a frame; frame 3 has two, of which the second is nearer
    times = start + np.array([0.49, 0.01, 0.11, 0.265, 0.31, 0.39])
    rows = [5, 0, 1, 2, 3, 4]
    recordings.save_tum(tmp_path / "tum.txt", times, POSES[rows])
    truth = recordings.load_ground_truth(tmp_path / "tum.txt", drive).truth_world_T_cam
    known = [0, 1, 3, 4, 5]
    assert truth[known] == pytest.approx(POSES[known], abs=1e-11)
    assert np.flatnonzero(np.isnan(truth[:, 0, 0])).tolist() == [2]


def test_tum_comments_and_a_single_row(text, drive):
    path = text(f"# time x y z qx qy qz qw\n\n{TIMES[2]:.6f} 1 2 3 0 0 0 1\n")
    truth = recordings.load_ground_truth(path, drive).truth_world_T_cam
    assert np.array_equal(truth[2], se3.pose(np.eye(3), np.array([1, 2, 3])))
    assert np.isnan(truth[[0, 1, 3, 4, 5]]).all()


IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0\n"
BROKEN_TRUTH = {
    "empty": ("# nothing\n\n", "no row of numbers in it"),
    "columns": ("1 2 3\n", "3 numbers a row, expected 12"),
    "ragged": (IDENTITY + "1 0 0\n", "line 2: expected 12 finite numbers"),
    "nan": (IDENTITY + IDENTITY.replace("1", "nan"), "line 2: expected 12 finite"),
    "words": ("# poses\n" + IDENTITY + "one two\n", "line 3: 'one two' is not a row of numbers"),
    "mirror": (IDENTITY + "1 0 0 0 0 1 0 0 0 0 -1 0\n", "pose row 1: not a rigid motion"),
    "scaled": (IDENTITY + "2 0 0 0 0 2 0 0 0 0 2 0\n", "pose row 1: not a rigid motion"),
    "quaternion": ("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 0\n", "time 0.1: quaternion .* is not of length 1"),
    "elsewhen": ("77 0 0 0 0 0 0 1\n", r"no row within half a frame \(0.050 s\)"),
}


@pytest.mark.parametrize("case", BROKEN_TRUTH)
def test_broken_ground_truth_is_named(text, drive, case):
    content, message = BROKEN_TRUTH[case]
    with pytest.raises(DriveError, match=f"truth.txt: {message}"):
        recordings.load_ground_truth(text(content), drive)


def test_missing_and_binary_ground_truth(tmp_path, drive):
    with pytest.raises(DriveError, match=r"none.txt: no such file"):
        recordings.load_ground_truth(tmp_path / "none.txt", drive)
    (tmp_path / "drive.npz").write_bytes(b"PK\xff\xfe")
    with pytest.raises(DriveError, match=r"drive.npz: not a text file"):
        recordings.load_ground_truth(tmp_path / "drive.npz", drive)


def test_writers_refuse_what_is_no_trajectory(tmp_path):
    path = tmp_path / "poses.txt"
    with pytest.raises(ValueError, match=r"poses: shape \(4, 4\)"):
        recordings.save_kitti(path, np.eye(4))
    with pytest.raises(ValueError, match="poses: pose 3 is not finite"):
        recordings.save_kitti(path, put(POSES, (3, 0, 0), np.nan))
    with pytest.raises(ValueError, match=r"times: shape \(5,\), expected \(6,\)"):
        recordings.save_tum(path, TIMES[:5], POSES)
    assert not path.exists()


def test_find(tmp_path, monkeypatch):
    assert recordings.find("no such drive") is None
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.npz").touch()
    (tmp_path / "theirs.npy").touch()
    assert recordings.find("mine") == tmp_path / "mine.npz"
    assert recordings.find("mine.npz") == tmp_path / "mine.npz"
    assert recordings.find("theirs") == tmp_path / "theirs.npy"


# Size


def _write_large(path, n_landmarks, n_frames, life):
    """A recording written landmark by landmark, so that writing it takes no memory."""
    rng = np.random.default_rng(0)
    fields = NPZ | {"time_stamps": 0.1 * np.arange(n_frames), "linear_velocity": np.zeros((3, n_frames)),
                    "angular_velocity": np.zeros((3, n_frames))}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for key, value in without(fields, "features").items():
            buffer = io.BytesIO()
            np.save(buffer, value)
            archive.writestr(f"{key}.npy", buffer.getvalue())
        with archive.open("features.npy", "w", force_zip64=True) as file:
            shape = (4, n_landmarks, n_frames)
            npy.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
            for _ in range(4):
                for i in range(n_landmarks):
                    first = i * (n_frames - life) // n_landmarks
                    row = np.full(n_frames, -1.0)
                    row[first:first + life] = rng.uniform(0, 1000, life)
                    file.write(row.tobytes())


def test_a_large_recording_needs_little_more_memory_than_its_dense_array(tmp_path):
    """Dataset 10 is four times as long as this one, 1.3 GB dense, and has to run within 4 GB."""
    shape, life = (13289, 756), 15
    _write_large(tmp_path / "10.npz", *shape, life)
    drives = []

    def use():
        drives.append(recordings.load(tmp_path / "10.npz"))
        _ = drives[0].subsample(10), drives[0].slice(100, 600), drives[0].observed(500), drives[0].step_twists

    dense = 32 * shape[0] * shape[1]  # bytes
    assert peak(use) < 1.3 * dense
    assert (drives[0].n_landmarks, drives[0].n_frames, len(drives[0].landmark)) == (*shape, shape[0] * life)


# Real recordings


needs_recordings = pytest.mark.skipif(not SHARED.is_dir(), reason="the course's recordings are not here")


@needs_recordings
@pytest.mark.parametrize(("name", "shape", "observations"),
                         [("03", (5105, 1010), 66353), ("0027", (3950, 1106), 75647)])
def test_real_recordings(name, shape, observations):
    path = SHARED / f"{name}.npz"
    drive = recordings.load(path)
    assert (drive.n_landmarks, drive.n_frames) == shape
    assert len(drive.landmark) == observations
    with np.load(path, allow_pickle=False) as fields:
        assert np.array_equal(np.nan_to_num(drive.features, nan=-1), fields["features"])
        assert np.array_equal(drive.times, fields["time_stamps"][0])
        if name == "03":
            assert drive.camera.imu_T_cam == pytest.approx(fields["imu_T_cam"], abs=1e-7)
        else:
            assert drive.camera.cam_T_imu == pytest.approx(fields["cam_T_imu"], abs=1e-7)


@needs_recordings
def test_real_ground_truth_moves_as_the_imu_says():
    drive = recordings.load(SHARED / "0027.npz")
    drive = recordings.load_ground_truth(SHARED / "0027_ground_truth.txt", drive)
    poses = drive.true_world_T_imu
    assert np.isnan(poses[1101:]).all()
    steps = se3.log(se3.inverse(poses[:1100]) @ poses[1:1101]) / drive.taus[:1100, None]
    measured = drive.replace(imu_sample="k+1").step_twists[:1100]
    assert np.abs(np.median(steps - measured, axis=0))[:3].max() < 0.2  # m/s, at 6 m/s on average
    assert np.abs(np.median(steps - measured, axis=0))[3:].max() < 0.02  # rad/s
