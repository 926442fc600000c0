"""The simulated drive is what it says: consistent with its truth, like the recordings, and repeatable."""

import numpy as np
import pytest
from scipy.stats import chi2

from vislam_edu import recordings, se3, simulate
from vislam_edu.simulate import drives, streets


@pytest.fixture(scope="module")
def perfect():
    return simulate.perfect_street_loop(seed=3)


@pytest.fixture(scope="module")
def noisy():
    return simulate.street_loop(seed=3)


def geometry(drive):
    return drive.times, drive.truth_world_T_cam, drive.truth_landmarks, drive.frame_start, drive.landmark


def lengths(drive):
    return drive.last_seen - drive.first_seen + 1


def test_imu_drives_the_true_poses(perfect):
    T = perfect.true_world_T_imu
    predicted = T[:-1] @ se3.exp(perfect.taus[:, None] * perfect.step_twists)
    np.testing.assert_allclose(predicted, T[1:], atol=1e-10)
    np.testing.assert_array_equal(perfect.twists[-1], perfect.twists[-2])


def test_pixels_are_the_projected_truth(perfect):
    pixels, in_front = perfect.camera.observe(
        perfect.true_world_T_imu[perfect.frame], perfect.true_landmarks[perfect.landmark]
    )
    assert in_front.all()
    np.testing.assert_allclose(perfect.pixels, pixels, atol=1e-8)


def test_loop_closes_and_moves_in_all_six_degrees(perfect):
    T = perfect.true_world_T_imu
    np.testing.assert_allclose(T[-1], T[0], atol=1e-6)
    # The way round is counted modulo its length: a road that did not close would show as a jump at the end.
    assert np.abs(np.diff(perfect.twists[-5:], axis=0)).max() < 0.2
    assert 450 < np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=-1).sum() < 550
    assert (perfect.twists.std(axis=0) > [0.5, 0.001, 0.02, 0.005, 0.005, 0.1]).all()
    assert 0.4 < np.abs(perfect.twists[:, 5]).max() < 0.8  # corners like the recordings' (99 %: 0.5 rad/s)
    assert perfect.twists[:, 0].min() > 3


@pytest.mark.parametrize("length", [200, 500, 3026])
def test_road_closes_whatever_its_length(length):
    _, heading, _, x, y = streets.centre_line(length)
    assert heading[-1] == pytest.approx(2 * np.pi)
    np.testing.assert_allclose([x[-1], y[-1]], 0, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_tracks_resemble_the_recordings(seed):
    drive = simulate.street_loop(seed=seed)
    length, disparity = lengths(drive), drive.pixels[:, 0] - drive.pixels[:, 2]
    assert drive.n_frames == 500
    assert 55 < drive.visible.mean() < 65
    assert drive.visible.min() > 10  # even in a corner
    assert length.min() >= 5
    assert length.max() <= 100
    assert 12 < length.mean() < 20  # 03.npz: 13, 0027.npz: 19
    assert np.mean((disparity > 3) & (disparity < 60)) > 0.9
    births = np.unique(drive.first_seen)
    assert 5 < np.diff(births).mean() < 7
    # Drive itself refuses tracks with gaps; here every observation of a track is there, first to last.
    np.testing.assert_array_equal(np.bincount(drive.landmark), length)


def test_pixels_lie_in_the_image(perfect):
    assert (perfect.pixels > 0).all()
    assert (perfect.pixels < [1241, 376, 1241, 376]).all()


@pytest.mark.parametrize(
    ("visible", "mean_life", "redetect_every"), [(20, 20.0, 1), (100, 60.0, 6), (60, 10.0, 4)]
)
def test_number_in_view_follows_the_argument(visible, mean_life, redetect_every):
    drive = simulate.perfect_street_loop(
        frames=400, visible=visible, mean_life=mean_life, redetect_every=redetect_every
    )
    assert drive.visible.mean() == pytest.approx(visible, rel=0.05)


def test_a_short_drive_is_a_part_of_a_loop_and_a_short_loop_is_driven_again():
    part = simulate.perfect_street_loop(frames=60).true_world_T_imu
    assert 40 < np.linalg.norm(part[-1, :3, 3] - part[0, :3, 3]) < 60
    again = simulate.perfect_street_loop(frames=501, jitter=0.0, loop_length=250.0).true_world_T_imu
    np.testing.assert_allclose(again[250:], again[:251], atol=1e-6)


def test_times_jitter():
    taus = simulate.perfect_street_loop(tau=0.2, jitter=0.01).taus
    assert taus.mean() == pytest.approx(0.2, rel=1e-3)
    assert 0.005 < np.abs(taus - 0.2).max() <= 0.01


def test_life_is_respected():
    length = lengths(simulate.perfect_street_loop(life=(8, 30)))
    assert (length.min(), length.max()) == (8, 30)


def test_dataset_10_size():
    drive = simulate.perfect_street_loop(frames=3026)
    assert drive.n_frames == 3026
    assert drive.n_landmarks == pytest.approx(13289, rel=0.1)
    assert 55 < drive.visible.mean() < 65


def test_noise_has_the_promised_size():
    """Sums of squares over 20 seeds, each sigma within its 99.9 % chi-square band."""
    bias = np.array([0.01, -0.02, 0.03])
    squares, counts = np.zeros(3), np.zeros(3)
    for seed in range(20):
        drive = simulate.perfect_street_loop(seed, frames=200, loop_length=500)
        noise = simulate.add_noise(drive, seed, gyro_bias=bias)
        residuals = (
            (noise.twists - drive.twists)[:, :3] / 0.5,
            ((noise.twists - drive.twists)[:, 3:] - bias) / 0.05,
            (noise.pixels - drive.pixels) / 0.7,
        )
        squares += [np.sum(r**2) for r in residuals]
        counts += [r.size for r in residuals]
    low, high = chi2.ppf([0.0005, 0.9995], counts[:, None]).T
    assert (low < squares).all()
    assert (squares < high).all()


def test_noise_is_white_across_axes_and_time(perfect, noisy):
    for noise in (noisy.twists - perfect.twists, noisy.pixels - perfect.pixels):
        correlation = np.corrcoef(np.hstack([noise[:-1], noise[1:]]).T)
        off_diagonal = correlation[~np.eye(len(correlation), dtype=bool)]
        assert np.abs(off_diagonal).max() < 5 / np.sqrt(len(noise))


def test_same_seed_same_drive(noisy):
    again = simulate.street_loop(seed=3)
    other = simulate.street_loop(seed=4)
    for a, b in zip(geometry(noisy), geometry(again)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(noisy.twists, again.twists)
    np.testing.assert_array_equal(noisy.pixels, again.pixels)
    assert not np.array_equal(noisy.truth_world_T_cam, other.truth_world_T_cam)
    assert not np.array_equal(noisy.twists, other.twists)


def test_noise_leaves_the_geometry_alone(noisy):
    louder = simulate.street_loop(
        seed=3, sigma_v=2.0, sigma_omega=0.0, sigma_px=3.0, gyro_bias=(0.1, 0, 0), outlier_share=0.3
    )
    for a, b in zip(geometry(noisy), geometry(louder)):
        np.testing.assert_array_equal(a, b)


def test_a_sigma_scales_the_same_draws(perfect):
    one, two = (simulate.add_noise(perfect, seed=5, sigma_px=s, sigma_v=s) for s in (1.0, 2.0))
    np.testing.assert_allclose(two.pixels - perfect.pixels, 2 * (one.pixels - perfect.pixels), atol=1e-9)
    np.testing.assert_array_equal(one.twists[:, 3:], two.twists[:, 3:])


def test_outlier_share_is_planted(perfect):
    drive = simulate.street_loop(seed=3, sigma_px=0.0, outlier_share=0.2)
    wrong = np.abs(drive.pixels - perfect.pixels).max(axis=1) > 1e-6
    touched = np.unique(drive.landmark[wrong])
    assert len(touched) == round(0.2 * drive.n_landmarks)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"life": (0, 5)}, "life"),
        ({"life": (9, 5)}, "life"),
        ({"frames": 3}, "frames"),
        ({"jitter": 0.06}, "jitter"),
        ({"speed": 0.0}, "speed"),
        ({"visible": 0}, "visible"),
        ({"redetect_every": 0}, "redetect_every"),
        ({"loop_length": 100.0}, "loop_length"),
    ],
)
def test_impossible_arguments_are_named(arguments, word):
    with pytest.raises(ValueError, match=word):
        simulate.perfect_street_loop(**arguments)


@pytest.mark.parametrize(
    ("name", "make"), [("street_loop", simulate.street_loop), ("first_steps", simulate.first_steps)]
)
def test_committed_drives_are_what_the_code_makes(name, make):
    made = make()
    path = recordings.find(name)
    assert path.stat().st_size < 3e6
    committed = recordings.load(path)
    for field in ("frame_start", "landmark"):
        np.testing.assert_array_equal(getattr(committed, field), getattr(made, field))
    for field in ("times", "twists", "pixels", "truth_world_T_cam", "truth_landmarks"):
        np.testing.assert_allclose(getattr(committed, field), getattr(made, field), atol=1e-9, err_msg=field)
    for field in ("name", "source", "n_landmarks", "imu_sample", "history"):
        assert getattr(committed, field) == getattr(made, field)


def test_first_steps_is_small_enough_to_watch():
    drive = simulate.first_steps()
    assert drive.n_frames == 60
    assert 35 <= drive.n_landmarks <= 45
    assert drive.visible.min() >= 10
    assert drive.visible.max() <= 20


def test_write_makes_loadable_files(tmp_path):
    paths = drives.write(tmp_path / "new")
    assert [p.name for p in paths] == ["street_loop.npz", "first_steps.npz"]
    assert [recordings.load(p).n_frames for p in paths] == [500, 60]
