"""The joint filter with landmarks of inverse depth, plain: what `ekf_slam` is for the report's error, nothing dropped.

A landmark is y = (a, b, rho) in its chart, the camera that saw it first: direction (a, b, 1), inverse depth rho, 1/m.
A triangulated point at 60 m is far from Gaussian; y is a linear function of the pixels, so its Gaussian is exact, and
rho may be zero or negative. A chart [R_c, C] is a part of the estimate: it is corrected together with the pose. So
what the cameras see depends on y alone, and no measurement can tell where the world is or how it is turned.

    world point      M / rho  with  M = R_c (a, b, 1) + rho C
    errors           T = exp(x^) T_hat,  [R_c, C] = exp(x^) [R_c, C]_hat,  y = y_hat + eta
    state            landmarks first, then x = [x_p, x_R]: covariance (3n+6, 3n+6)

`window_slam.run(drive, noise, InverseDepth())` gives the same numbers fast.
Source: Civera, Davison, Montiel, Inverse depth parametrization for monocular SLAM, 2008 (the coordinates); Barrau,
Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015 (the error of the pose).

>>> from vislam_edu import Noise, inverse_depth, load
>>> *_, last = inverse_depth.run(load("first_steps").slice(0, 5), Noise())
>>> last.posterior.covariance.shape == (3 * len(last.posterior.ids) + 6,) * 2
True
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import block_diag

from . import kalman, se3
from .belief import Belief, Innovation, Step
from .drive import Drive
from .noise import Noise
from .stereo import StereoCamera


def unpack(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chart world_T_chart (4, 4) and homogeneous (a, b, 1, rho) (4,) of one landmark of `Belief.points`, (3, 5)."""
    a, b, rho = point[:, 4]
    return se3.pose(point[:, :3], point[:, 3]), np.array([a, b, 1.0, rho])


def landmark_noise(point: np.ndarray, B: np.ndarray) -> np.ndarray:
    """(3, 6): error of the twist to error of y, for a landmark (3, 5). B (6, 6): to error of the pose.

    The landmark stands still while its chart moves with the pose: eta takes back what x does to the landmark,
    E (M^ B_R - rho B_p), where rho E is the derivative of y by the position of the landmark.
    """
    chart, (a, b, one, rho) = unpack(point)
    M = chart[:3] @ [a, b, one, rho]
    E = np.array([[1, 0, -a], [0, 1, -b], [0, 0, -rho]]) @ chart[:3, :3].T
    return E @ (se3.so3_hat(M) @ B[3:] - rho * B[:3])


def predict(belief: Belief, twist: np.ndarray, tau: float, noise: Noise) -> Belief:
    """The pose moves along the twist (6,), m/s and rad/s, for tau seconds: F = I, P + N Q N^T."""
    after = belief.world_T_imu @ se3.exp(tau * twist)
    B = tau * se3.adjoint(after) @ se3.right_jacobian(tau * twist)
    N = np.vstack([*(landmark_noise(point, B) for point in belief.points), B])
    return Belief(after, belief.points, belief.ids, belief.covariance + N @ noise.twist_covariance @ N.T)


def look(camera: StereoCamera, world_T_imu: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A landmark (3, 5) in the camera frame, homogeneous (4,), and the derivative (4, 3) of its pixels by y."""
    chart, y = unpack(point)
    cam_T_chart = camera.cam_T_imu @ se3.inverse(world_T_imu) @ chart
    q = cam_T_chart @ y
    return q, camera.homogeneous_jacobian(q) @ cam_T_chart[:, [0, 1, 3]]


def update(prior: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise,
           threshold: float) -> tuple[Belief, Innovation]:
    """Correct all with pixels (m, 4) of known landmarks `ids` (m,) whose NIS is up to `threshold`."""
    m, n, T, V = len(ids), len(prior.ids), prior.world_T_imu, noise.pixel_covariance
    H, q = np.zeros((m, 4, 3 * n + 6)), np.zeros((m, 4))  # the six columns of the pose stay zero
    for i, j in enumerate(np.nonzero(prior.ids == ids[:, None])[1]):
        q[i], H[i, :, 3 * j:3 * j + 3] = look(camera, T, prior.points[j])
    S = kalman.innovation_covariance(prior.covariance, H, V)
    predicted, in_front = camera.project_homogeneous(q)
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    good = in_front & (nis <= threshold)
    delta, P = kalman.update(prior.covariance, H[good].reshape(-1, 3 * n + 6), np.kron(np.eye(good.sum()), V),
                             (pixels - predicted)[good].ravel())
    return retract(prior, delta, P), Innovation(ids, pixels, predicted, S, nis, good)


def retract(belief: Belief, delta: np.ndarray, covariance: np.ndarray) -> Belief:
    """y + eta; pose and charts move by exp(x^). delta : (3n+6,)."""
    move, points = se3.exp(delta[-6:]), belief.points.copy()
    points[:, :, :4] = move[:3, :3] @ points[:, :, :4]
    points[:, :, 3] += move[:3, 3]
    points[:, :, 4] += delta[:-6].reshape(-1, 3)
    return Belief(move @ belief.world_T_imu, points, belief.ids, covariance)


def initialise(belief: Belief, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera, noise: Noise) -> Belief:
    """Landmarks `ids` (m,) from (m, 4) px: y is linear in the pixels, and correlated with nothing."""
    chart = (belief.world_T_imu @ camera.imu_T_cam)[:3]
    A, offset = camera.inverse_depth_of_pixels
    points = [np.column_stack([chart, A @ pixel + offset]) for pixel in pixels]
    P = block_diag(np.kron(np.eye(len(ids)), noise.sigma_px**2 * A @ A.T), belief.covariance)
    n, m = 3 * len(belief.ids), 3 * len(ids)
    order = np.r_[m:m + n, :m, m + n:m + n + 6]  # the new ones between the map and the pose
    return Belief(belief.world_T_imu, np.concatenate([belief.points, np.reshape(points, (-1, 3, 5))]),
                  np.append(belief.ids, ids), P[np.ix_(order, order)])


def run(drive: Drive, noise: Noise, gate: float = 0.99, world_T_imu: np.ndarray | None = None) -> Iterator[Step]:
    """One `Step` per frame; landmarks in the order of their birth. For the arguments see `window_slam.run`."""
    camera, threshold = drive.camera, kalman.gate_threshold(gate)
    start = np.eye(4) if world_T_imu is None else world_T_imu
    posterior = Belief(start, np.empty((0, 3, 5)), np.empty(0, int), noise.initial_pose_covariance)
    for k in range(drive.n_frames):
        prior = predict(posterior, drive.step_twists[k - 1], drive.taus[k - 1], noise) if k else posterior
        ids, pixels = drive.observed(k)
        old = np.isin(ids, prior.ids)
        posterior, innovation = update(prior, ids[old], pixels[old], camera, noise, threshold)
        posterior = initialise(posterior, ids[~old], pixels[~old], camera, noise)
        yield Step(k, drive.times[k], prior, posterior, innovation, ids[~old], np.empty(0, int))
