"""Where the car is, from the IMU alone and against a map that is known: the Gaussian on SE(3) at work.

>>> from vislam_edu import Noise, load, odometry
>>> odometry.dead_reckon(load("first_steps"), Noise()).world_T_imu.shape
(60, 4, 4)
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from . import kalman, se3
from .belief import Innovation, Step
from .drive import Drive
from .noise import Noise
from .stereo import StereoCamera


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """A Gaussian on SE(3): T = world_T_imu exp(epsilon^), epsilon ~ N(0, covariance).

    world_T_imu : (4, 4). covariance : (6, 6), order [position m, rotation rad], in the body frame.
    Source: report section 3.3.1.
    """

    world_T_imu: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses through time with their covariances (right perturbation).

    times : (T,) s. world_T_imu : (T, 4, 4). covariance : (T, 6, 6).
    """

    times: np.ndarray
    world_T_imu: np.ndarray
    covariance: np.ndarray


def predict(belief: PoseBelief, twist: np.ndarray, tau: float, noise: Noise) -> PoseBelief:
    """EKF prediction: the pose moves along its twist, the covariance is carried along and grows.

    belief : PoseBelief. twist : (6,) [v, omega], m/s and rad/s. tau : s. noise : Noise.

    mean        T exp(tau u^)
    covariance  F P F^T + B Q B^T,  F = Ad(exp(-tau u^)) = exp(-tau u_curly),  B = tau J_r(tau u)

    Q is the covariance of one IMU sample. The report adds W = tau^2 Q, that is, it takes the right Jacobian J_r
    for the identity; the difference is a few per cent of W in a bend.
    Source: report section 3.3.1; Barfoot, State Estimation for Robotics, sections 7.2 and 8.
    """
    step = se3.exp(tau * np.asarray(twist))
    F = se3.adjoint(se3.inverse(step))
    B = tau * se3.right_jacobian(tau * np.asarray(twist))
    P = F @ belief.covariance @ F.T + B @ noise.twist_covariance @ B.T
    return PoseBelief(belief.world_T_imu @ step, P)


def start(noise: Noise, world_T_imu: np.ndarray | None = None) -> PoseBelief:
    """The belief at frame 0: the world frame is the IMU frame there, unless a pose (4, 4) is given."""
    return PoseBelief(np.eye(4) if world_T_imu is None else np.asarray(world_T_imu, float),
                      noise.initial_pose_covariance)


def dead_reckon(drive: Drive, noise: Noise, world_T_imu: np.ndarray | None = None) -> Trajectory:
    """The IMU integrated with nothing to correct it, and how little it then knows.

    drive : Drive. noise : Noise. world_T_imu : (4, 4) pose at frame 0, the identity by default.
    Returns a Trajectory of all T frames.
    Source: report section 3.1 and figure 1.
    """
    beliefs = [start(noise, world_T_imu)]
    for twist, tau in zip(drive.step_twists, drive.taus):
        beliefs.append(predict(beliefs[-1], twist, tau, noise))
    return Trajectory(drive.times,
                      np.array([b.world_T_imu for b in beliefs]), np.array([b.covariance for b in beliefs]))


def observe(prior: PoseBelief, camera: StereoCamera, noise: Noise, ids: np.ndarray, pixels: np.ndarray,
            landmarks: np.ndarray, threshold: float) -> tuple[PoseBelief, Innovation]:
    """EKF update of the pose against landmarks whose positions are known.

    prior : PoseBelief. ids : (n,). pixels : (n, 4). landmarks : (n, 3), m, world.
    threshold : largest NIS of a measurement that is believed.
    Returns (posterior PoseBelief, Innovation).
    Source: report section 3.3.1, observation model with T_t^-1.
    """
    predicted, in_front = camera.observe(prior.world_T_imu, landmarks)
    H = camera.pose_jacobian(prior.world_T_imu, landmarks)
    S = kalman.innovation_covariance(prior.covariance, H, noise.pixel_covariance)
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    accepted = in_front & (nis <= threshold)
    innovation = Innovation(ids, pixels, predicted, S, nis, accepted)
    if not accepted.any():
        return prior, innovation
    # The accepted measurements as one long vector: S = H P H^T + I (x) V, the report's Kronecker product.
    delta, P = kalman.update(prior.covariance, H[accepted].reshape(-1, 6),
                             noise.sigma_px**2 * np.eye(4 * accepted.sum()),
                             innovation.residual[accepted].ravel())
    return PoseBelief(prior.world_T_imu @ se3.exp(delta), P), innovation


def localize(drive: Drive, noise: Noise, landmarks: np.ndarray, gate: float = 0.99,
             world_T_imu: np.ndarray | None = None) -> Iterator[Step]:
    """Visual-inertial odometry on a known map: predict with the IMU, correct with the cameras.

    landmarks : (M, 3), m, world; row i is landmark i of the drive. gate : probability that a good measurement
    passes. Yields one `Step` per frame, its beliefs `PoseBelief`s.
    Source: report section 3.3.1.
    """
    threshold = kalman.gate_threshold(gate)
    landmarks = np.asarray(landmarks, dtype=float)
    if landmarks.shape != (drive.n_landmarks, 3):
        raise ValueError(f"landmarks must have shape ({drive.n_landmarks}, 3), one row per landmark of the "
                         f"drive, got {landmarks.shape}")
    nobody = np.empty(0, dtype=int)
    posterior = None
    for k in range(drive.n_frames):
        if posterior is None:
            prior = start(noise, world_T_imu)
        else:
            prior = predict(posterior, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        ids, pixels = drive.observed(k)
        posterior, innovation = observe(prior, drive.camera, noise, ids, pixels, landmarks[ids], threshold)
        yield Step(k, drive.times[k], prior, posterior, innovation, nobody, nobody)
