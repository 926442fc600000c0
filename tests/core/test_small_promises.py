"""Input that used to be refused, or believed, for the wrong reason."""

import numpy as np
import pytest

from vislam_edu import Noise, metrics, robust, se3, simulate, smoother


def test_a_covariance_far_from_the_origin_is_accepted():
    """20 km away rounding makes an eigenvalue slightly negative: it is judged relative to the largest entry."""
    away = se3.adjoint(se3.exp(np.array([1e4, -2e4, 100.0, 0.5, -1.0, 2.0])))
    P = away @ np.diag([1e-3] * 3 + [1e-4] * 2 + [0.0]) @ away.T
    Noise(initial_pose_covariance=(P + P.T) / 2)
    with pytest.raises(ValueError, match="semi-definite"):
        Noise(initial_pose_covariance=np.diag([1.0] * 5 + [-1e-6]))


def test_nees_reads_both_triangles():
    P, error = np.array([[2.0, 0.5], [0.3, 1.0]]), np.array([1.0, -1.0])
    assert metrics.nees(error, P) == pytest.approx(metrics.nees(error, P.T))
    assert metrics.nees(error, P) == pytest.approx(error @ np.linalg.inv((P + P.T) / 2) @ error)


def test_the_backward_pass_refuses_robust_weights():
    with pytest.raises(ValueError, match="robust"):
        smoother.final_map(simulate.street_loop(frames=5), Noise(), process_frame=robust.process_frame)
