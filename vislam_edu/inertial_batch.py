"""The whole drive at once with a real IMU: the batch estimate with a velocity and two biases in each frame.

    problem = inertial_batch.Problem(drive, noise, begin=inertial.initial(drive, noise))
    solution = batch.solve(problem)
    solution.estimate.motion          # (T, 9): velocity, gyro bias, accelerometer bias

Between two frames stands one preintegrated motion (`imu.residual`), however many samples it joins, so a frame is a
keyframe: a drive with fewer of them costs less. Columns are ordered [frames 15T, landmarks 3M], a frame's as the
filter's tail, [pose as a right perturbation, velocity, gyro bias, accelerometer bias].

Source: Forster et al., On-manifold preintegration for real-time visual-inertial odometry, 2017.

>>> np.arange(15)[FROM_IMU].tolist()
[3, 4, 5, 0, 1, 2, 6, 7, 8, 9, 10, 11, 12, 13, 14]
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np
from scipy.sparse import bsr_array, vstack

from . import batch, imu, inertial, se3
from .imu import State
from .normal_equations import block_rows

FROM_IMU = np.r_[3:6, 0:3, 6:15]  # columns of `imu`, [R, p, v, b_g, b_a], in the order of a frame


@dataclass(frozen=True, eq=False)
class Estimate(batch.Estimate):
    """One value of all unknowns. motion : (T, 9) of the frames, velocity (m/s, world), gyro and accelerometer bias."""

    motion: np.ndarray = field(default_factory=lambda: np.zeros((0, 9)))

    def retract(self, delta: np.ndarray, anchor: np.ndarray) -> Estimate:
        """The estimate after a step delta (15T + 3M + 4 + L,): T exp(epsilon^), and sums. anchor is not used."""
        T, M = len(self.world_T_imu), self.landmarks.size
        frames = delta[:15 * T].reshape(T, 15)
        return replace(self, world_T_imu=self.world_T_imu @ se3.exp(frames[:, :6]), motion=self.motion + frames[:, 6:],
                       landmarks=self.landmarks + delta[15 * T:15 * T + M].reshape(-1, 3),
                       lens=self.lens + delta[15 * T + M + 4:])

    @property
    def states(self) -> list[State]:
        """The frames as states of `imu`."""
        return [State(T[:3, :3], T[:3, 3], *np.split(values, 3)) for T, values in zip(self.world_T_imu, self.motion)]


@dataclass(frozen=True, eq=False)
class Problem(batch.Problem):
    """What is to be minimised for a drive with samples, `Drive.imu`.

    begin : `imu.State` at frame 0 and its covariance (15, 15), the prior; `inertial.initial` finds them.
    The other fields are those of `batch.Problem`, of which walk_sigma, imu_sigma and prior_world_T_imu are not used.
    """

    size: ClassVar[int] = 15
    begin: tuple[State, np.ndarray] = field(kw_only=True)

    @cached_property
    def motions(self) -> list[imu.Preintegrated]:
        """The T-1 motions between the frames, for the biases of `begin`."""
        samples, state = inertial.samples_of(self.drive), self.begin[0]
        return [imu.preintegrate(*samples.between(*ends), state.gyro_bias, state.accelerometer_bias, samples.noise)
                for ends in pairwise(self.drive.times)]

    def motion_residuals(self, estimate: batch.Estimate) -> tuple[np.ndarray, bsr_array, np.ndarray]:
        """All residuals without a landmark: prior on frame 0, motions. Each is divided by its standard deviation.

        Returns r (15T,), its derivative by the frames, sparse (15T, 15T), and zeros (15T, 4): no constants.
        """
        assert isinstance(estimate, Estimate)
        states, T = estimate.states, self.drive.n_frames
        e0 = states[0].difference(self.begin[0])
        by_first = np.eye(15)
        by_first[imu.ROTATION, imu.ROTATION] = se3.so3_left_jacobian_inverse(-e0[imu.ROTATION])
        found = [imu.residual(*ends, motion) for ends, motion in zip(pairwise(states), self.motions)]
        r, before, after = (np.array(each) for each in zip(*found))
        whiten = np.linalg.inv(np.linalg.cholesky([self.begin[1], *(motion.covariance for motion in self.motions)]))
        R = estimate.world_T_imu[:, :3, :3]
        J = vstack([block_rows(T, whiten[:1] @ _of_frames(by_first[None], R[:1])),
                    block_rows(T, whiten[1:] @ _of_frames(before, R[:-1]), whiten[1:] @ _of_frames(after, R[1:]))],
                   format="bsr")
        return np.matvec(whiten, np.concatenate([e0[None], r])).ravel(), J, np.zeros((15 * T, 4))

    def dead_reckoned(self) -> np.ndarray:
        """(T, 4, 4): the poses that the IMU alone says, from `begin` on."""
        return inertial.dead_reckon(self.drive, self.noise, self.begin).world_T_imu

    def at(self, world_T_imu: np.ndarray) -> Estimate:
        """As in `batch.Problem`; velocities are those of the poses, biases those of `begin`."""
        state, plain = self.begin[0], super().at(world_T_imu)
        velocity = np.gradient(world_T_imu[:, :3, 3], self.drive.times, axis=0)
        biases = np.tile(np.concatenate([state.gyro_bias, state.accelerometer_bias]), (len(velocity), 1))
        return Estimate(plain.world_T_imu, plain.landmarks, plain.imu, plain.lens, np.hstack([velocity, biases]))


def _of_frames(J: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Derivatives (n, 15, 15) by states of `imu` as those by frames, whose position error is R^T (p - p_hat)."""
    J = J[..., FROM_IMU]
    J[..., :3] = J[..., :3] @ R
    return J
