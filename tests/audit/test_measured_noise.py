"""Measured noise against drives whose noise is known."""

import numpy as np
import pytest
from scipy.stats import chi2
from whole import few

from vislam_edu import recordings, simulate
from vislam_edu.audit import measured_noise
from vislam_edu.simulate import faults

SIZES = [(0.5, 0.05, 0.7), (0.1, 0.01, 0.3), (1.0, 0.2, 1.0), (0.2, 0.02, 1.5), (0.05, 0.005, 0.5)]


@pytest.mark.parametrize(("sigma_v", "sigma_omega", "sigma_px"), SIZES)
def test_noise_of_simulated_drives(sigma_v, sigma_omega, sigma_px):
    """Also where the cameras' own uncertainty is larger than the IMU's noise (the last two sizes)."""
    z = []
    for seed in few(1, range(3)):
        drive = simulate.street_loop(seed, frames=250, loop_length=500, sigma_v=sigma_v, sigma_omega=sigma_omega,
                                     sigma_px=sigma_px)
        measured = measured_noise.measure(drive)
        noise = measured.noise
        assert noise.sigma_v == pytest.approx(sigma_v, rel=0.15)
        assert noise.sigma_omega == pytest.approx(sigma_omega, rel=0.1)
        assert noise.sigma_px == pytest.approx(sigma_px, rel=0.05)
        z.append((np.r_[measured.sigma_v / sigma_v, measured.sigma_omega / sigma_omega] - 1)
                 / (measured.standard_error / np.repeat([sigma_v, sigma_omega], 3)))
    # The standard errors are right: neither axis by axis (99.99 %) nor all together are the misses larger
    assert np.sum(np.square(z)) < chi2.ppf(0.9999, np.size(z))


def test_standard_error_is_not_too_large():
    z = []
    for seed in few(4, range(8)):
        measured = measured_noise.measure(simulate.street_loop(seed, frames=150, loop_length=500))
        z.append((np.r_[measured.sigma_v - 0.5, measured.sigma_omega - 0.05]) / measured.standard_error)
    assert np.sum(np.square(z)) > chi2.ppf(0.001, np.size(z))


def test_axes_are_told_apart():
    drive = simulate.street_loop(0, frames=300, loop_length=500)
    louder = np.random.default_rng(1).normal(size=(300, 6)) * [0, 2.0, 0, 0, 0, 0.2]
    measured = measured_noise.measure(drive.replace(twists=drive.twists + louder))
    np.testing.assert_allclose(measured.sigma_v, [0.5, np.hypot(0.5, 2.0), 0.5], rtol=0.15)
    np.testing.assert_allclose(measured.sigma_omega, [0.05, 0.05, np.hypot(0.05, 0.2)], rtol=0.15)


def test_faults_of_mounting_bias_and_tracks_do_not_count_as_noise():
    drive = simulate.street_loop(0, frames=300, loop_length=500)
    clean = measured_noise.measure(drive)
    spoilt = faults.add_gyro_bias(faults.wrong_lever_arm(faults.flip_imu_axes(drive)), 0.05)
    same = measured_noise.measure(spoilt)
    np.testing.assert_allclose(same.sigma_v, clean.sigma_v, rtol=1e-6)
    np.testing.assert_allclose(same.sigma_omega, clean.sigma_omega, rtol=1e-6)
    copies = measured_noise.measure(faults.copy_frames(drive))
    np.testing.assert_allclose(copies.sigma_omega, 0.05, rtol=0.2)
    assert copies.noise.sigma_px == pytest.approx(0.7, rel=0.05)


def test_mean_of_two_samples_is_told_per_sample():
    drive = simulate.perfect_street_loop(0, frames=300, loop_length=500)
    # samples at the frames, such that the mean of two is the step's twist up to how the motion bends
    instant = np.concatenate([drive.twists[:1], (drive.twists[1:] + drive.twists[:-1]) / 2])
    noisy = simulate.add_noise(drive.replace(twists=instant, imu_sample="mean"), 0)
    noise = measured_noise.measure(noisy).noise
    assert noise.sigma_v == pytest.approx(0.5, rel=0.1)
    assert noise.sigma_omega == pytest.approx(0.05, rel=0.1)


def test_a_drive_without_tracks_cannot_be_measured():
    drive = simulate.street_loop(0, frames=60, loop_length=500)
    with pytest.raises(ValueError, match="0 steps only"):
        measured_noise.measure(drive.keep_landmarks(np.arange(drive.n_landmarks) < 3))


def test_report_names_every_number():
    text = str(measured_noise.measure(simulate.street_loop(0, frames=100, loop_length=500)))
    assert "m/s" in text
    assert "rad/s" in text
    assert "px" in text


def test_noise_of_0027():
    path = recordings.find("0027")
    if path is None:
        pytest.skip("0027.npz is not here; put it into ../shared/data to run this")
    measured = measured_noise.measure(recordings.load(path).replace(imu_sample="k+1"))
    np.testing.assert_allclose(measured.sigma_v, 0.5, rtol=0.2)
    np.testing.assert_allclose(measured.sigma_omega, 0.05, rtol=0.2)


@pytest.mark.parametrize(("sigma_v", "sigma_omega"), [(0.5, 0.05), (0.01, 0.006)])
def test_second_differences_give_the_noise_of_the_imu_without_any_camera(sigma_v, sigma_omega):
    drive = simulate.street_loop(4, frames=500, sigma_v=sigma_v, sigma_omega=sigma_omega)
    measured = measured_noise.from_samples(drive).noise
    assert measured.sigma_omega == pytest.approx(sigma_omega, rel=0.1)
    assert measured.sigma_v == pytest.approx(sigma_v, rel=0.5 if sigma_v < 0.1 else 0.1)  # a car does brake
