"""The real IMU: every derivative against differences, preintegration against integration."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numerical import central_difference
from scipy.spatial.transform import Rotation

from vislam_edu import imu, se3

EUROC = Path(__file__).resolve().parents[3] / "shared" / "data" / "euroc_v101" / "imu_and_truth.npz"


@pytest.fixture
def state():
    rng = np.random.default_rng(1)
    return imu.State(se3.so3_exp([0.4, -1.0, 2.0]), *rng.normal(0, 3, (2, 3)), *rng.normal(0, 0.1, (2, 3)))


@pytest.fixture
def samples():
    rng = np.random.default_rng(2)
    return rng.normal(0, 1, (40, 3)), rng.normal(0, 5, (40, 3)) + [0, 0, 9.8], rng.uniform(0.004, 0.006, 40)


def integrate(state, gyro, accelerometer, taus):
    for sample in zip(gyro, accelerometer, taus):
        state = imu.propagate(state, *sample)
    return state


def motion_alone(gyro, accelerometer, taus):
    """The motion alone: propagation from the identity without gravity."""
    state = imu.State.at_rest()
    for sample in zip(gyro, accelerometer, taus):
        state = imu.propagate(state, *sample, gravity=np.zeros(3))
    return state


def close(a, b, tolerance=1e-6):
    return np.abs(a - b).max() <= tolerance * np.abs(b).max()


def test_jacobians_of_one_sample(state):
    gyro, accelerometer, tau = np.array([1.0, -2.0, 0.7]), np.array([3.0, -4.0, 8.0]), 0.05
    after = imu.propagate(state, gyro, accelerometer, tau)
    F, N = imu.jacobians(state.rotation, gyro - state.gyro_bias, accelerometer - state.accelerometer_bias, tau)
    by_error = central_difference(
        lambda e: imu.propagate(state.retract(e), gyro, accelerometer, tau).difference(after), 15)
    by_noise = central_difference(
        lambda n: imu.propagate(state, gyro - n[:3], accelerometer - n[3:], tau).difference(after), 6)
    assert close(F, by_error)
    assert close(N[:, :6], by_noise)
    assert np.array_equal(N[:, 6:], np.eye(15)[:, 9:])


def test_a_preintegrated_motion_is_the_integrated_one(state, samples):
    motion = imu.preintegrate(*samples, state.gyro_bias, state.accelerometer_bias)
    assert np.abs(imu.predict(state, motion).difference(integrate(state, *samples))).max() < 1e-12


def test_transition_is_the_product_of_the_samples(state, samples):
    motion = imu.preintegrate(*samples, state.gyro_bias, state.accelerometer_bias)
    F, Q = imu.transition(state.rotation, motion)
    product, covariance, walking = np.eye(15), np.zeros((15, 15)), state
    for gyro, accelerometer, tau in zip(*samples):
        omega, force = gyro - state.gyro_bias, accelerometer - state.accelerometer_bias
        F_k, N_k = imu.jacobians(walking.rotation, omega, force, tau)
        product = F_k @ product
        covariance = F_k @ covariance @ F_k.T + N_k @ imu.ADIS16448.covariance(tau) @ N_k.T
        walking = imu.propagate(walking, gyro, accelerometer, tau)
    assert close(F, product, 1e-12)
    assert close(Q, covariance, 1e-12)


def test_bias_jacobians(state, samples):
    at = np.concatenate([state.gyro_bias, state.accelerometer_bias])
    motion = imu.preintegrate(*samples, at[:3], at[3:])

    def moved(change):
        other = imu.preintegrate(*samples, *np.split(at + change, 2))
        return np.concatenate([se3.so3_log(motion.rotation.T @ other.rotation), other.position, other.velocity])

    assert close(motion.bias_jacobian, central_difference(moved, 6))


def test_correction_is_right_to_second_order(state, samples):
    motion = imu.preintegrate(*samples, state.gyro_bias, state.accelerometer_bias)
    change = np.array([0.02, -0.01, 0.03]), np.array([0.1, 0.2, -0.1])

    def error(scale):
        biases = state.gyro_bias + scale * change[0], state.accelerometer_bias + scale * change[1]
        corrected, again = imu.correct(motion, *biases), imu.preintegrate(*samples, *biases)
        return np.linalg.norm(corrected.position - again.position)

    assert error(1.0) / error(0.5) == pytest.approx(4.0, rel=0.05)


def test_residual_is_zero_where_the_samples_lead(state, samples):
    motion = imu.preintegrate(*samples, state.gyro_bias, state.accelerometer_bias)
    assert np.abs(imu.residual(state, integrate(state, *samples), motion)[0]).max() < 1e-12


def test_jacobians_of_the_residual(state, samples):
    motion = imu.preintegrate(*samples, state.gyro_bias + 0.02, state.accelerometer_bias - 0.1)
    after = integrate(state, *samples).retract(np.random.default_rng(3).normal(0, 0.2, 15))
    _, by_before, by_after = imu.residual(state, after, motion)
    assert close(by_before, central_difference(lambda e: imu.residual(state.retract(e), after, motion)[0], 15))
    assert close(by_after, central_difference(lambda e: imu.residual(state, after.retract(e), motion)[0], 15))


def test_covariance_against_samples(state, samples):
    """The Mahalanobis distance of 500 noisy runs: a mean of 15, whose standard deviation is sqrt(30 / 500) = 0.245."""
    gyro, accelerometer, taus = samples
    noise = imu.ImuNoise(1e-3, 1e-2, 1e-3, 1e-2)  # biases walk enough to be seen in 0.2 s
    motion = imu.preintegrate(gyro, accelerometer, taus, np.zeros(3), np.zeros(3), noise)
    rng = np.random.default_rng(4)
    distances = []
    for _ in range(500):
        draws = np.array([np.sqrt(noise.covariance(tau).diagonal()) for tau in taus]) * rng.standard_normal((40, 12))
        biases = np.cumsum(draws[:, 6:], axis=0) - draws[:, 6:]
        true = gyro - draws[:, :3] - biases[:, :3], accelerometer - draws[:, 3:6] - biases[:, 3:]
        real = motion_alone(*true, taus)
        error = np.concatenate([se3.so3_log(motion.rotation.T @ real.rotation), real.position - motion.position,
                                real.velocity - motion.velocity, draws[:, 6:].sum(axis=0)])
        distances.append(error @ np.linalg.solve(motion.covariance, error))
    assert 15 - 3 * 0.245 < np.mean(distances) < 15 + 3 * 0.245


def test_datasheet_units():
    noise = imu.ImuNoise.from_datasheet(0.6, 0.12, 1e-5, 1e-4)
    assert noise.gyro_density == pytest.approx(np.deg2rad(0.01))
    assert noise.accelerometer_density == pytest.approx(0.002)
    # over a second: the walk of an angle is the density, whatever the rate
    assert 200 * 0.005**2 * noise.covariance(0.005)[0, 0] == pytest.approx(noise.gyro_density**2)


def test_a_stand_still_finds_what_it_can():
    """Tilt and bias over 300 drawn starts: their errors have the covariance that is claimed."""
    rng = np.random.default_rng(5)
    taus, noise, sigma = np.full(200, 0.005), imu.ImuNoise(1e-3, 1e-2, 0.0, 0.0), 0.1
    errors = []
    for _ in range(300):
        true = imu.State(Rotation.from_euler("yx", [0.5, -0.8]).as_matrix(), np.zeros(3), np.zeros(3),
                         rng.normal(0, 0.05, 3), rng.normal(0, sigma, 3))
        white = np.sqrt(noise.covariance(0.005).diagonal()[:6]) * rng.standard_normal((200, 6))
        gyro = true.gyro_bias + white[:, :3]
        accelerometer = true.rotation.T @ -imu.GRAVITY + true.accelerometer_bias + white[:, 3:]
        estimate, P = imu.stand_still(gyro, accelerometer, taus, noise, sigma)
        turn = true.rotation @ estimate.rotation.T  # the heading names the world: it is no error
        yaw = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        error = replace(true, rotation=se3.so3_exp([0, 0, -yaw]) @ true.rotation).difference(estimate)
        errors.append(error @ np.linalg.pinv(P, rcond=1e-9) @ error)
    assert np.linalg.matrix_rank(P, tol=1e-12) == 8
    assert 8 - 3 * (16 / 300)**0.5 < np.mean(errors) < 8 + 3 * (16 / 300)**0.5


@pytest.mark.skipif(not EUROC.exists(), reason="no EuRoC recording beside the project")
def test_real_samples_with_true_biases():
    """EuRoC V1_01: over one second, 3 cm and 0.15 degrees at most (median)."""
    recording = np.load(EUROC)
    t = recording["truth_time_ns"]
    first = np.searchsorted(recording["imu_time_ns"], t)
    R = Rotation.from_quat(recording["world_q_imu_wxyz"], scalar_first=True).as_matrix()
    errors = []
    for k in range(0, len(t) - 20, 10):
        rows = slice(first[k], first[k + 20])
        taus = np.diff(recording["imu_time_ns"][first[k]:first[k + 20] + 1]) / 1e9
        state = imu.State(R[k], recording["world_p_imu"][k], recording["world_v_imu"][k], recording["gyro_bias"][k],
                          recording["accelerometer_bias"][k])
        motion = imu.preintegrate(recording["gyro"][rows], recording["accelerometer"][rows], taus, state.gyro_bias,
                                  state.accelerometer_bias)
        end = imu.predict(state, motion)
        errors.append([np.linalg.norm(end.position - recording["world_p_imu"][k + 20]),
                       np.rad2deg(np.linalg.norm(se3.so3_log(R[k + 20].T @ end.rotation)))])
    metres, degrees = np.median(errors, axis=0)
    assert metres < 0.03
    assert degrees < 0.15


def test_the_rule_of_integration_is_of_second_order(monkeypatch):
    """The force of a sample acts in the attitude halfway: samples cut in two bring a quarter of the error."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
    import gtsam_imu

    def velocity(parts):
        return imu.preintegrate(*gtsam_imu.cut(gtsam_imu.tumbling(), parts), np.zeros(3), np.zeros(3)).velocity

    limit = velocity(64)
    np.testing.assert_allclose(velocity(2) - limit, (velocity(1) - limit) / 4, rtol=0.02)


def test_gtsam_joins_the_same_samples_to_the_same_motion(monkeypatch):
    """The two differ by where in a step the force acts, and by nothing else: cut into 16, by a sixteenth."""
    pytest.importorskip("gtsam", reason="the outside reference is an extra: pip install vislam_edu[gtsam]")
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
    import gtsam_imu

    noise = imu.ImuNoise(gyro_walk=0.0, accelerometer_walk=0.0)
    biases = np.array([0.01, 0.02, -0.01]), np.array([0.1, 0.05, -0.2])
    whole, cut = (gtsam_imu.compare(gtsam_imu.cut(gtsam_imu.tumbling(), parts), *biases, noise) for parts in (1, 16))
    assert whole["difference_sigma"] < 6
    assert whole["covariance"] < 0.004
    assert whole["corrected_m"] < 0.012
    assert all(cut[key] == pytest.approx(whole[key] / 16, rel=0.1) for key in whole)
