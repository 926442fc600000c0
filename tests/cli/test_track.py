"""`track`: folders of images and the course's lists of images, to a recording that loads."""

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
])
def test_what_is_wrong_is_said_in_a_line(kitti, capsys, break_it, said):
    break_it(kitti)
    assert cli.main(command(kitti)) == cli.BAD_INPUT
    message = capsys.readouterr().err
    assert said in message
    assert "unforeseen" not in message
    assert message.count("\n") == 1
