"""How the joint belief over map and pose moves from one frame to the next.

>>> from vislam_edu import Noise, RightPerturbation, load, motion
>>> model = motion.ImuDriven(load("first_steps"), Noise(), RightPerturbation())
>>> model.predict(model.start(), 0).pose_covariance.shape
(6, 6)
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from . import se3
from .belief import Belief
from .drive import Drive
from .error_state import ErrorState
from .noise import Noise


def start(noise: Noise, world_T_imu: np.ndarray | None = None, point_shape: tuple[int, ...] = (3,)) -> Belief:
    """The joint belief at frame 0: no landmark, and the world frame is the IMU frame unless a pose is given.

    point_shape : of one landmark, `ErrorState.point_shape`.
    """
    T = np.eye(4) if world_T_imu is None else np.array(world_T_imu, dtype=float)
    return Belief(T, np.empty((0, *point_shape)), np.empty(0, dtype=int), np.array(noise.initial_pose_covariance))


RetractMotion = Callable[[Belief, np.ndarray], np.ndarray]


def add(belief: Belief, delta: np.ndarray) -> np.ndarray:
    """What a motion model estimates beyond the pose, (t,), after an error delta (6+t,), [pose, motion]: a sum."""
    return belief.motion + delta[6:]


def retract(belief: Belief, delta: np.ndarray, covariance: np.ndarray, error_state: ErrorState,
            retract_motion: RetractMotion = add) -> Belief:
    """The belief moved by an estimated error delta (3n+6+t,), with its new covariance.

    retract_motion : `MotionModel.retract_motion` of what moves the car.
    """
    end = belief.pose.stop
    T, points = error_state.retract(belief.world_T_imu, belief.points, delta[:end])
    return Belief(T, points, belief.ids, covariance, retract_motion(belief, delta[end - 6:]))


@dataclass(frozen=True, eq=False)
class Transition:
    """One prediction, linearised: error' = F error + N noise, landmarks first, then the tail [pose, motion].

    Landmarks stand still, so of F only the columns of the tail differ from the identity.

    world_T_imu : (4, 4) pose afterwards. motion : (t,) afterwards.
    F_tail : (6+t, 6+t). F_landmarks : (n, 3, 6+t), zeros where nothing moves a landmark's error.
    N_tail : (6+t, q). N_landmarks : (n, 3, q). Q : (q, q), covariance of the noise.
    """

    world_T_imu: np.ndarray
    motion: np.ndarray
    F_tail: np.ndarray
    F_landmarks: np.ndarray
    N_tail: np.ndarray
    N_landmarks: np.ndarray
    Q: np.ndarray


def symmetric(matrix: np.ndarray) -> np.ndarray:
    """(M + M^T) / 2: takes away what rounding has added to a matrix that is symmetric on paper."""
    return (matrix + matrix.mT) / 2


def propagate(belief: Belief, transition: Transition) -> Belief:
    """The belief after a transition: P' = F P F^T + N Q N^T.

    For the report's error this is Sigma_LL, Sigma_LR F^T and F Sigma_RR F^T + W: the landmarks' own block stays,
    the cross-covariance is carried along on one side, the pose block on both.
    Source: report section 3.3.2, step 2, in its corrected form.
    """
    n = 3 * len(belief.ids)
    P = belief.covariance.copy()
    cross, tail = P[:n, n:], P[n:, n:].copy()
    if transition.F_landmarks.any():
        G = transition.F_landmarks.reshape(n, len(tail))
        X = (cross + G @ tail / 2) @ G.T
        P[:n, :n] += X + X.T
        cross = cross + G @ tail
    P[:n, n:] = cross @ transition.F_tail.T
    P[n:, :n] = P[:n, n:].T
    P[n:, n:] = symmetric(transition.F_tail @ tail @ transition.F_tail.T)
    N = transition.N_tail
    if transition.N_landmarks.any():
        N = np.concatenate([transition.N_landmarks.reshape(n, len(transition.Q)), N])
        P += symmetric(N @ transition.Q @ N.T)
    else:
        P[n:, n:] += symmetric(N @ transition.Q @ N.T)
    return Belief(transition.world_T_imu, belief.points, belief.ids, P, transition.motion)


class MotionModel(ABC):
    """Interface of what moves the car; made of a Drive, a Noise and an `ErrorState`, which it may extend."""

    error_state: ErrorState
    retract_motion: RetractMotion = staticmethod(add)

    @abstractmethod
    def __init__(self, drive: Drive, noise: Noise, error_state: ErrorState) -> None: ...

    @abstractmethod
    def start(self, world_T_imu: np.ndarray | None = None) -> Belief:
        """The belief at frame 0, at the pose (4, 4) given or at the identity."""

    @abstractmethod
    def transition(self, belief: Belief, k: int) -> Transition:
        """From frame k to frame k + 1."""

    def predict(self, belief: Belief, k: int) -> Belief:
        """The belief at frame k + 1 before the camera update, from the one at frame k."""
        return propagate(belief, self.transition(belief, k))

    def second_prediction(self, belief: Belief, k: int) -> Callable[[np.ndarray], tuple[Belief, np.ndarray]] | None:
        """`UpdateSettings.predict_again` for the step from frame k; None where one linearisation is enough."""
        return None


class ImuDriven(MotionModel):
    """The report's motion model: the IMU is the input, its white noise the only thing that moves the error.

    Source: report section 3.3.1.
    """

    def __init__(self, drive: Drive, noise: Noise, error_state: ErrorState) -> None:
        taus = drive.taus[:, None]
        self.error_state = error_state
        self.taus, self.samples = drive.taus, drive.step_twists
        self.increments = se3.exp(taus * drive.step_twists)
        self.body_noise = taus[..., None] * se3.right_jacobian(taus * drive.step_twists)
        self.Q = noise.twist_covariance
        self.noise = noise

    def start(self, world_T_imu: np.ndarray | None = None) -> Belief:
        """The belief at frame 0: the pose alone."""
        return start(self.noise, world_T_imu, self.error_state.point_shape)

    def transition(self, belief: Belief, k: int) -> Transition:
        """From frame k to frame k + 1."""
        after = belief.world_T_imu @ self.increments[k]
        return self._linearised(belief, after, self.increments[k], self.body_noise[k])

    def _linearised(self, belief: Belief, after: np.ndarray, increment: np.ndarray,
                    body_noise: np.ndarray) -> Transition:
        F, B = self.error_state.pose_transition(after, increment, body_noise)
        return Transition(after, belief.motion, F, np.zeros((len(belief.ids), 3, 6)), B,
                          self.error_state.landmark_transition(belief.points, B), self.Q)

    def second_prediction(self, belief: Belief, k: int) -> Callable[[np.ndarray], tuple[Belief, np.ndarray]] | None:
        """`predict_again`, for an error state that is `iterated`."""
        return partial(self.predict_again, belief, k) if self.error_state.iterated else None

    def predict_again(self, belief: Belief, k: int, delta: np.ndarray) -> tuple[Belief, np.ndarray]:
        """`predict`, linearised where a first update (3n+6,) of its result led: along the sample u + n in place of u.

        n is the error of the sample that explains the new pose, eta what is left of the landmarks' own correction.
        Returns the belief there, and the error (3n+6,) that the prior's mean has there: -N n, and -eta.
        """
        first = self.transition(belief, k)
        noise = np.linalg.solve(first.N_tail, delta[-6:])
        eta = delta[:-6] - first.N_landmarks.reshape(-1, 6) @ noise
        there = replace(belief, points=self.error_state.shifted(belief.points, eta.reshape(-1, 3)))
        motion = self.taus[k] * (self.samples[k] + noise)
        increment = se3.exp(motion)
        second = self._linearised(there, belief.world_T_imu @ increment, increment,
                                  self.taus[k] * se3.right_jacobian(motion))
        error = np.concatenate([second.N_landmarks.reshape(-1, 6), second.N_tail]) @ -noise
        error[:-6] -= eta
        return propagate(there, second), error


class TwistAndBias(MotionModel):
    """A motion model fit for a noisy IMU: the car's twist and the gyro's bias are estimated, the IMU measures them.

    A car cannot change its speed by 0.5 m/s from one frame to the next, but one sample of its IMU can be that wrong. So
    the twist is a state, a random walk; the IMU is a noisy measurement of twist + bias; and the pose moves along the
    estimated twist. Nine states join the pose block: motion = [v, omega, gyro bias].

    walk_v, walk_omega : m/s and rad/s per frame, how much the twist may change. walk_bias : rad/s per frame.
    Source: Barfoot, State Estimation for Robotics, section 3.4 (white noise on acceleration as a motion prior).
    """

    start_sigma = np.array([30.0] * 3 + [1.0] * 3 + [0.02] * 3)  # m/s, rad/s, rad/s: a car, before any measurement

    def __init__(self, drive: Drive, noise: Noise, error_state: ErrorState, walk_v: float = 0.2,
                 walk_omega: float = 0.03, walk_bias: float = 1e-5) -> None:
        self.error_state, self.noise = error_state, noise
        self.taus, self.samples = drive.taus, drive.step_twists
        self.walk = np.diag(np.square([walk_v] * 3 + [walk_omega] * 3 + [walk_bias] * 3))
        self.H = np.hstack([np.eye(6), np.eye(6, 3, -3)])  # one IMU sample = twist + [0, bias]

    def start(self, world_T_imu: np.ndarray | None = None) -> Belief:
        """The belief at frame 0: the pose, and a twist of which nothing is known yet."""
        pose = start(self.noise, world_T_imu, self.error_state.point_shape)
        P = np.zeros((15, 15))
        P[:6, :6], P[6:, 6:] = pose.covariance, np.diag(self.start_sigma**2)
        return Belief(pose.world_T_imu, pose.points, pose.ids, P, np.zeros(9))

    def measure_imu(self, belief: Belief, k: int) -> Belief:
        """The belief after the twist has walked one frame and the IMU sample of step k -> k + 1 has been read."""
        P = belief.covariance.copy()
        P[-9:, -9:] += self.walk
        HP = self.H @ P[-9:]
        S = HP[:, -9:] @ self.H.T + self.noise.twist_covariance
        Y = np.linalg.solve(np.linalg.cholesky(S), np.column_stack([HP, self.samples[k] - self.H @ belief.motion]))
        return retract(belief, Y[:, :-1].T @ Y[:, -1], P - Y[:, :-1].T @ Y[:, :-1], self.error_state)

    def transition(self, belief: Belief, k: int) -> Transition:
        """From frame k to frame k + 1 along the estimated twist."""
        tau, twist = self.taus[k], belief.motion[:6]
        increment = se3.exp(tau * twist)
        after = belief.world_T_imu @ increment
        F, B = self.error_state.pose_transition(after, increment, tau * se3.right_jacobian(tau * twist))
        F_tail = np.eye(15)
        F_tail[:6, :6], F_tail[:6, 6:12] = F, B
        moved = np.pad(self.error_state.landmark_transition(belief.points, B), ((0, 0), (0, 0), (6, 3)))
        return Transition(after, belief.motion, F_tail, moved, np.zeros((15, 0)), np.zeros((len(moved), 3, 0)),
                          np.zeros((0, 0)))

    def predict(self, belief: Belief, k: int) -> Belief:
        """The belief at frame k + 1 before the camera update."""
        return super().predict(self.measure_imu(belief, k), k)
