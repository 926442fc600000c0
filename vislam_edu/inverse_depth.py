"""The joint filter with landmarks of inverse depth, plain: what `ekf_slam` is for the report's error, nothing dropped.

A landmark is y = (a, b, rho) in its chart, the camera that saw it first: direction (a, b, 1), inverse depth rho, 1/m.
y is a linear function of the pixels, so its Gaussian is exact at any distance, and rho may be zero or negative. A chart
[R_c, C] is corrected together with the pose, so what the cameras see depends on y alone: no measurement can tell where
the world is or how it is turned.

    world point      M / rho  with  M = R_c (a, b, 1) + rho C
    errors           T = exp(x^) T_hat,  [R_c, C] = exp(x^) [R_c, C]_hat,  y = y_hat + eta
    state            landmarks first, then x = [x_p, x_R]: covariance (3n+6, 3n+6)

`window_slam.run(drive, noise, InverseDepth())` gives the same numbers fast.
Sources: Civera, Davison, Montiel, Inverse depth parametrization for monocular SLAM, 2008; Barrau, Bonnabel, An EKF-SLAM
algorithm with consistency properties, 2015; Bell, Cathey, The iterated Kalman filter as a Gauss-Newton method, 1993.

>>> from vislam_edu import Noise, inverse_depth, load
>>> *_, last = inverse_depth.run(load("first_steps").slice(0, 5), Noise())
>>> last.posterior.covariance.shape == (3 * len(last.posterior.ids) + 6,) * 2
True
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import block_diag

from . import kalman, se3
from .belief import NO_INNOVATION, Belief, Innovation, Step
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


def move(belief: Belief, twist: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) after a twist (6,), m/s and rad/s, of tau seconds, and N (3n+6, 6): its error to all errors."""
    after = belief.world_T_imu @ se3.exp(tau * twist)
    B = tau * se3.adjoint(after) @ se3.right_jacobian(tau * twist)
    return after, np.vstack([*(landmark_noise(point, B) for point in belief.points), B])


def predict(belief: Belief, twist: np.ndarray, tau: float, noise: Noise) -> Belief:
    """The pose moves along the twist: F = I, P + N Q N^T."""
    after, N = move(belief, twist, tau)
    return Belief(after, belief.points, belief.ids, belief.covariance + N @ noise.twist_covariance @ N.T)


def look(camera: StereoCamera, world_T_imu: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A landmark (3, 5) in the camera frame, homogeneous (4,), and the derivative (4, 3) of its pixels by y."""
    chart, y = unpack(point)
    cam_T_chart = camera.cam_T_imu @ se3.inverse(world_T_imu) @ chart
    q = cam_T_chart @ y
    return q, camera.homogeneous_jacobian(q) @ cam_T_chart[:, [0, 1, 3]]


def linearise(belief: Belief, ids: np.ndarray, camera: StereoCamera) -> tuple[np.ndarray, np.ndarray]:
    """H (m, 4, 3n+6) of known landmarks `ids` (m,), and where they are, (m, 4). The columns of the pose are zero."""
    m, n = len(ids), len(belief.ids)
    H, q = np.zeros((m, 4, 3 * n + 6)), np.zeros((m, 4))
    for i, j in enumerate(np.nonzero(belief.ids == ids[:, None])[1]):
        q[i], H[i, :, 3 * j:3 * j + 3] = look(camera, belief.world_T_imu, belief.points[j])
    return H, q


def step(before: Belief, twist: np.ndarray, tau: float, ids: np.ndarray, pixels: np.ndarray, camera: StereoCamera,
         noise: Noise, threshold: float) -> tuple[Belief, Belief, Innovation]:
    """Predict, and correct all with pixels (m, 4) of known landmarks `ids` (m,) whose NIS is up to `threshold`.

    Returns prior, posterior and innovation; for `twist` and `tau` see `move`.
    """
    prior, V = predict(before, twist, tau, noise), noise.pixel_covariance
    H, q = linearise(prior, ids, camera)
    S = kalman.innovation_covariance(prior.covariance, H, V)
    predicted, in_front = camera.project_homogeneous(q)
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    good = in_front & (nis <= threshold)
    delta, _ = kalman.update(prior.covariance, np.concatenate(H[good]), np.kron(np.eye(good.sum()), V),
                             (pixels - predicted)[good].ravel())

    N = move(before, twist, tau)[1]
    n = np.linalg.solve(N[-6:], delta[-6:])  # the error of the twist that explains the new pose
    eta = delta - N @ n                      # and what is left of the landmarks' correction
    there = Belief(before.world_T_imu, shifted(before.points, eta), before.ids, before.covariance)
    error = -move(there, twist + n, tau)[1] @ n - eta  # of the prior's mean, seen from the second linearisation
    there = predict(there, twist + n, tau, noise)
    H, q = linearise(there, ids, camera)
    again, in_front = camera.project_homogeneous(q)
    good &= in_front
    delta, P = kalman.update(there.covariance, np.concatenate(H[good]), np.kron(np.eye(good.sum()), V),
                             (pixels - again - H @ error)[good].ravel())
    return prior, retract(there, delta + error, P), Innovation(ids, pixels, predicted, S, nis, good)


def shifted(points: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Landmarks (n, 3, 5) with y + eta, eta the first 3n numbers."""
    moved = points.copy()
    moved[:, :, 4] += eta[:3 * len(points)].reshape(-1, 3)
    return moved


def retract(belief: Belief, delta: np.ndarray, covariance: np.ndarray) -> Belief:
    """y + eta; pose and charts move by exp(x^). delta : (3n+6,)."""
    change, points = se3.exp(delta[-6:]), shifted(belief.points, delta)
    points[:, :, :4] = change[:3, :3] @ points[:, :, :4]
    points[:, :, 3] += change[:3, 3]
    return Belief(change @ belief.world_T_imu, points, belief.ids, covariance)


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
        ids, pixels = drive.observed(k)
        old = np.isin(ids, posterior.ids)
        prior, innovation = posterior, NO_INNOVATION
        sample = drive.step_twists[k - 1], drive.taus[k - 1]
        if old.any():
            prior, posterior, innovation = step(posterior, *sample, ids[old], pixels[old], camera, noise, threshold)
        elif k:
            prior = posterior = predict(posterior, *sample, noise)
        posterior = initialise(posterior, ids[~old], pixels[~old], camera, noise)
        yield Step(k, drive.times[k], prior, posterior, innovation, ids[~old], np.empty(0, int))
