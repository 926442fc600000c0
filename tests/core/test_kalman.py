"""The Gaussian algebra against what the textbook writes, inverse and all."""

import numpy as np
import pytest

from vislam_edu import kalman

rng = np.random.default_rng(0)


def problem(*leading, n=5, m=4):
    """A covariance, an H, a V and a residual, random, with leading axes."""
    A, B = rng.normal(size=(*leading, n, n)), rng.normal(size=(*leading, m, m))
    return A @ A.mT, rng.normal(size=(*leading, m, n)), B @ B.mT + np.eye(m), rng.normal(size=(*leading, m))


def test_update_is_the_textbook_one():
    Sigma, H, V, residual = problem()
    K = Sigma @ H.T @ np.linalg.inv(H @ Sigma @ H.T + V)
    delta, new = kalman.update(Sigma, H, V, residual)
    np.testing.assert_allclose(delta, K @ residual, rtol=1e-9)
    np.testing.assert_allclose(new, (np.eye(5) - K @ H) @ Sigma, atol=1e-9)
    np.testing.assert_array_equal(new, new.T)


def test_update_is_the_least_squares_solution():
    """Prior and measurement, each weighed by its inverse covariance; the covariance is the inverse of their sum."""
    Sigma, H, V, residual = problem()
    information = np.linalg.inv(Sigma) + H.T @ np.linalg.inv(V) @ H
    delta, new = kalman.update(Sigma, H, V, residual)
    np.testing.assert_allclose(delta, np.linalg.solve(information, H.T @ np.linalg.solve(V, residual)), rtol=1e-8)
    np.testing.assert_allclose(new, np.linalg.inv(information), atol=1e-9)


def test_many_states_at_once_are_each_by_itself():
    many = problem(3, 2)
    delta, new = kalman.update(*many)
    squared = kalman.nis(many[3], kalman.innovation_covariance(*many[:3]))
    for i in np.ndindex(3, 2):
        one = [array[i] for array in many]
        for together, alone in zip((delta[i], new[i]), kalman.update(*one)):
            np.testing.assert_allclose(together, alone, atol=1e-12)
        assert squared[i] == pytest.approx(kalman.nis(one[3], kalman.innovation_covariance(*one[:3])))


def test_a_variance_stays_positive_where_the_short_form_loses_it():
    """Known to a kilometre, measured to a micrometre: 1 - K is zero in floating point, and (I - K H) Sigma with it."""
    Sigma, H, V = np.array([[1e6]]), np.eye(1), np.array([[1e-12]])
    K = kalman.gain(Sigma, H, kalman.innovation_covariance(Sigma, H, V))
    _, new = kalman.update(Sigma, H, V, np.zeros(1))
    assert (np.eye(1) - K @ H) @ Sigma == 0
    assert new == pytest.approx(V)


def test_gate_keeps_what_it_promises():
    residual = rng.normal(size=(200_000, 4))
    share = np.mean(kalman.nis(residual, np.eye(4)) <= kalman.gate_threshold(0.99))
    assert share == pytest.approx(0.99, abs=4 * np.sqrt(0.99 * 0.01 / len(residual)))
    assert kalman.gate_threshold(1) == np.inf


@pytest.mark.parametrize("probability", [0, -0.5, 1.01, np.nan])
def test_a_gate_that_is_no_probability_is_refused(probability):
    with pytest.raises(ValueError, match="a gate is a probability"):
        kalman.gate_threshold(probability)


def test_central_difference_of_a_function_that_one_can_differentiate():
    A, B = rng.normal(size=(3, 2)), rng.normal(size=(3, 2))
    jacobian = kalman.central_difference(lambda x: A @ x + B @ np.sin(x), 2)
    np.testing.assert_allclose(jacobian, A + B, atol=1e-9)
