"""What the filters are told about the sensors: the report's values, and numbers that no sensor has."""

import numpy as np
import pytest

from vislam_edu.noise import Noise


def test_the_reports_values_make_its_w_and_v_at_its_time_step():
    noise = Noise.from_report(tau=0.1)
    np.testing.assert_allclose(noise.process_covariance(0.1), np.diag([1e-4] * 3 + [1e-7] * 3))
    np.testing.assert_allclose(noise.pixel_covariance, 15 * np.eye(4))


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
