"""A run that should not be trusted says so, and a healthy one says nothing."""

from functools import cache

import numpy as np
import pytest
from whole import WHOLE

from vislam_edu import odometry, simulate
from vislam_edu.error_state import InverseDepth, RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.simulate import faults
from vislam_edu.studies import calibration, pipeline, regimes, run_warnings
from vislam_edu.studies.runs import Run

# Beginnings of the sentences
GATE, NIS, REPEATS, TRUTH = "the gate kept out", "the mean NIS", "what a track's disparity", "against the ground truth"
DEPTH, ROTATION, PARTED = "half of the disparities", "the filter claims at frame", "the filter and dead reckoning part"


@cache
def street(seed, frames=100):
    return simulate.street_loop(seed, frames=frames)


def warnings(drive, noise=None, error_state=None, calibration=None, **options):
    """Of the joint filter over a drive with truth, its start being the true one."""
    noise = noise or Noise()
    slam = pipeline.joint(drive, noise, error_state or InverseDepth(), **options)
    return run_warnings.of_filter(drive, slam, odometry.dead_reckon(drive, noise), 0.99, drive.true_world_T_imu,
                                  calibration)


def begins(sentences, beginning):
    return any(sentence.startswith(beginning) for sentence in sentences)


@pytest.mark.parametrize("seed", range(4))
def test_a_healthy_run_says_nothing(seed):
    assert warnings(street(seed)) == []


@pytest.mark.skipif(not WHOLE, reason="100 drives of 500 frames; the long version runs them")
def test_at_most_one_healthy_run_in_100_warns():
    warned = [seed for seed in range(100) if regimes.judge("street", seed, ["inverse_depth"], frames=500)[
        "inverse_depth"]["warnings"]]
    assert len(warned) <= 1


def without_truth(regime, name, seed, **options):
    found = regimes.judge(regime, seed, [name], **options)[name]["warnings"]
    return [sentence for sentence in found if run_warnings.needs_no_truth(sentence)]


@pytest.mark.parametrize("name", ["inverse_depth", "cartesian"])
@pytest.mark.parametrize("seed", range(20 if WHOLE else 1))
def test_a_baseline_of_5_cm_is_warned_of_without_truth(seed, name):
    assert begins(without_truth("short_baseline", name, seed, **({} if WHOLE else {"frames": 60})), DEPTH)


@pytest.mark.parametrize("seed", range(20 if WHOLE else 1))
def test_cartesian_landmarks_at_1_Hz_are_warned_of_without_truth(seed):
    """Their mean NEES is in the hundreds there; that of inverse depths is right, and nothing is said."""
    assert begins(without_truth("slow", "cartesian", seed), GATE)
    assert without_truth("slow", "inverse_depth", seed) == []


# --- one fault, one sentence --------------------------------------------------------------------------------


def test_outliers_are_kept_out_by_the_gate():
    assert begins(warnings(faults.outlier_tracks(street(0), 0.1)), GATE)


def test_more_pixel_noise_than_assumed_shows_in_the_nis():
    assert begins(warnings(street(1), Noise(sigma_v=0.1, sigma_omega=0.02, sigma_px=0.7)), NIS)


def test_a_lens_error_repeats_until_it_is_considered():
    drive = faults.lens_error(street(2), disparity_with_u_2=10.0)
    assert begins(warnings(drive), REPEATS)
    assert not begins(warnings(drive, calibration=np.zeros((drive.n_frames, 6, 6))), REPEATS)
    assert not begins(warnings(drive.replace(history=(calibration.LENS_CORRECTED,))), REPEATS)


def test_a_gyro_bias_parts_filter_and_dead_reckoning():
    assert begins(warnings(faults.add_gyro_bias(street(3), [0.0, 0.0, 0.04])), PARTED)


def test_the_right_perturbation_claims_a_rotation_that_nothing_measures():
    assert begins(warnings(street(0), error_state=RightPerturbation()), ROTATION)


@pytest.mark.parametrize(("error_state", "warned"), [(RightInvariant(), True), (InverseDepth(), False)])
def test_far_landmarks_are_too_far_for_cartesian_coordinates(error_state, warned):
    drive, noise = regimes.REGIMES["noisy"](0, frames=40)
    assert begins(warnings(drive, noise, error_state), DEPTH) == warned


def test_a_path_that_is_not_the_truth_is_warned_of():
    drive = street(1)
    lifted = drive.truth_world_T_cam.copy()
    lifted[:, 1, 3] += np.linspace(0, 5, len(lifted))
    assert begins(warnings(drive.replace(truth_world_T_cam=lifted)), TRUTH)


def test_a_recording_with_copy_frames_was_not_audited():
    assert run_warnings.of_recording(street(0)) == []
    sentence, = run_warnings.of_recording(faults.copy_frames(street(0)))
    assert "copy frames (" in sentence
    assert "--audit" in sentence


# --- the numbers behind the sentences -----------------------------------------------------------------------


def test_one_drive_is_worth_two_frames():
    """The limits of NEES and of the share inside 3 sigma, on errors that are random walks."""
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.standard_normal((4000, 150, 6)), axis=1) / np.sqrt(np.arange(1, 151))[:, None]
    nees, inside = (walk**2).sum(axis=-1).mean(axis=1), (np.abs(walk) <= 3).mean(axis=1).min(axis=-1)
    assert nees.var() == pytest.approx(6, rel=0.15)
    assert 0 < np.mean(nees > run_warnings.MOST_NEES) < 0.004
    assert 0 < np.mean(inside < run_warnings.LEAST_INSIDE) < 0.004


def run_of(residual):
    """A `Run` of tracks that are seen in every frame. residual : (frames, tracks) px, of the disparity."""
    frames, tracks = residual.shape
    both = np.zeros((residual.size, 4))
    both[:, 0] = residual.ravel()
    return Run(InverseDepth(), np.tile(np.eye(4), (frames, 1, 1)), np.tile(np.eye(6), (frames, 1, 1)),
               np.repeat(np.arange(frames), tracks), np.tile(np.arange(tracks), frames), both,
               np.full(residual.size, 4.0), np.ones(residual.size, bool))


def test_what_repeats_is_measured_along_each_track():
    rng = np.random.default_rng(1)
    white = rng.standard_normal((200, 20))
    shared = rng.standard_normal((200, 1)) + 0.1 * white  # all tracks of a frame alike, yet nothing repeats
    for residual, lasting in ((white, 0.0), (shared, 0.0), (white + 1.0, 0.5)):  # by a constant
        repeated, strays = run_warnings.repeated_disparity(run_of(residual))
        assert repeated == pytest.approx(lasting, abs=0.2)
        assert (strays > run_warnings.MOST_SIGMA) == (lasting > 0)


def test_a_sum_over_frames_counts_frames_not_measurements():
    frame = np.repeat(np.arange(100), 50)
    coin = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 100), 50)
    assert run_warnings.sigmas_from_zero(coin, frame) == pytest.approx(coin[::50].sum() / 10)
