"""Visual odometry against the simulator's truth: its motions, its covariance, its noise, and its stubbornness."""

import numpy as np
import pytest
from scipy.stats import chi2
from whole import few

from vislam_edu import recordings, se3, simulate
from vislam_edu.audit import cures, visual_odometry
from vislam_edu.recordings.features import drive_from_features

FRAMES = 200


def truth(drive):
    poses = drive.truth_world_T_cam
    return se3.inverse(poses[:-1]) @ poses[1:]


def errors(drive, motions):
    """(n, 6) right perturbations of the steps that are known."""
    return se3.log(se3.inverse(truth(drive)) @ motions.motion)[motions.ok]


def test_perfect_pixels_give_the_exact_motion():
    drive = simulate.perfect_street_loop(0, frames=100, loop_length=500)
    motions = visual_odometry.estimate(drive)
    assert motions.ok.all()
    np.testing.assert_allclose(motions.motion, truth(drive), atol=1e-9)
    np.testing.assert_allclose(motions.twists, se3.log(truth(drive)) / drive.taus[:, None], atol=1e-8)
    assert motions.inlier.all()


def test_pairs_are_the_same_landmark_in_consecutive_frames():
    drive = simulate.street_loop(0, frames=60, loop_length=500)
    step, before, after = visual_odometry.pairs(drive)
    expected = [
        np.intersect1d(drive.observed(k)[0], drive.observed(k + 1)[0]) for k in range(drive.n_frames - 1)
    ]
    np.testing.assert_array_equal(drive.landmark[before], np.concatenate(expected))
    np.testing.assert_array_equal(drive.landmark[after], np.concatenate(expected))
    np.testing.assert_array_equal(step, np.repeat(np.arange(drive.n_frames - 1), [len(ids) for ids in expected]))
    np.testing.assert_array_equal(drive.frame[after], step + 1)


def test_jacobian_against_central_differences():
    drive = simulate.street_loop(0, frames=20, loop_length=500)
    problem = visual_odometry._Problem(drive, *visual_odometry.pairs(drive))
    motion = se3.inverse(truth(drive))
    unweighted = np.broadcast_to(np.eye(3), (len(problem.step), 3, 3))
    at_the_pixels = np.zeros((len(problem.step), 4, 3))
    _, jacobian = problem.whitened(motion, unweighted, at_the_pixels)
    for i, direction in enumerate(1e-5 * np.eye(6)):
        ahead, back = (problem.whitened(se3.exp(d) @ motion, unweighted, at_the_pixels)[0]
                       for d in (direction, -direction))
        difference = -(ahead - back) / 2e-5  # the residual is measured less predicted
        np.testing.assert_allclose(jacobian[..., i], difference, rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())


def test_noise_of_the_first_frame_is_carried_into_the_second():
    """The whitener makes residuals of unit covariance: against Monte Carlo over both frames' pixels."""
    drive = simulate.perfect_street_loop(0, frames=3, life=(2, 100), loop_length=500)
    motion = se3.inverse(truth(drive))
    sigma, runs, samples = 0.01, 1000, []
    step, before, after = visual_odometry.pairs(drive)
    whitener, gain = visual_odometry._Problem(drive, step, before, after).whitener(motion)
    for seed in range(runs):
        noisy = drive.replace(pixels=drive.pixels + sigma * np.random.default_rng(seed).normal(size=drive.pixels.shape))
        residual = visual_odometry._Problem(noisy, step, before, after).whitened(motion, whitener, gain)[0]
        samples.append(residual / sigma)
    samples = np.array(samples)
    covariance = np.einsum("rpi,rpj->pij", samples, samples) / runs
    # entries of a sample covariance scatter by sqrt(2 / runs) at most; thousands of them, so 6 standard deviations
    np.testing.assert_allclose(covariance, np.broadcast_to(np.eye(3), covariance.shape), atol=6 * np.sqrt(2 / runs))


@pytest.mark.parametrize("sigma_px", [0.2, 0.7])
def test_covariance_is_what_the_errors_show(sigma_px):
    nees = []
    for seed in few(2, range(4)):
        drive = simulate.street_loop(seed, frames=FRAMES, loop_length=500, sigma_px=sigma_px)
        motions = visual_odometry.estimate(drive)
        e, P = errors(drive, motions), motions.covariance[motions.ok]
        nees.append(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[..., None])[..., 0]))
    nees = np.concatenate(nees)
    # chi-square of 6 has variance 12; neighbours share a frame's pixels, which at most doubles the mean's
    assert abs(nees.mean() - 6) < 4 * np.sqrt(2 * 12 / len(nees))


@pytest.mark.parametrize("sigma_px", [0.1, 0.7, 1.5])
def test_pixel_noise_is_measured(sigma_px):
    for seed in few(1, range(3)):
        drive = simulate.street_loop(seed, frames=FRAMES, loop_length=500, sigma_px=sigma_px)
        assert visual_odometry.estimate(drive).sigma_px == pytest.approx(sigma_px, rel=0.05)
        assert visual_odometry.row_noise(drive.pixels) == pytest.approx(sigma_px, rel=0.05)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_wrong_tracks_do_not_bend_the_motion(share):
    clean = simulate.street_loop(1, frames=FRAMES, loop_length=500)
    spoilt = simulate.street_loop(1, frames=FRAMES, loop_length=500, outlier_share=share)
    motions = visual_odometry.estimate(spoilt)
    median = [np.median(np.abs(errors(*case)), axis=0)
              for case in ((clean, visual_odometry.estimate(clean)), (spoilt, motions))]
    assert motions.ok.all()
    assert (median[1] < 2 * median[0]).all()  # no worse than with a quarter of the tracks
    travelled = [motion[:, 2, 3].sum() for motion in (motions.motion, truth(spoilt))]
    assert travelled[0] == pytest.approx(travelled[1], rel=0.01)


def test_a_turn_needs_no_good_start():
    """0.3 rad and 2 m in one step: the car of the other tests turns by 0.05 rad at most."""
    world_T_cam = se3.exp(np.outer(np.arange(2), [0.2, 0, 2.0, 0.02, 0.3, -0.05]))
    rng = np.random.default_rng(0)
    landmarks = rng.uniform([-10, -5, 12], [20, 5, 40], (80, 3))
    camera = simulate.kitti_camera()
    pixels, in_front = camera.project(se3.transform(se3.inverse(world_T_cam)[:, None], landmarks))
    assert in_front.all()
    features = np.moveaxis(pixels + 0.5 * rng.normal(size=pixels.shape), (2, 1, 0), (0, 1, 2))
    drive = drive_from_features([0, 0.1], np.zeros((2, 6)), features, camera)
    motions = visual_odometry.estimate(drive)
    expected = se3.exp(np.array([0.2, 0, 2.0, 0.02, 0.3, -0.05]))
    error = se3.log(se3.inverse(expected) @ motions.motion)
    assert motions.ok.all()
    nees = np.einsum("ki,ki->k", error, np.linalg.solve(motions.covariance, error[..., None])[..., 0])
    assert (nees < chi2.ppf(0.9999, 6)).all()


def test_too_few_tracks_are_said_not_to_be_enough():
    drive = simulate.street_loop(0, frames=60, loop_length=500)
    sparse = drive.keep_landmarks(np.arange(drive.n_landmarks) < 5)
    motions = visual_odometry.estimate(sparse)
    assert not motions.ok.any()
    assert (motions.motion == np.eye(4)).all()
    assert np.isfinite(motions.twists).all()
    blind = visual_odometry.estimate(drive.keep_landmarks(np.zeros(drive.n_landmarks, bool)))
    assert not blind.ok.any()
    single = visual_odometry.estimate(drive.slice(0, 1))
    assert single.motion.shape == (0, 4, 4)


def test_scale_of_a_real_drive_comes_back_when_tracks_end_before_their_copies():
    path = recordings.find("0027")
    if path is None:
        pytest.skip("0027.npz is not here; put it into ../shared/data to run this")
    drive = recordings.load_ground_truth(path.with_name("0027_ground_truth.txt"), recordings.load(path))
    scale = []
    for case in (drive, drive.apply(cures.end_tracks_at_copies())):
        motions = visual_odometry.estimate(case)
        known = motions.ok & np.isfinite(truth(case)).all(axis=(1, 2))
        scale.append(motions.motion[known, 2, 3].sum() / truth(case)[known, 2, 3].sum())
    assert scale[0] == pytest.approx(0.91, abs=0.02)
    assert scale[1] == pytest.approx(1.0, abs=0.01)
