"""The joint filter of the report, plain: one Gaussian over every landmark and the pose, nothing dropped.

H is written out in full, so the cost grows with the cube of the map: for a few dozen landmarks.
`window_slam` gives the same numbers fast. Source: report sections 3.3.2 and 3.3.3, corrected.

>>> from vislam_edu import Noise, ekf_slam, load
>>> *_, last = ekf_slam.run(load("first_steps").slice(0, 5), Noise())
>>> last.posterior.covariance.shape == (3 * len(last.posterior.ids) + 6,) * 2
True
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.linalg import block_diag

from . import kalman, se3, stereo
from .belief import Belief, Innovation, Step
from .drive import Drive
from .noise import Noise
from .stereo import StereoCamera

Frame = tuple[Belief, Belief, Innovation]


def predict_joint(covariance: np.ndarray, F: np.ndarray, W: np.ndarray) -> np.ndarray:
    """The covariance (3n+6, 3n+6) after a step: F and W (6, 6) act on the pose, landmarks stand still."""
    zero = np.zeros((len(covariance) - 6,) * 2)
    Phi = block_diag(np.eye(len(zero)), F)
    return Phi @ covariance @ Phi.T + block_diag(zero, W)


def predict(belief: Belief, twist: np.ndarray, tau: float, noise: Noise) -> Belief:
    """Steps 1 and 2: the pose moves along the twist (6,), m/s and rad/s, for tau seconds."""
    increment = se3.exp(tau * twist)
    F = se3.adjoint(se3.inverse(increment))
    B = tau * se3.right_jacobian(tau * twist)
    P = predict_joint(belief.covariance, F, B @ noise.twist_covariance @ B.T)
    return Belief(belief.world_T_imu @ increment, belief.landmarks, belief.ids, P)


def joint_jacobian(H_landmark: np.ndarray, H_pose: np.ndarray, rows: np.ndarray,
                   n: int) -> np.ndarray:
    """H (4m, 3n+6) from (m, 4, 3) and (m, 4, 6): measurement i shows landmark rows[i] of n."""
    H = np.zeros((len(rows), 4, 3 * n + 6))
    for i, j in enumerate(rows):
        H[i, :, 3 * j:3 * j + 3] = H_landmark[i]
        H[i, :, 3 * n:] = H_pose[i]
    return H.reshape(4 * len(rows), 3 * n + 6)


def joint_update(world_T_imu: np.ndarray, landmarks: np.ndarray, covariance: np.ndarray,
                 H: np.ndarray, residual: np.ndarray,
                 V: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps 3 to 5, H (k, 3n+6), residual (k,), V (k, k): landmarks (n, 3) by +, pose by exp."""
    delta, P = kalman.update(covariance, H, V, residual)
    n = landmarks.size
    return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3), P


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
           threshold: float) -> tuple[Belief, Innovation]:
    """Correct all with pixels (m, 4) of known landmarks `ids` (m,) whose NIS is up to `threshold`."""
    m, n, T, V = len(ids), len(prior.ids), prior.world_T_imu, noise.pixel_covariance
    rows = np.nonzero(prior.ids == ids[:, None])[1]
    seen = prior.landmarks[rows]
    H = joint_jacobian(camera.landmark_jacobian(T, seen), camera.pose_jacobian(T, seen), rows, n)
    S = kalman.innovation_covariance(prior.covariance, H.reshape(m, 4, 3 * n + 6), V)
    predicted, in_front = camera.observe(T, seen)
    predicted = predicted + stereo.second_order(predicted, (S - V)[:, :3, :3])
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    good = in_front & (nis <= threshold)
    posterior = joint_update(T, prior.landmarks, prior.covariance, H[np.repeat(good, 4)],
                             (pixels - predicted)[good].ravel(), np.kron(np.eye(good.sum()), V))
    innovation = Innovation(ids, pixels, predicted, S, nis, good)
    return Belief(posterior[0], posterior[1], prior.ids, posterior[2]), innovation


def new_landmark(covariance: np.ndarray, world_T_imu: np.ndarray, point_imu: np.ndarray,
                 C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A landmark at s (3,), IMU frame, of covariance C (3, 3), joins between the map and the pose.

    Sigma_mm = G Sigma_RR G^T + R C R^T and Sigma_m. = G Sigma_R. with G = R [I, -s^]. Returns it in the
    world frame and the covariance (3n+9, 3n+9).
    """
    n, R = len(covariance) - 6, world_T_imu[:3, :3]
    A = np.zeros((n + 9, n + 6))  # old errors to new errors
    A[:n, :n], A[n + 3:, n:] = np.eye(n), np.eye(6)
    A[n:n + 3, n:] = np.hstack([R, -R @ se3.so3_hat(point_imu)])
    new = A @ covariance @ A.T
    new[n:n + 3, n:n + 3] += R @ C @ R.T
    return se3.transform(world_T_imu, point_imu), new


def initialise(belief: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera,
               noise: Noise, min_disparity: float) -> Belief:
    """Landmarks `ids` (m,) triangulated from (m, 4) px, correlated with the pose that saw them."""
    points_cam, ok = camera.triangulate(pixels, min_disparity)
    R = camera.imu_T_cam[:3, :3]
    landmarks, P = list(belief.landmarks), belief.covariance
    for point in points_cam[ok]:
        C = R @ camera.triangulation_covariance(point, noise.sigma_px) @ R.T
        s = se3.transform(camera.imu_T_cam, point)
        landmark, P = new_landmark(P, belief.world_T_imu, s, C)
        landmarks.append(landmark)
    ids = np.append(belief.ids, ids[ok])
    return Belief(belief.world_T_imu, np.reshape(landmarks, (-1, 3)), ids, P)


def initialise_as_report(belief: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera,
                         noise: Noise, min_disparity: float) -> Belief:
    """The report's way: covariance 2 I, no correlation, as if the pose were known exactly."""
    points_cam, ok = camera.triangulate(pixels, min_disparity)
    n, m = belief.landmarks.size, 3 * ok.sum()
    P = np.insert(np.insert(belief.covariance, m * [n], 0, axis=0), m * [n], 0, axis=1)
    P[n:n + m, n:n + m] = noise.landmark_prior * np.eye(m)
    landmarks = np.vstack([belief.landmarks, camera.to_world(belief.world_T_imu, points_cam[ok])])
    return Belief(belief.world_T_imu, landmarks, np.append(belief.ids, ids[ok]), P)


def correlated(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
               threshold: float, min_disparity: float) -> Frame:
    """The correct frame: known landmarks correct, then new ones join, each measurement used once."""
    old = np.isin(ids, prior.ids)
    posterior, innovation = update(prior, ids[old], pixels[old], camera, noise, threshold)
    return prior, initialise(posterior, ids[~old], pixels[~old], camera, noise, min_disparity), innovation


def as_report(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
              threshold: float, min_disparity: float) -> Frame:
    """The report's frame: new landmarks join first, and their measurement is used a second time."""
    new = ~np.isin(ids, prior.ids)
    prior = initialise_as_report(prior, ids[new], pixels[new], camera, noise, min_disparity)
    old = np.isin(ids, prior.ids)
    return prior, *update(prior, ids[old], pixels[old], camera, noise, threshold)


def run(drive: Drive, noise: Noise, process_frame: Callable[..., Frame] = correlated,
        gate: float = 0.99, min_disparity: float = 1.0) -> Iterator[Step]:
    """One `Step` per frame; landmarks in the order of their birth. For the arguments see `window_slam.run`."""
    settings = drive.camera, noise, kalman.gate_threshold(gate), min_disparity
    belief = Belief(np.eye(4), np.empty((0, 3)), np.empty(0, int), noise.initial_pose_covariance)
    for k in range(drive.n_frames):
        if k > 0:
            belief = predict(belief, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        prior, posterior, innovation = process_frame(belief, *drive.observed(k), *settings)
        born, retired = np.setdiff1d(posterior.ids, belief.ids), np.empty(0, int)
        yield Step(k, drive.times[k], prior, posterior, innovation, born, retired)
        belief = posterior
