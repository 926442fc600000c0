"""Where the landmarks are, when the poses are taken for known: one small EKF per landmark."""

from dataclasses import dataclass

import numpy as np

from . import kalman


@dataclass(frozen=True, eq=False)
class MapBelief:
    """One independent Gaussian per landmark.

    landmarks : (M, 3), m, world. covariance : (M, 3, 3), m^2. seen : (M,) bool, which rows hold an estimate.
    """

    landmarks: np.ndarray
    covariance: np.ndarray
    seen: np.ndarray


def triangulated(camera, noise, world_T_imu, pixels, min_disparity):
    """New landmarks whose covariance is that of their triangulation; the first measurement is then used up.

    pixels : (n, 4). Returns landmarks (n, 3), covariances (n, 3, 3), ok (n,) and False: "not to be used again".
    """
    points, ok = camera.triangulate(pixels, min_disparity)
    R = world_T_imu[:3, :3] @ camera.imu_T_cam[:3, :3]
    covariance = R @ camera.triangulation_covariance(points, noise.sigma_px) @ R.T
    return camera.to_world(world_T_imu, points), covariance, ok, False


def as_report(camera, noise, world_T_imu, pixels, min_disparity):
    """New landmarks the report's way: triangulated mean, covariance 2 I, and the same measurement used again.

    Source: report section 3.2.2 and 3.3.3.
    """
    points, ok = camera.triangulate(pixels, min_disparity)
    covariance = np.broadcast_to(noise.landmark_prior * np.eye(3), (len(pixels), 3, 3))
    return camera.to_world(world_T_imu, points), covariance, ok, True


def run(drive, noise, world_T_imu, initialise=triangulated, gate=0.99, min_disparity=1.0):
    """The landmark EKF on poses taken for known (true ones, or dead-reckoned ones as in the report's figures).

    world_T_imu : (T, 4, 4). initialise : `triangulated` or `as_report`. gate : probability that a good
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

        new = ~seen[ids]
        first_m, first_P, ok, use_again = initialise(camera, noise, T, pixels[new], min_disparity)
        born = ids[new][ok]
        m[born], P[born], seen[born] = first_m[ok], first_P[ok], True
        if use_again:
            prior = MapBelief(m.copy(), P.copy(), seen.copy())

        known = prior.seen[ids]
        ids, pixels = ids[known], pixels[known]
        predicted, in_front = camera.observe(T, m[ids])
        H = camera.landmark_jacobian(T, m[ids])
        S = kalman.innovation_covariance(P[ids], H, V)
        residual = pixels - predicted
        nis = np.where(in_front, kalman.nis(residual, S), np.inf)
        accepted = in_front & (nis <= threshold)
        innovation = kalman.Innovation(ids, pixels, predicted, S, nis, accepted)
        good = ids[accepted]
        delta, P[good] = kalman.update(P[good], H[accepted], V, residual[accepted])
        m[good] += delta

        posterior = MapBelief(m, P, seen)
        yield kalman.Step(k, drive.times[k], prior, posterior, innovation, born, np.empty(0, int))
