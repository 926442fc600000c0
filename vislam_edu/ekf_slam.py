"""The joint filter of the report, plain: one Gaussian over every landmark and the pose, nothing dropped, no shortcut.

    for step in ekf_slam.run(drive, noise):
        step.prior, step.innovation, step.posterior

H is written out in full, so the cost grows with the cube of the map: for drives of a few dozen landmarks. `window_slam`
gives the same numbers fast. Source: report sections 3.3.2 and 3.3.3, with the corrections of notebook 00.

>>> from vislam_edu import Noise, ekf_slam, load
>>> *_, last = ekf_slam.run(load("first_steps").slice(0, 5), Noise())
>>> last.posterior.covariance.shape == (3 * len(last.posterior.ids) + 6,) * 2
True
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.linalg import block_diag

from . import kalman, se3
from .drive import Drive
from .kalman import Belief, Innovation, Step
from .noise import Noise
from .stereo import StereoCamera

Frame = tuple[Belief, Belief, Innovation]


def predict_joint(covariance: np.ndarray, F: np.ndarray, W: np.ndarray) -> np.ndarray:
    """diag(I, F) Sigma diag(I, F)^T, plus W on the pose: landmarks stand still. (3n+6, 3n+6), F and W (6, 6)."""
    n = len(covariance) - 6
    return block_diag(np.eye(n), F) @ covariance @ block_diag(np.eye(n), F).T + block_diag(np.zeros((n, n)), W)


def predict(belief: Belief, twist: np.ndarray, tau: float, noise: Noise) -> Belief:
    """Step 1 and 2: the pose moves along the twist (6,), [v, omega], m/s and rad/s, for tau seconds."""
    increment = se3.exp(tau * twist)
    F = se3.adjoint(se3.inverse(increment))
    B = tau * se3.right_jacobian(tau * twist)
    W = B @ noise.twist_covariance @ B.T
    return Belief(belief.world_T_imu @ increment, belief.landmarks, belief.ids, predict_joint(belief.covariance, F, W))


def joint_jacobian(H_landmark: np.ndarray, H_pose: np.ndarray, rows: np.ndarray, n: int) -> np.ndarray:
    """H (4m, 3n+6): zero but for (m, 4, 3) at each one's landmark, rows (m,) of n, and (m, 4, 6) at the pose."""
    H = np.zeros((len(rows), 4, 3 * n + 6))
    for i, j in enumerate(rows):
        H[i, :, 3 * j:3 * j + 3] = H_landmark[i]
        H[i, :, 3 * n:] = H_pose[i]
    return H.reshape(4 * len(rows), 3 * n + 6)


def joint_update(world_T_imu: np.ndarray, landmarks: np.ndarray, covariance: np.ndarray, H: np.ndarray,
                 residual: np.ndarray, V: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps 3 to 5, H (k, 3n+6), residual (k,) and V (k, k): corrections are added to (n, 3) landmarks, exp'ed to T."""
    delta, covariance = kalman.update(covariance, H, V, residual)
    n = landmarks.size
    return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3), covariance


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
           threshold: float) -> tuple[Belief, Innovation]:
    """Correct map and pose with measurements (m, 4), px, of known landmarks `ids` (m,) with a NIS up to `threshold`."""
    m, n = len(ids), len(prior.ids)
    rows = np.nonzero(prior.ids == ids[:, None])[1]
    seen = prior.landmarks[rows]
    predicted, in_front = camera.observe(prior.world_T_imu, seen)
    H = joint_jacobian(camera.landmark_jacobian(prior.world_T_imu, seen),
                       camera.pose_jacobian(prior.world_T_imu, seen), rows, n)
    S = kalman.innovation_covariance(prior.covariance, H.reshape(m, 4, 3 * n + 6), noise.pixel_covariance)
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    good = in_front & (nis <= threshold)
    T, landmarks, covariance = joint_update(
        prior.world_T_imu, prior.landmarks, prior.covariance, H[np.repeat(good, 4)],
        (pixels - predicted)[good].ravel(), np.kron(np.eye(good.sum()), noise.pixel_covariance))
    return Belief(T, landmarks, prior.ids, covariance), Innovation(ids, pixels, predicted, S, nis, good)


def new_landmark(covariance: np.ndarray, world_T_imu: np.ndarray, point_imu: np.ndarray,
                 C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A landmark at s (3,), m, IMU frame, triangulated with covariance C (3, 3), joins between the map and the pose.

    Sigma_mm = G Sigma_RR G^T + R C R^T  and  Sigma_m. = G Sigma_R.  with  G = R [I, -s^]. Returns the landmark (3,), m,
    world, and the covariance (3n+9, 3n+9).
    """
    n, R = len(covariance) - 6, world_T_imu[:3, :3]
    A = np.zeros((n + 9, n + 6))  # old errors to new errors
    A[:n, :n], A[n + 3:, n:] = np.eye(n), np.eye(6)
    A[n:n + 3, n:] = np.hstack([R, -R @ se3.so3_hat(point_imu)])
    new = A @ covariance @ A.T
    new[n:n + 3, n:n + 3] += R @ C @ R.T
    return se3.transform(world_T_imu, point_imu), new


def initialise(belief: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
               min_disparity: float) -> Belief:
    """New landmarks `ids` (m,), triangulated from (m, 4) px, correlated with the pose that they were seen from."""
    points_cam, ok = camera.triangulate(pixels, min_disparity)
    imu_R_cam = camera.imu_T_cam[:3, :3]
    landmarks, covariance = list(belief.landmarks), belief.covariance
    for point in points_cam[ok]:
        C = imu_R_cam @ camera.triangulation_covariance(point, noise.sigma_px) @ imu_R_cam.T
        s = se3.transform(camera.imu_T_cam, point)
        landmark, covariance = new_landmark(covariance, belief.world_T_imu, s, C)
        landmarks.append(landmark)
    return Belief(belief.world_T_imu, np.reshape(landmarks, (-1, 3)), np.append(belief.ids, ids[ok]), covariance)


def initialise_as_report(belief: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
                         min_disparity: float) -> Belief:
    """New landmarks the report's way: covariance 2 I and no correlation, as if the pose were known exactly."""
    points_cam, ok = camera.triangulate(pixels, min_disparity)
    n, m = belief.landmarks.size, 3 * ok.sum()
    covariance = np.insert(np.insert(belief.covariance, m * [n], 0, axis=0), m * [n], 0, axis=1)
    covariance[n:n + m, n:n + m] = noise.landmark_prior * np.eye(m)
    landmarks = np.vstack([belief.landmarks, camera.to_world(belief.world_T_imu, points_cam[ok])])
    return Belief(belief.world_T_imu, landmarks, np.append(belief.ids, ids[ok]), covariance)


def correlated(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
               threshold: float, min_disparity: float) -> Frame:
    """The correct frame: known landmarks correct the state, then new ones join, their first measurement used once."""
    known = np.isin(ids, prior.ids)
    posterior, innovation = update(prior, ids[known], pixels[known], camera, noise, threshold)
    return prior, initialise(posterior, ids[~known], pixels[~known], camera, noise, min_disparity), innovation


def as_report(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
              threshold: float, min_disparity: float) -> Frame:
    """The report's frame: new landmarks join first, and their first measurement is used a second time."""
    new = ~np.isin(ids, prior.ids)
    prior = initialise_as_report(prior, ids[new], pixels[new], camera, noise, min_disparity)
    known = np.isin(ids, prior.ids)
    return prior, *update(prior, ids[known], pixels[known], camera, noise, threshold)


def run(drive: Drive, noise: Noise, process_frame: Callable[..., Frame] = correlated, gate: float = 0.99,
        min_disparity: float = 1.0, world_T_imu: np.ndarray | None = None) -> Iterator[Step]:
    """The filter over a drive, one `Step` per frame; landmarks stand in the state in the order of their birth.

    process_frame : `correlated` or `as_report`. gate : probability that a good measurement passes. min_disparity : px.
    """
    threshold = kalman.gate_threshold(gate)
    start = np.eye(4) if world_T_imu is None else np.array(world_T_imu, dtype=float)
    belief = Belief(start, np.empty((0, 3)), np.empty(0, dtype=int), noise.initial_pose_covariance.copy())
    for k in range(drive.n_frames):
        if k > 0:
            belief = predict(belief, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        prior, posterior, innovation = process_frame(belief, *drive.observed(k), drive.camera, noise, threshold,
                                                     min_disparity)
        yield Step(k, drive.times[k], prior, posterior, innovation, born=np.setdiff1d(posterior.ids, belief.ids),
                   retired=np.empty(0, dtype=int))
        belief = posterior
