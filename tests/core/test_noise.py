"""What the filters are told about the sensors: the report's values, and numbers that no sensor has."""

import numpy as np
import pytest

from vislam_edu.noise import Noise


def test_the_reports_values_make_its_w_and_v_at_its_time_step():
    noise = Noise.from_report(tau=0.1)
    np.testing.assert_allclose(noise.process_covariance(0.1), np.diag([1e-4] * 3 + [1e-7] * 3))
    np.testing.assert_allclose(noise.pixel_covariance, 15 * np.eye(4))


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0, 200.0])
def test_a_density_gives_the_same_uncertainty_per_second_at_every_rate(rate):
    noise = Noise.from_density(0.1, 0.02, rate, sigma_px=2.0)
    ten_seconds = 10 * rate * noise.process_covariance(1 / rate)
    np.testing.assert_allclose(ten_seconds, 10 * np.diag([0.1**2] * 3 + [0.02**2] * 3))
    assert noise.sigma_px == 2.0


def test_a_sample_is_the_mean_of_faster_samples():
    """200 000 samples of a 100 Hz gyro, averaged by tens: sigma within four standard errors, 4 / sqrt(2 n)."""
    fast, slow = (Noise.from_density(0.0, 0.02, rate).sigma_omega for rate in (100.0, 10.0))
    samples = fast * np.random.default_rng(0).standard_normal((20_000, 10))
    assert samples.mean(axis=1).std() == pytest.approx(slow, rel=4 / np.sqrt(2 * 20_000))


@pytest.mark.parametrize("rate", [0.0, -1.0, np.inf, np.nan])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="rate must be a finite number > 0"):
        Noise.from_density(0.1, 0.02, rate)


@pytest.mark.parametrize(("changes", "said"), [
    ({"sigma_v": -0.1}, "Noise.sigma_v must be a finite number >= 0, got -0.1"),
    ({"sigma_omega": np.nan}, "Noise.sigma_omega must be a finite number"),
    ({"landmark_prior": np.inf}, "Noise.landmark_prior must be a finite number"),
    ({"sigma_px": 0.0}, "Noise.sigma_px must be > 0"),
    ({"initial_pose_covariance": np.eye(3)}, r"must have shape \(6, 6\), got \(3, 3\)"),
    ({"initial_pose_covariance": -np.eye(6)}, "must be symmetric positive semi-definite"),
    ({"initial_pose_covariance": np.eye(6) + np.eye(6, k=1)}, "must be symmetric positive semi-definite"),
], ids=lambda value: next(iter(value)) if isinstance(value, dict) else "")
def test_what_no_sensor_has_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        Noise(**changes)


def test_the_covariance_given_is_copied_and_cannot_be_changed():
    given = np.eye(6)
    noise = Noise(initial_pose_covariance=given)
    given[0, 0] = 5.0
    assert noise.initial_pose_covariance[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        noise.initial_pose_covariance[0, 0] = 2.0
