"""A real IMU: gyro, accelerometer, gravity and two biases.

No IMU measures a velocity. A gyro measures the body's rotation rate, an accelerometer its specific force (acceleration
minus gravity), both in the IMU frame, both with white noise and with a bias that drifts:

    gyro = omega + b_g + n_g        accelerometer = R^T (a_world - g) + b_a + n_a

So the state is R, p, v, b_g, b_a, **in this order everywhere in this file**, 15 numbers of error:
R_true = R exp(theta^) in the IMU frame; p, v (world frame), b_g and b_a (IMU frame) are true minus estimate. The world
has z up, so that g = `GRAVITY`.

`propagate` moves a state by one sample. `preintegrate` joins many samples into one motion, which needs no state: it
is `propagate` from the identity, without gravity. `transition` is that motion as the prediction of a filter,
`residual` as a factor of a batch estimate.

Sources: Forster et al., On-manifold preintegration for real-time visual-inertial odometry, 2017; Solà, Quaternion
kinematics for the error-state Kalman filter, 2017, chapter 5; the IMU noise model of Kalibr.

>>> import numpy as np
>>> still = State.at_rest()
>>> moved = propagate(still, np.zeros(3), np.array([1.0, 0.0, 9.81]), tau=0.1)
>>> moved.velocity.round(6).tolist()
[0.1, 0.0, 0.0]
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .se3 import chain, so3_exp, so3_hat, so3_left_jacobian_inverse, so3_log, so3_right_jacobian

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2, world frame
GRAVITY.setflags(write=False)

ROTATION, POSITION, VELOCITY, GYRO_BIAS, ACCELEROMETER_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))
BIASES = slice(9, 15)


@dataclass(frozen=True)
class ImuNoise:
    """What a datasheet, or an Allan variance, says about an IMU. The defaults are those of an ADIS16448 (EuRoC).

    gyro_density : rad/s/sqrt(Hz), white noise of the gyro; the same number in rad/sqrt(s) is its angle random walk.
    accelerometer_density : m/s^2/sqrt(Hz), white noise of the accelerometer; its velocity random walk.
    gyro_walk : rad/s^2/sqrt(Hz), random walk of the gyro's bias. accelerometer_walk : m/s^3/sqrt(Hz), the other's.
    """

    gyro_density: float = 1.6968e-4
    accelerometer_density: float = 2.0e-3
    gyro_walk: float = 1.9393e-5
    accelerometer_walk: float = 3.0e-3

    @classmethod
    def from_datasheet(cls, angle_random_walk: float, velocity_random_walk: float, gyro_walk: float,
                       accelerometer_walk: float) -> ImuNoise:
        """The noise from a datasheet's units.

        angle_random_walk : degrees per root hour. velocity_random_walk : m/s per root hour. The walks of the biases as
        in `ImuNoise`: a datasheet gives a bias instability instead, which is no random walk; Kalibr's users measure.
        """
        root_hour = 3600.0**0.5
        return cls(np.deg2rad(angle_random_walk) / root_hour, velocity_random_walk / root_hour, gyro_walk,
                   accelerometer_walk)

    def covariance(self, tau: float) -> np.ndarray:
        """Q (12, 12) of one sample that lasts `tau` seconds: [gyro, accelerometer, steps of both biases].

        A sample is the mean of white noise over tau, so its variance is density^2 / tau; a bias walks by walk^2 tau.
        """
        white = np.square([self.gyro_density, self.accelerometer_density]) / tau
        walk = np.square([self.gyro_walk, self.accelerometer_walk]) * tau
        return np.diag(np.repeat([*white, *walk], 3))


ADIS16448 = ImuNoise()


@dataclass(frozen=True, eq=False)
class State:
    """R (3, 3) = world_R_imu, position (3,) m and velocity (3,) m/s in the world, biases (3,) rad/s and m/s^2."""

    rotation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    gyro_bias: np.ndarray
    accelerometer_bias: np.ndarray

    @classmethod
    def at_rest(cls) -> State:
        """At the origin, upright, without velocity and biases."""
        return cls(np.eye(3), *np.zeros((4, 3)))

    def retract(self, delta: np.ndarray) -> State:
        """The state moved by an error delta (15,)."""
        return State(self.rotation @ so3_exp(delta[ROTATION]), self.position + delta[POSITION],
                     self.velocity + delta[VELOCITY], self.gyro_bias + delta[GYRO_BIAS],
                     self.accelerometer_bias + delta[ACCELEROMETER_BIAS])

    def difference(self, estimate: State) -> np.ndarray:
        """The error (15,) of an estimate of this state."""
        return np.concatenate([so3_log(estimate.rotation.T @ self.rotation), self.position - estimate.position,
                               self.velocity - estimate.velocity, self.gyro_bias - estimate.gyro_bias,
                               self.accelerometer_bias - estimate.accelerometer_bias])


def propagate(state: State, gyro: np.ndarray, accelerometer: np.ndarray, tau: float,
              gravity: np.ndarray = GRAVITY) -> State:
    """The state after one sample, gyro (3,) rad/s and accelerometer (3,) m/s^2, that lasts `tau` seconds.

    The specific force acts in the attitude halfway through the step: v' = v + (R exp(tau omega^ / 2) f + g) tau.
    """
    omega, force = gyro - state.gyro_bias, accelerometer - state.accelerometer_bias
    change = (state.rotation @ so3_exp(tau * omega / 2) @ force + gravity) * tau
    return replace(state, rotation=state.rotation @ so3_exp(tau * omega), velocity=state.velocity + change,
                   position=state.position + tau * (state.velocity + change / 2))


def jacobians(rotation: np.ndarray, omega: np.ndarray, force: np.ndarray,
              tau: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """F (..., 15, 15) and N (..., 15, 12) of `propagate`: error' = F error + N [n_g, n_a, steps of both biases].

    rotation (..., 3, 3) before the step; omega, force (..., 3), the samples minus the biases; tau (...,), s. Neither
    gravity, position nor velocity appears: all three enter the motion by addition.
    An error of a bias and the noise of the sample are subtracted from the sample alike, so their columns are one.
    """
    t = np.asarray(tau)[..., None, None]
    half = t[..., 0] * omega / 2
    turned = rotation @ so3_exp(half)
    zero = np.zeros_like(turned)
    # the change of velocity, by theta, b_g and b_a
    by_theta = -t * rotation @ so3_hat(np.matvec(so3_exp(half), force))
    by_gyro = t**2 / 2 * turned @ so3_hat(force) @ so3_right_jacobian(half)
    dv = np.concatenate([by_theta, zero, zero, by_gyro, -t * turned], axis=-1)
    F = np.broadcast_to(np.eye(15), (*omega.shape[:-1], 15, 15)).copy()
    F[..., ROTATION, ROTATION] = so3_exp(-2 * half)
    F[..., ROTATION, GYRO_BIAS] = -t * so3_right_jacobian(2 * half)
    F[..., VELOCITY, :] += dv
    F[..., POSITION, :] += t / 2 * dv
    F[..., POSITION, VELOCITY] += t * np.eye(3)
    N = np.zeros((*omega.shape[:-1], 15, 12))
    N[..., :9, :6] = F[..., :9, BIASES]
    N[..., 9:, 6:] = np.eye(6)
    return F, N


@dataclass(frozen=True, eq=False)
class Preintegrated:
    """Samples of `duration` seconds joined into one motion, seen from the IMU frame at their start, without gravity.

    rotation (3, 3); position (3,), m; velocity (3,), m/s.
    gyro_bias, accelerometer_bias : (3,), those it was made with.
    covariance : (15, 15) of its error [R, p, v] and of the biases' walk. bias_jacobian : (9, 6), the derivative of
    [R, p, v] by [b_g, b_a], that of R as a right perturbation.
    """

    duration: float
    rotation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    gyro_bias: np.ndarray
    accelerometer_bias: np.ndarray
    covariance: np.ndarray
    bias_jacobian: np.ndarray


def preintegrate(gyro: np.ndarray, accelerometer: np.ndarray, taus: np.ndarray, gyro_bias: np.ndarray,
                 accelerometer_bias: np.ndarray, noise: ImuNoise = ADIS16448) -> Preintegrated:
    """n samples (n, 3), rad/s and m/s^2, that last taus (n,) s each, as one motion, for biases (3,) taken as known.

    Source: Forster et al., 2017, sections V and VI; the covariance and the derivatives by the biases are products of
    the F of each sample.
    """
    omega, force = gyro - gyro_bias, accelerometer - accelerometer_bias
    steps = so3_exp(taus[:, None] * omega)
    rotations = chain(np.eye(3), steps)
    F, N = jacobians(rotations[:-1], omega, force, taus)
    changes = taus[:, None] * np.matvec(rotations[:-1] @ so3_exp(taus[:, None] * omega / 2), force)
    velocities = np.concatenate([np.zeros((1, 3)), np.cumsum(changes, axis=0)])
    position = taus @ (velocities[:-1] + changes / 2)
    Phi, P = np.eye(15), np.zeros((15, 15))
    for F_k, N_k, tau in zip(F, N, taus):
        Phi = F_k @ Phi
        P = F_k @ P @ F_k.T + N_k @ noise.covariance(tau) @ N_k.T
    return Preintegrated(float(taus.sum()), rotations[-1], position, velocities[-1], np.asarray(gyro_bias),
                         np.asarray(accelerometer_bias), P, Phi[:9, BIASES])


def correct(motion: Preintegrated, gyro_bias: np.ndarray, accelerometer_bias: np.ndarray) -> Preintegrated:
    """The motion for other biases (3,), to first order in their change: no sample is integrated again."""
    change = np.concatenate([gyro_bias - motion.gyro_bias, accelerometer_bias - motion.accelerometer_bias])
    moved = motion.bias_jacobian @ change
    return replace(motion, rotation=motion.rotation @ so3_exp(moved[ROTATION]),
                   position=motion.position + moved[POSITION], velocity=motion.velocity + moved[VELOCITY])


def predict(state: State, motion: Preintegrated) -> State:
    """The state after the motion, as `propagate` gives it after all samples, if it was made with the state's biases."""
    t, R = motion.duration, state.rotation
    return replace(state, rotation=R @ motion.rotation, velocity=state.velocity + t * GRAVITY + R @ motion.velocity,
                   position=state.position + t * state.velocity + t**2 / 2 * GRAVITY + R @ motion.position)


def transition(rotation: np.ndarray, motion: Preintegrated) -> tuple[np.ndarray, np.ndarray]:
    """F (15, 15) and the noise covariance (15, 15) of `predict`, for a state of this rotation (3, 3)."""
    F = np.eye(15)
    F[ROTATION, ROTATION] = motion.rotation.T
    F[POSITION, ROTATION] = -rotation @ so3_hat(motion.position)
    F[VELOCITY, ROTATION] = -rotation @ so3_hat(motion.velocity)
    F[POSITION, VELOCITY] = motion.duration * np.eye(3)
    turn = np.eye(15)  # position and velocity of the motion, and their noise, are in the IMU frame at the start
    turn[POSITION, POSITION] = turn[VELOCITY, VELOCITY] = rotation
    F[:9, BIASES] = turn[:9, :9] @ motion.bias_jacobian
    return F, turn @ motion.covariance @ turn.T


def residual(before: State, after: State, motion: Preintegrated) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What two states say about a motion minus what the samples say, (15,), of covariance `motion.covariance`.

    Order [R, p, v, b_g, b_a]; the last two are the walk of the biases. Returns it and its derivatives (15, 15) by the
    errors of the state before and of the one after.
    Source: Forster et al., 2017, section VI and appendix C.
    """
    t, Rt = motion.duration, before.rotation.T
    expected = correct(motion, before.gyro_bias, before.accelerometer_bias)
    position = Rt @ (after.position - before.position - t * before.velocity - t**2 / 2 * GRAVITY)
    velocity = Rt @ (after.velocity - before.velocity - t * GRAVITY)
    turn = so3_log(expected.rotation.T @ Rt @ after.rotation)
    r = np.concatenate([turn, position - expected.position, velocity - expected.velocity,
                        after.gyro_bias - before.gyro_bias, after.accelerometer_bias - before.accelerometer_bias])

    by_turn = so3_left_jacobian_inverse(-turn)  # of log(exp(turn^) exp(d^)) by d
    by_before, by_after = -np.eye(15), np.eye(15)
    by_before[ROTATION, ROTATION] = -by_turn @ after.rotation.T @ before.rotation
    by_before[POSITION, ROTATION], by_before[POSITION, POSITION] = so3_hat(position), -Rt
    by_before[POSITION, VELOCITY] = -t * Rt
    by_before[VELOCITY, ROTATION], by_before[VELOCITY, VELOCITY] = so3_hat(velocity), -Rt
    by_before[:9, BIASES] = -motion.bias_jacobian
    change = motion.bias_jacobian[ROTATION, :3] @ (before.gyro_bias - motion.gyro_bias)
    by_before[ROTATION, GYRO_BIAS] = (-by_turn @ so3_exp(-turn) @ so3_right_jacobian(change)
                                      @ motion.bias_jacobian[ROTATION, :3])
    by_after[ROTATION, ROTATION] = by_turn
    by_after[POSITION, POSITION] = by_after[VELOCITY, VELOCITY] = Rt
    return r, by_before, by_after


def upright(up: np.ndarray) -> np.ndarray:
    """(3, 3): the shortest turn that takes the unit vector `up` (3,), IMU frame, to the z axis of the world."""
    turn = np.cross(up, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(turn)
    return so3_exp(turn * (np.arctan2(sine, up[2]) / sine if sine > 0 else 1.0))


def stand_still(gyro: np.ndarray, accelerometer: np.ndarray, taus: np.ndarray, noise: ImuNoise = ADIS16448,
                bias_sigma: float = 0.1) -> tuple[State, np.ndarray]:
    """State and covariance (15, 15) after samples (n, 3) of an IMU that does not move, of taus (n,) s.

    bias_sigma : m/s^2, what the accelerometer's bias may be. Position and heading start at zero, without uncertainty:
    they name the world. The gyro's mean is its bias. The accelerometer's mean shows where up is: roll and pitch; what
    its length differs from g is the bias along up. A bias across it looks the same as a tilt of bias / g radians, and
    the covariance says so.
    """
    up = accelerometer.mean(axis=0)
    length, g = np.linalg.norm(up), np.linalg.norm(GRAVITY)
    up = up / length
    state = replace(State.at_rest(), rotation=upright(up), gyro_bias=gyro.mean(axis=0),
                    accelerometer_bias=(length - g) * up)

    white = noise.covariance(taus.sum()).diagonal()
    across = np.eye(3) - np.outer(up, up)
    P = np.zeros((15, 15))
    P[GYRO_BIAS, GYRO_BIAS] = white[0] * np.eye(3) + noise.gyro_walk**2 * taus.sum() / 3 * np.eye(3)
    bias = np.zeros((15, 3))  # tilt = up^ b_a / g, and b_a itself
    bias[ROTATION], bias[ACCELEROMETER_BIAS] = so3_hat(up) / g, across
    P += bias_sigma**2 * bias @ bias.T
    spread = white[3] + noise.accelerometer_walk**2 * taus.sum() / 3
    P[ROTATION, ROTATION] += spread * so3_hat(up) @ so3_hat(up).T / g**2
    P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] += spread * np.outer(up, up)
    return state, P
