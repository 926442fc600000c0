"""Each planted fault does what it says, and nothing else."""

import numpy as np
import pytest

from vislam_edu import se3, simulate
from vislam_edu.simulate import faults


@pytest.fixture(scope="module")
def perfect():
    return simulate.perfect_street_loop(seed=1, frames=200, loop_length=500)


def unchanged(drive, planted, *but):
    fields = ("times", "twists", "frame_start", "landmark", "pixels", "truth_world_T_cam", "truth_landmarks")
    for field in fields:
        if field not in but:
            np.testing.assert_array_equal(getattr(drive, field), getattr(planted, field), err_msg=field)
    if "camera" not in but:
        assert planted.camera is drive.camera
    assert len(planted.history) == len(drive.history) + 1
    assert planted.history[-1].startswith("planted")


def camera_motion(drive):
    """Camera k+1 in camera k as IMU and extrinsics tell it, (T-1, 4, 4)."""
    step = se3.exp(drive.taus[:, None] * drive.step_twists)
    return drive.camera.cam_T_imu @ step @ drive.camera.imu_T_cam


def true_camera_motion(drive):
    return se3.inverse(drive.truth_world_T_cam[:-1]) @ drive.truth_world_T_cam[1:]


def test_flipped_axes(perfect):
    planted = faults.flip_imu_axes(perfect)
    unchanged(perfect, planted, "camera")
    np.testing.assert_allclose(camera_motion(perfect), true_camera_motion(perfect), atol=1e-9)
    # As in 03.npz: the cameras' rotation and the gyro agree on x and have opposite signs on y and z.
    gyro = perfect.camera.cam_T_imu[:3, :3] @ np.diag([1, -1, -1]) @ perfect.step_twists[:, 3:, None]
    told = se3.so3_log(camera_motion(planted)[:, :3, :3]) / perfect.taus[:, None]
    np.testing.assert_allclose(told, gyro[..., 0], atol=1e-9)
    assert np.abs(camera_motion(planted) - true_camera_motion(perfect)).max() > 0.05
    twice = faults.flip_imu_axes(planted)
    np.testing.assert_allclose(twice.camera.cam_T_imu, perfect.camera.cam_T_imu, atol=1e-15)


@pytest.mark.parametrize("signs", [(1, 1, -1), (1, 2, 0.5), (1, -1)])
def test_a_reflection_is_refused(perfect, signs):
    with pytest.raises(ValueError, match="signs"):
        faults.flip_imu_axes(perfect, signs)


def test_wrong_lever_arm(perfect):
    planted = faults.wrong_lever_arm(perfect)
    unchanged(perfect, planted, "camera")
    right, wrong = perfect.camera.cam_T_imu, planted.camera.cam_T_imu
    np.testing.assert_array_equal(wrong[:3, :3], right[:3, :3])
    np.testing.assert_allclose(-right[:3, :3] @ wrong[:3, 3], right[:3, 3], atol=1e-12)  # the cure, -R t
    given = faults.wrong_lever_arm(perfect, (1, 2, 3)).camera
    np.testing.assert_array_equal(given.cam_T_imu[:3, 3], [1, 2, 3])


def test_gyro_bias(perfect):
    planted = faults.add_gyro_bias(perfect, (0.01, 0.0, -0.02))
    unchanged(perfect, planted, "twists")
    difference = planted.twists - perfect.twists
    np.testing.assert_allclose(difference, [[0, 0, 0, 0.01, 0, -0.02]] * perfect.n_frames, atol=1e-12)


def test_late_imu_is_cured_by_the_next_sample(perfect):
    planted = faults.delay_imu(perfect)
    unchanged(perfect, planted, "twists")
    assert not np.allclose(planted.step_twists, perfect.step_twists)
    np.testing.assert_array_equal(planted.replace(imu_sample="k+1").step_twists, perfect.step_twists)
    np.testing.assert_array_equal(faults.delay_imu(perfect, 0).twists, perfect.twists)
    np.testing.assert_array_equal(faults.delay_imu(perfect, 3).twists[:4], perfect.twists[[0, 0, 0, 0]])
    for samples in (-1, 200):
        with pytest.raises(ValueError, match="samples"):
            faults.delay_imu(perfect, samples)


def dense(drive):
    return np.moveaxis(drive.features, 0, -1)  # (M, T, 4)


def test_copy_frames_by_a_plain_reference(perfect):
    planted = faults.copy_frames(perfect)
    unchanged(perfect, planted, "pixels")
    true, stale = dense(perfect), dense(planted)
    births = set(perfect.first_seen[perfect.first_seen > 0].tolist())
    for m in range(perfect.n_landmarks):
        first, last = perfect.first_seen[m], perfect.last_seen[m]
        expected = true[m, first]
        np.testing.assert_array_equal(stale[m, first], expected)
        for k in range(first + 1, last + 1):
            if k in births:
                np.testing.assert_array_equal(stale[m, k], stale[m, k - 1])
            else:
                expected = expected + true[m, k] - true[m, k - 1]
            np.testing.assert_allclose(stale[m, k], expected, atol=1e-9)


def test_copies_show_as_in_the_recordings():
    drive = faults.copy_frames(simulate.street_loop(seed=2))
    true, stale = dense(simulate.street_loop(seed=2)), dense(drive)
    same = (stale[:, 1:] == stale[:, :-1]).all(-1)
    share = same.sum() / len(drive.landmark)
    assert 0.05 < share < 0.15  # README of the recordings: five to ten per cent of all observations
    both = ~np.isnan(stale[:, 1:, 0]) & ~np.isnan(stale[:, :-1, 0])
    births = np.unique(drive.first_seen[drive.first_seen > 0]) - 1
    np.testing.assert_array_equal(same[:, births], both[:, births])  # every common track, at every birth
    assert not same[:, np.setdiff1d(np.arange(drive.n_frames - 1), births)].any()  # and nowhere else

    def growth(pixels):  # of the disparity, over whole tracks
        disparity = pixels[..., 0] - pixels[..., 2]
        m = np.arange(drive.n_landmarks)
        return np.mean(disparity[m, drive.last_seen] - disparity[m, drive.first_seen])

    assert 0.7 < growth(stale) / growth(true) < 0.95  # too slowly


def test_copy_frames_at_given_frames(perfect):
    planted = faults.copy_frames(perfect, [10])
    same = (dense(planted)[:, 1:] == dense(planted)[:, :-1]).all(-1)
    assert set(np.flatnonzero(same.any(0))) == {9}
    for frames in ([0], [200]):
        with pytest.raises(ValueError, match="copy frames"):
            faults.copy_frames(perfect, frames)


def test_copies_in_every_frame_freeze_the_track(perfect):
    stale = dense(faults.copy_frames(perfect, np.arange(1, 200)))
    born = dense(perfect)[np.arange(perfect.n_landmarks), perfect.first_seen]
    seen = ~np.isnan(stale[..., 0])
    np.testing.assert_array_equal(stale[seen], np.broadcast_to(born[:, None], stale.shape)[seen])


def test_outlier_tracks(perfect):
    planted = faults.outlier_tracks(perfect, 0.3, seed=7)
    unchanged(perfect, planted, "pixels")
    error = planted.pixels - perfect.pixels
    wrong = np.zeros(perfect.n_landmarks, bool)
    wrong[perfect.landmark[np.abs(error).max(1) > 1e-9]] = True
    assert wrong.sum() == round(0.3 * perfect.n_landmarks)

    mismatched = np.zeros_like(wrong)
    for m in np.flatnonzero(wrong):
        track = error[perfect.landmark == m]
        if np.abs(track[0]).max() > 1e-9:  # wrong from the start: a mismatch, right pixel only
            mismatched[m] = True
            np.testing.assert_array_equal(track[:, [0, 1, 3]], 0)
            np.testing.assert_allclose(track[:, 2], track[0, 2])
            assert 5 <= abs(track[0, 2]) <= 30
        else:  # a mover: right when born, then farther and farther off
            assert np.linalg.norm(track[-1]) > np.linalg.norm(track[1]) > 0
    assert mismatched.sum() > 0.3 * wrong.sum()
    assert (wrong & ~mismatched).sum() > 0.2 * wrong.sum()


def test_movers_move_at_a_constant_velocity_along_the_ground(perfect):
    planted = faults.outlier_tracks(perfect, 1.0, seed=7)
    movers = 0
    for m in range(perfect.n_landmarks):
        rows = planted.landmark == m
        if not np.array_equal(planted.pixels[rows][0], perfect.pixels[rows][0]):
            continue
        movers += 1
        frames = planted.frame[rows]
        in_camera, ok = planted.camera.triangulate(planted.pixels[rows])
        assert ok.all()
        path = se3.transform(planted.truth_world_T_cam[frames], in_camera)
        np.testing.assert_allclose(path[0], planted.truth_landmarks[m], atol=1e-6)
        velocity = np.diff(path, axis=0) / np.diff(planted.times[frames])[:, None]
        np.testing.assert_allclose(velocity, velocity[[0]].repeat(len(velocity), 0), atol=1e-4)
        np.testing.assert_allclose(velocity[:, 2], 0, atol=1e-4)
        assert 2 <= np.linalg.norm(velocity[0]) <= 8
    assert movers > 0.2 * perfect.n_landmarks


def test_outlier_tracks_need_a_share_and_the_truth(perfect):
    with pytest.raises(ValueError, match="share"):
        faults.outlier_tracks(perfect, 1.5)
    with pytest.raises(ValueError, match="truth"):
        faults.outlier_tracks(perfect.replace(truth_landmarks=None), 0.1)
    np.testing.assert_array_equal(faults.outlier_tracks(perfect, 0.0).pixels, perfect.pixels)


def test_lens_errors_are_smooth_shifts_of_the_size_asked_for(perfect):
    K, pixels = perfect.camera.K, perfect.pixels
    x, y = ((pixels[:, :2] - K[:2, 2]) / K[[0, 1], [0, 1]]).T
    right_x = (pixels[:, 2] - K[0, 2]) / K[0, 0]
    shift = faults.lens_error(perfect, disparity=0.5, row_saddle=2.0).pixels - pixels
    np.testing.assert_allclose(shift[:, 0] - shift[:, 2], 0.5, atol=1e-9)
    np.testing.assert_allclose(shift[:, 1] - shift[:, 3], (x + right_x) * y, atol=1e-9)  # half of 2 px in each image
    shift = faults.lens_error(perfect, focal_length=3.0).pixels - pixels
    np.testing.assert_allclose(shift[:, :2], 3 * np.stack([x, y], -1), atol=1e-9)
    with pytest.raises(ValueError, match="knows no fisheye"):
        faults.lens_error(perfect, fisheye=1.0)
