"""`track`: folders of images and the course's lists of images, to a recording that loads."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from vislam_edu import cli, load
from vislam_edu.recordings import extrinsics
from vislam_edu.simulate import images

N = 6


@pytest.fixture(scope="module")
def street():
    return images.street_images(2, frames=N)


@pytest.fixture(scope="module")
def pairs(street):
    return list(street)


@pytest.fixture
def kitti(street, pairs, tmp_path):
    """KITTI's layout, with the IMU in a text file."""
    for side in (0, 1):
        (tmp_path / f"image_{side}").mkdir()
        for k in range(N):
            Image.fromarray(pairs[k][side]).save(tmp_path / f"image_{side}" / f"{k:06d}.png")
    drive = street.drive
    np.savetxt(tmp_path / "times.txt", drive.times)
    np.savetxt(tmp_path / "imu.txt", np.column_stack([drive.times, drive.twists]))
    P = np.hstack([drive.camera.K, np.zeros((3, 1))])
    right = P.copy()
    right[0, 3] = -drive.camera.K[0, 0] * drive.camera.baseline
    np.savetxt(tmp_path / "calib.txt", [P.ravel(), right.ravel()])
    return tmp_path


def command(folder, *images, calibration="calib.txt", imu="imu.txt"):
    return ["track", *map(str, images or [folder]), "--calibration", str(folder / calibration),
            "--imu", str(folder / imu), "--out", str(folder / "drive.npz"), "--visible", "40", "--quiet"]


def test_kitti_folder(kitti, street):
    assert cli.main(command(kitti)) == 0
    drive = load(kitti / "drive.npz")
    assert drive.n_frames == N
    assert drive.visible.min() > 15
    assert np.allclose(drive.twists, street.drive.twists)
    assert drive.camera.baseline == pytest.approx(0.54)
    assert not (kitti / "drive.tracking.npz").exists()


def renamed(folder, sides, inner=""):
    """The images of `kitti` in two other folders."""
    for side, name in enumerate(sides):
        (folder / name).mkdir(parents=True)
        (folder / f"image_{side}").rename(folder / name / inner)


def test_kitti_raw_with_dates_and_colour_cameras(kitti, street):
    renamed(kitti, ("image_02", "image_03"), "data")
    dates = np.datetime64("2011-09-30T14:33:20", "ns") + (1e9 * street.drive.times).astype("timedelta64[ns]")
    (kitti / "image_02" / "timestamps.txt").write_text("\n".join(str(date).replace("T", " ") for date in dates))
    (kitti / "times.txt").unlink()
    np.savetxt(kitti / "imu.txt", np.column_stack([dates.astype(int) / 1e9, street.drive.twists]))
    P2, P3 = np.loadtxt(kitti / "calib.txt")
    rows = {"calib_time": "09-Jan-2012 13:57:47", "P_rect_00": "1 " * 12, "P_rect_01": "1 " * 12,
            "P_rect_02": " ".join(map(str, P2)), "P_rect_03": " ".join(map(str, P3))}
    (kitti / "calib.txt").write_text("".join(f"{key}: {numbers}\n" for key, numbers in rows.items()))
    assert cli.main(command(kitti)) == 0
    drive = load(kitti / "drive.npz")
    assert drive.camera.baseline == pytest.approx(0.54)
    assert drive.times == pytest.approx(street.drive.times + 1317393200, abs=1e-6)


def euroc(folder, drive):
    """EuRoC's layout from the images of `kitti`: names of ns, two yaml files, body frame = left camera's."""
    renamed(folder, ("mav0/cam0", "mav0/cam1"), "data")
    f, cu, cv = drive.camera.K[0, 0], *drive.camera.K[:2, 2]
    for side, x in ((0, 0.0), (1, drive.camera.baseline)):
        for k, path in enumerate(sorted((folder / f"mav0/cam{side}/data").iterdir())):
            path.rename(path.with_name(f"{10**18 + round(1e9 * drive.times[k])}.png"))
        T = np.eye(4)
        T[0, 3] = x
        (folder / f"mav0/cam{side}/sensor.yaml").write_text(
            f"T_BS:\n  cols: 4\n  data: {T.ravel().tolist()}\nintrinsics: [{f}, {f}, {cu}, {cv}]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n")
    rows = np.column_stack([10**18 + 1e9 * drive.times, drive.twists])
    np.savetxt(folder / "imu.txt", rows, delimiter=",")


def test_euroc_folder(kitti, street, capsys):
    euroc(kitti, street.drive)
    yaml = [str(kitti / f"mav0/cam{side}/sensor.yaml") for side in (0, 1)]
    words = command(kitti)
    at = words.index("--calibration") + 1
    assert cli.main([*words[:at], *yaml, *words[at + 1:]]) == 0
    drive = load(kitti / "drive.npz")
    assert drive.visible.min() > 15
    assert drive.camera.baseline == pytest.approx(0.54)
    assert drive.twists == pytest.approx(street.drive.twists)
    assert cli.main([*words[:at], yaml[0], *words[at + 1:]]) == cli.BAD_INPUT
    assert "the yaml of one camera" in capsys.readouterr().err


def test_videos_need_an_optional_reader(kitti, pairs, monkeypatch, capsys):
    videos = [kitti / "a_l.mp4", kitti / "a_r.mp4"]
    for path in videos:
        path.touch()
    monkeypatch.setitem(sys.modules, "imageio", None)
    assert cli.main(command(kitti, *videos)) == cli.BAD_INPUT
    assert "pip install 'imageio[pyav]'" in capsys.readouterr().err

    def imopen(path, mode, plugin):
        side = videos.index(path)
        return SimpleNamespace(properties=lambda: SimpleNamespace(shape=(N, 160, 400, 3)),
                               read=lambda index: np.stack([pairs[index][side]] * 3, axis=-1))

    reader = SimpleNamespace(imopen=imopen)
    monkeypatch.setitem(sys.modules, "imageio", SimpleNamespace(v3=reader))
    monkeypatch.setitem(sys.modules, "imageio.v3", reader)
    assert cli.main(command(kitti, *videos)) == 0
    assert load(kitti / "drive.npz").visible.min() > 15


def test_interrupted_and_resumed_is_the_same(kitti, monkeypatch):
    from vislam_edu import tracking
    from vislam_edu.cli import track

    assert cli.main(command(kitti)) == 0
    whole = load(kitti / "drive.npz")
    monkeypatch.setattr(track, "_STORE_EVERY", 2)
    plain, calls = tracking.track, iter(range(99))

    def stops(*arguments, **options):
        for frame in plain(*arguments, **options):
            if next(calls) == 3:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(tracking, "track", stops)
    assert cli.main(command(kitti)) == cli.INTERRUPTED
    assert (kitti / "drive.tracking.npz").exists()
    monkeypatch.setattr(tracking, "track", plain)
    assert cli.main(command(kitti)) == 0
    assert np.array_equal(load(kitti / "drive.npz").pixels, whole.pixels)


def test_the_courses_lists_of_images(street, pairs, tmp_path):
    drive = street.drive
    imu_T_left = drive.camera.imu_T_cam @ np.linalg.inv(extrinsics.REGULAR_T_OPTICAL)
    left_T_right = np.eye(4)
    left_T_right[1, 3] = -drive.camera.baseline  # x forward, y left, z up
    course = {"timestamps": drive.times, "v_t": drive.twists[:, :3], "w_t": drive.twists[:, 3:], "features": None,
              "K_l": drive.camera.K, "K_r": drive.camera.K, "extL_T_imu": imu_T_left,
              "extR_T_imu": imu_T_left @ left_T_right}
    np.save(tmp_path / "dataset02.npy", np.array(course, dtype=object))
    lists = {"cam_imgs_L": [pair[0] for pair in pairs], "cam_imgs_R": [np.stack([pair[1]] * 3, -1) for pair in pairs]}
    np.save(tmp_path / "dataset02_imgs.npy", np.array(lists, dtype=object))
    assert cli.main(command(tmp_path, tmp_path / "dataset02_imgs.npy", calibration="dataset02.npy",
                            imu="dataset02.npy")) == 0
    made = load(tmp_path / "drive.npz")
    assert made.visible.min() > 15
    assert made.camera.baseline == pytest.approx(0.54)
    assert "imu_T_regular" in " ".join(made.history)


@pytest.mark.parametrize(("break_it", "said"), [
    (lambda folder: (folder / "image_1" / "000002.png").write_bytes(b"no image"), "000002.png"),
    (lambda folder: (folder / "calib.txt").write_text("1 2 3\n"), "calib.txt"),
    (lambda folder: (folder / "imu.txt").write_text("0 1 2 3\n"), "7"),
    (lambda folder: (folder / "imu.txt").write_text("0,0,0,0,9.7,0,0.5\n"), "holds gyro and accelerometer"),
    (lambda folder: (folder / "image_1").rename(folder / "other"), "expected a folder with image_0 and image_1"),
])
def test_what_is_wrong_is_said_in_a_line(kitti, capsys, break_it, said):
    break_it(kitti)
    assert cli.main(command(kitti)) == cli.BAD_INPUT
    message = capsys.readouterr().err
    assert said in message
    assert "unforeseen" not in message
    assert message.count("\n") == 1
