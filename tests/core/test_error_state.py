"""Every linearisation of both error states and both motion models against central differences.

A state is an estimate and an error; the error makes the true state. Whatever the filter claims about errors (they move
by F, noise enters by N, pixels change by H, a newborn inherits G) is checked by moving the true state, and only that.
"""

import numpy as np
import pytest
from numerical import central_difference

from vislam_edu import motion, se3, simulate, stereo, window_slam
from vislam_edu.error_state import ErrorState, RightInvariant, RightPerturbation
from vislam_edu.motion import Belief
from vislam_edu.noise import Noise

BOTH = [RightPerturbation(), RightInvariant()]
N = 4  # landmarks
RNG = np.random.default_rng(8)


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=1, frames=12, visible=10)


def belief(drive, tail=6):
    T = se3.exp(np.concatenate([RNG.normal(size=3) * 5, RNG.normal(size=3)]))
    q = np.column_stack([RNG.uniform(-5, 5, (N, 2)), RNG.uniform(6, 30, N)])
    motion_state = np.concatenate([[9.0, 0.1, -0.1], RNG.normal(size=3) * 0.3, RNG.normal(size=3) * 0.01])[:tail - 6]
    A = RNG.normal(size=(3 * N + tail,) * 2) * 0.1
    return Belief(T, drive.camera.to_world(T, q), np.arange(N), A @ A.T, motion_state)


def true_state(estimate, error, error_state):
    return motion.retract(estimate, error, np.array(estimate.covariance), error_state)


def error_of(estimate, true, error_state):
    return np.concatenate([
        error_state.landmark_difference(true.world_T_imu, estimate.world_T_imu, true.landmarks,
                                        estimate.landmarks).ravel(),
        error_state.pose_difference(true.world_T_imu, estimate.world_T_imu), true.motion - estimate.motion])


def assert_same(analytic, numeric):
    np.testing.assert_allclose(analytic, numeric, atol=1e-6 * max(1.0, np.abs(numeric).max()), rtol=0)


def dense(transition, n, which):
    """F or N of a transition as one matrix over landmarks and tail."""
    tail = getattr(transition, f"{which}_tail")
    top = getattr(transition, f"{which}_landmarks")
    top = np.zeros((n, tail.shape[1])) if top is None else top.reshape(n, -1)
    if which == "N":
        return np.concatenate([top, tail])
    return np.block([[np.eye(n), top], [np.zeros((len(tail), n)), tail]])


@pytest.mark.parametrize("error_state", BOTH)
def test_imu_driven_transition(drive, error_state):
    before = belief(drive)
    k, tau, twist = 5, drive.taus[5], drive.step_twists[5]
    transition = motion.ImuDriven(drive, Noise(), error_state).transition(before, k)
    after = Belief(transition.world_T_imu, before.landmarks, before.ids, before.covariance)

    def moved(error, noise):
        true = true_state(before, error, error_state)
        T = true.world_T_imu @ se3.exp(tau * (twist + noise))
        return error_of(after, Belief(T, true.landmarks, true.ids, before.covariance), error_state)

    d = 3 * N + 6
    assert_same(dense(transition, 3 * N, "F"), central_difference(lambda x: moved(x, 0.0), d))
    assert_same(dense(transition, 3 * N, "N"), central_difference(lambda n: moved(np.zeros(d), n), 6))


@pytest.mark.parametrize("error_state", BOTH)
def test_twist_and_bias_transition(drive, error_state):
    before = belief(drive, tail=15)
    transition = motion.TwistAndBias(drive, Noise(), error_state).transition(before, 5)
    after = Belief(transition.world_T_imu, before.landmarks, before.ids, before.covariance, before.motion)

    def moved(error):
        true = true_state(before, error, error_state)
        T = true.world_T_imu @ se3.exp(drive.taus[5] * true.motion[:6])
        return error_of(after, Belief(T, true.landmarks, true.ids, before.covariance, true.motion), error_state)

    assert_same(dense(transition, 3 * N, "F"), central_difference(moved, 3 * N + 15))


@pytest.mark.parametrize("error_state", BOTH)
@pytest.mark.parametrize(("model", "tail"), [(motion.ImuDriven, 6), (motion.TwistAndBias, 15)])
def test_carry_is_F_P_Ft_plus_N_Q_Nt(drive, error_state, model, tail):
    before = belief(drive, tail)
    transition = model(drive, Noise(), error_state).transition(before, 3)
    F, NN = dense(transition, 3 * N, "F"), dense(transition, 3 * N, "N")
    P = motion.propagate(before, transition).covariance
    np.testing.assert_allclose(P, F @ before.covariance @ F.T + NN @ transition.Q @ NN.T, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


@pytest.mark.parametrize("error_state", BOTH)
def test_measurement_jacobians(drive, error_state):
    estimate = belief(drive)
    settings = window_slam.UpdateSettings(drive.camera, Noise(), error_state, np.inf, 0.0)
    rows = np.array([0, 2, 3])
    H, points = window_slam.linearise(estimate, estimate.ids[rows], settings)
    assert (points[:, 2] > 1).all()

    def seen(error):
        true = true_state(estimate, error, error_state)
        return stereo.reduce_rows(drive.camera.observe(true.world_T_imu, true.landmarks[rows])[0]).ravel()

    assert_same(H.times(np.eye(3 * N + 6)), central_difference(seen, 3 * N + 6))


@pytest.mark.parametrize("error_state", BOTH)
def test_birth(drive, error_state):
    estimate = belief(drive)
    s = RNG.uniform(3, 20, (2, 3))
    G, A = error_state.birth(estimate.world_T_imu, s)
    new = se3.transform(estimate.world_T_imu, s)

    def inherited(error, noise):
        true = true_state(estimate, np.concatenate([np.zeros(3 * N), error]), error_state)
        born = se3.transform(true.world_T_imu, s + noise)
        return error_state.landmark_difference(true.world_T_imu, estimate.world_T_imu, born, new)

    assert_same(G, central_difference(lambda x: inherited(x, np.zeros(3)), 6))
    assert_same(np.broadcast_to(A, (2, 3, 3)), central_difference(lambda n: inherited(np.zeros(6), n), 3))


@pytest.mark.parametrize("error_state", BOTH)
def test_errors_in_metres_for_maps(drive, error_state):
    estimate = belief(drive)

    def metres(error):
        true = true_state(estimate, error, error_state)
        position = true.world_T_imu[:3, 3] - estimate.world_T_imu[:3, 3]
        turn = se3.so3_log(true.world_T_imu[:3, :3] @ estimate.world_T_imu[:3, :3].T)
        return np.concatenate([(true.landmarks - estimate.landmarks).ravel(), position, turn])

    C = error_state.world_landmark(estimate.landmarks)
    C = np.zeros((N, 3, 6)) if C is None else C
    expected = np.block([[np.eye(3 * N), C.reshape(-1, 6)],
                         [np.zeros((6, 3 * N)), error_state.world_pose(estimate.world_T_imu)]])
    assert_same(expected, central_difference(metres, 3 * N + 6))


@pytest.mark.parametrize("error_state", BOTH)
def test_difference_and_retract_are_inverse_for_large_errors(drive, error_state):
    for size in (1e-8, 1e-2, 1.0):
        error = size * RNG.normal(size=3 * N + 6)
        estimate = belief(drive)
        np.testing.assert_allclose(error_of(estimate, true_state(estimate, error, error_state), error_state), error,
                                   atol=1e-10)


@pytest.mark.parametrize("error_state", BOTH)
def test_imu_sample_updates_the_twist_like_a_kalman_filter(drive, error_state):
    """The update of the nine extra states against the plain formula, on a belief without landmarks."""
    model = motion.TwistAndBias(drive, Noise(), error_state)
    before = model.start()
    after = model.measure_imu(before, 0)
    P = np.array(before.covariance)
    P[6:, 6:] += model.walk
    H = np.zeros((6, 15))
    H[:, 6:12], H[3:, 12:] = np.eye(6), np.eye(3)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Noise().twist_covariance)
    np.testing.assert_allclose(after.covariance, (np.eye(15) - K @ H) @ P, atol=1e-10)
    np.testing.assert_allclose(after.motion, (K @ drive.step_twists[0])[6:], atol=1e-10)


def test_twist_and_bias_finds_the_bias():
    """Over seeds: estimate minus truth, in units of the filter's own sigma, is a standard normal."""
    bias, scores = np.array([0.01, -0.008, 0.006]), []
    for seed in range(8):
        drive = simulate.street_loop(seed=seed, frames=150, visible=20, gyro_bias=tuple(bias))
        *_, step = window_slam.run(drive, Noise(), RightInvariant(), motion_model=motion.TwistAndBias)
        sigma = np.sqrt(np.diag(step.posterior.covariance)[-3:])
        assert (sigma < 0.006).all()  # it learned something: the prior is 0.02, one sample 0.05
        scores.append((step.posterior.motion[-3:] - bias) / sigma)
    total = np.sum(np.square(scores))
    assert 8.1 < total < 51.2  # chi2(24) at 0.1 % and 99.9 %


@pytest.mark.parametrize("interface", [ErrorState, motion.MotionModel])
def test_a_class_that_leaves_one_method_out_cannot_be_made(interface):
    """A forgotten method used to return None, which meant "moves nothing", and the NEES went from 7 to 1582."""
    whole = {name: lambda self, *arguments: None for name in interface.__abstractmethods__}
    type("Whole", (interface,), whole)()
    for name in whole:
        partial = {key: method for key, method in whole.items() if key != name}
        with pytest.raises(TypeError, match=name):
            type("Partial", (interface,), partial)()
