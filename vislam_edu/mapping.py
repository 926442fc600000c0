"""Where the landmarks are, when the poses are assumed known: one small EKF per landmark.

>>> from vislam_edu import Noise, load, mapping
>>> drive = load("first_steps")
>>> *_, last = mapping.run(drive, Noise(), drive.true_world_T_imu)
>>> last.posterior.landmarks.shape
(42, 3)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from . import kalman
from .belief import Innovation, Step
from .drive import Drive
from .noise import Noise
from .stereo import StereoCamera


@dataclass(frozen=True, eq=False)
class MapBelief:
    """One independent Gaussian per landmark.

    landmarks : (M, 3), m, world. covariance : (M, 3, 3), m^2. seen : (M,) bool, which rows hold an estimate.
    """

    landmarks: np.ndarray
    covariance: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True, eq=False)
class NewLandmarks:
    """Landmarks seen for the first time: landmarks (n, 3), m, world; covariance (n, 3, 3), m^2; ok (n,) bool.

    measured_again : whether the measurement that made them is used in an update of the same frame too.
    """

    landmarks: np.ndarray
    covariance: np.ndarray
    ok: np.ndarray
    measured_again: bool


def triangulated(camera: StereoCamera, noise: Noise, world_T_imu: np.ndarray, pixels: np.ndarray,
                 min_disparity: float) -> NewLandmarks:
    """New landmarks with the covariance of their triangulation; the measurement is used once. pixels : (n, 4)."""
    points, ok = camera.triangulate(pixels, min_disparity)
    R = world_T_imu[:3, :3] @ camera.imu_T_cam[:3, :3]
    covariance = R @ camera.triangulation_covariance(points, noise.sigma_px) @ R.T
    return NewLandmarks(camera.to_world(world_T_imu, points), covariance, ok, measured_again=False)


def report_prior(camera: StereoCamera, noise: Noise, world_T_imu: np.ndarray, pixels: np.ndarray,
                 min_disparity: float) -> NewLandmarks:
    """New landmarks the report's way: triangulated mean, covariance 2 I, and the same measurement used again.

    Source: report section 3.2.2 and 3.3.3.
    """
    points, ok = camera.triangulate(pixels, min_disparity)
    covariance = np.broadcast_to(noise.landmark_prior * np.eye(3), (len(pixels), 3, 3))
    return NewLandmarks(camera.to_world(world_T_imu, points), covariance, ok, measured_again=True)


def run(drive: Drive, noise: Noise, world_T_imu: np.ndarray, initialise: Callable[..., NewLandmarks] = triangulated,
        gate: float = 0.99, min_disparity: float = 1.0) -> Iterator[Step]:
    """The landmark EKF on poses assumed known (true ones, or dead-reckoned ones as in the report's figures).

    world_T_imu : (T, 4, 4). initialise : `triangulated` or `report_prior`. gate : probability that a good
    measurement passes. min_disparity : px, below it a landmark waits for a better view.
    Yields one `Step` per frame, its beliefs `MapBelief`s. Known poses make the landmarks independent, so
    the report's 3M x 3M covariance is M blocks of 3 x 3, updated all at once.
    Source: report section 3.2.2.
    """
    world_T_imu = np.asarray(world_T_imu, dtype=float)
    if world_T_imu.shape != (drive.n_frames, 4, 4):
        raise ValueError(f"world_T_imu must have shape ({drive.n_frames}, 4, 4), one pose per frame of the "
                         f"drive, got {world_T_imu.shape}")
    threshold = kalman.gate_threshold(gate)
    camera, V = drive.camera, noise.pixel_covariance
    M = drive.n_landmarks
    m, P, seen = np.zeros((M, 3)), np.zeros((M, 3, 3)), np.zeros(M, bool)
    posterior = MapBelief(m, P, seen)
    for k in range(drive.n_frames):
        T = world_T_imu[k]
        ids, pixels = drive.observed(k)
        prior = posterior
        m, P, seen = prior.landmarks.copy(), prior.covariance.copy(), prior.seen.copy()

        new, born = ~seen[ids], ids[:0]
        if new.any():
            first = initialise(camera, noise, T, pixels[new], min_disparity)
            born = ids[new][first.ok]
            m[born], P[born], seen[born] = first.landmarks[first.ok], first.covariance[first.ok], True
            if first.measured_again:
                prior = MapBelief(m.copy(), P.copy(), seen.copy())

        known = prior.seen[ids]
        ids, pixels = ids[known], pixels[known]
        predicted, in_front = camera.observe(T, m[ids])
        H = camera.landmark_jacobian(T, m[ids])
        S = kalman.innovation_covariance(P[ids], H, V)
        residual = pixels - predicted
        nis = np.where(in_front, kalman.nis(residual, S), np.inf)
        accepted = in_front & (nis <= threshold)
        innovation = Innovation(ids, pixels, predicted, S, nis, accepted)
        good = ids[accepted]
        delta, P[good] = kalman.update(P[good], H[accepted], V, residual[accepted])
        m[good] += delta

        posterior = MapBelief(m, P, seen)
        yield Step(k, drive.times[k], prior, posterior, innovation, born, np.empty(0, int))
