"""Right answers to the exercises, each written in two ways that share little with the package or each other.

`ANSWERS[name]` is a list of functions. They are written as students write: loops, series, scipy, no care for speed.
"""

import itertools
import math
from collections import defaultdict

import numpy as np
from scipy import linalg, stats
from scipy.spatial.transform import RigidTransform, Rotation

ANSWERS = defaultdict(list)
I3 = np.eye(3)


def answer(name):
    def enter(function):
        ANSWERS[name].append(function)
        return function
    return enter


def skew(a):
    return np.array([np.cross(a, e) for e in I3]).T


def wedge(xi):
    X = np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = skew(xi[3:]), xi[:3]
    return X


def moved(T, points):
    return (np.c_[np.atleast_2d(points), np.ones(len(np.atleast_2d(points)))] @ T.T)[:, :3]


def pixels(camera, T, m):
    q = camera.cam_T_imu @ np.linalg.inv(T) @ np.append(m, 1.0)
    return camera.K_s @ (q / q[2])


# --- chapter 1 --------------------------------------------------------------------------------------------

@answer("so3_hat")
def _(omega):
    x, y, z = omega
    return [[0, -z, y], [z, 0, -x], [-y, x, 0]]


@answer("so3_hat")
def _(omega):
    return np.column_stack([np.cross(omega, e) for e in I3])


@answer("se3_hat")
def _(xi):
    return np.vstack([np.column_stack([skew(xi[3:]), xi[:3]]), np.zeros(4)])


@answer("se3_hat")
def _(xi):
    v1, v2, v3, x, y, z = xi.tolist()
    return [[0, -z, y, v1], [z, 0, -x, v2], [-y, x, 0, v3], [0, 0, 0, 0]]


@answer("so3_exp")
def _(phi):
    return Rotation.from_rotvec(phi).as_matrix()


@answer("so3_exp")
def _(phi):
    t = math.sqrt(phi @ phi)
    if t < 1e-7:
        return I3 + skew(phi)
    a = phi / t
    return math.cos(t) * I3 + (1 - math.cos(t)) * np.outer(a, a) + math.sin(t) * skew(a)


@answer("se3_exp")
def _(xi):
    return linalg.expm(wedge(xi))


@answer("se3_exp")
def _(xi):
    t, S, T = np.linalg.norm(xi[3:]), skew(xi[3:]), np.eye(4)
    b, c = (0.5, 1 / 6) if t < 1e-6 else ((1 - np.cos(t)) / t**2, (t - np.sin(t)) / t**3)
    T[:3, :3] = Rotation.from_rotvec(xi[3:]).as_matrix()
    T[:3, 3] = (I3 + b * S + c * S @ S) @ xi[:3]
    return T


@answer("left_jacobian")
def _(xi):
    X = np.block([[skew(xi[3:]), skew(xi[:3])], [np.zeros((3, 3)), skew(xi[3:])]])
    term, total = np.eye(6), np.eye(6)
    for n in range(2, 30):
        term = term @ X / n
        total = total + term
    return total


@answer("left_jacobian")
def _(xi):
    # The mean of the Adjoint along the way: the integral of exp(s X) over s from 0 to 1.
    X = np.block([[skew(xi[3:]), skew(xi[:3])], [np.zeros((3, 3)), skew(xi[3:])]])
    nodes, weights = np.polynomial.legendre.leggauss(20)
    return sum(w / 2 * linalg.expm((s + 1) / 2 * X) for s, w in zip(nodes, weights))


@answer("adjoint")
def _(T):
    R, p = T[:3, :3], T[:3, 3]
    return np.block([[R, skew(p) @ R], [np.zeros((3, 3)), R]])


@answer("adjoint")
def _(T):
    columns = []
    for e in np.eye(6):
        X = T @ wedge(e) @ np.linalg.inv(T)
        columns.append([X[0, 3], X[1, 3], X[2, 3], X[2, 1], X[0, 2], X[1, 0]])
    return np.array(columns).T


@answer("dead_reckon")
def _(world_T_imu, twists, taus):
    out = np.empty((len(taus) + 1, 4, 4))
    out[0] = world_T_imu
    for k in range(len(taus)):
        out[k + 1] = out[k] @ linalg.expm(taus[k] * wedge(twists[k]))
    return out


@answer("dead_reckon")
def _(world_T_imu, twists, taus):
    pose, out = RigidTransform.from_matrix(world_T_imu), [world_T_imu.tolist()]
    for twist, tau in zip(twists, taus):
        pose = pose * RigidTransform.from_exp_coords(tau * np.r_[twist[3:], twist[:3]])
        out.append(pose.as_matrix().tolist())
    return out


@answer("predict_covariance")
def _(covariance, twist, tau, Q):
    X = tau * np.block([[skew(twist[3:]), skew(twist[:3])], [np.zeros((3, 3)), skew(twist[3:])]])
    F = linalg.expm(-X)
    J = sum(np.linalg.matrix_power(-X, n) / math.factorial(n + 1) for n in range(25))
    return F @ covariance @ F.T + tau**2 * J @ Q @ J.T


@answer("predict_covariance")
def _(covariance, twist, tau, Q):
    X = np.block([[skew(twist[3:]), skew(twist[:3])], [np.zeros((3, 3)), skew(twist[3:])]])
    # One big exponential holds both: [[-X, I], [0, 0]] gives exp(-tau X) and its integral, tau J_r.
    big = linalg.expm(tau * np.block([[-X, np.eye(6)], [np.zeros((6, 12))]]))
    G = np.hstack([big[:6, :6], big[:6, 6:]])
    return G @ linalg.block_diag(covariance, Q) @ G.T


@answer("datasheet_noise")
def _(angle_random_walk, velocity_density, rate):
    sigma_v = velocity_density * math.sqrt(rate)
    sigma_omega = angle_random_walk * math.pi / 180 / math.sqrt(3600) * math.sqrt(rate)
    Q = np.diag([sigma_v**2] * 3 + [sigma_omega**2] * 3)
    return Q / rate**2


@answer("datasheet_noise")
def _(angle_random_walk, velocity_density, rate):
    per_hour = (math.pi / 180 * angle_random_walk) ** 2     # rad^2 in one hour
    return [[(velocity_density**2 if i < 3 else per_hour / 3600) / rate if i == j else 0.0 for j in range(6)]
            for i in range(6)]


# --- chapter 2 --------------------------------------------------------------------------------------------

@answer("bearing")
def _(K, uv):
    return np.linalg.solve(K, [uv[0], uv[1], 1.0])


@answer("bearing")
def _(K, uv):
    return [(uv[0] - K[0, 2]) / K[0, 0], (uv[1] - K[1, 2]) / K[1, 1], 1]


@answer("triangulate_bearings")
def _(K, uv1, uv2, R, p):
    z1, z2 = (np.linalg.inv(K) @ np.append(uv, 1.0) for uv in (uv1, uv2))
    depths = np.linalg.lstsq(np.column_stack([z1, -R @ z2]), p, rcond=None)[0]
    return depths[0] * z1


@answer("triangulate_bearings")
def _(K, uv1, uv2, R, p):
    # Linear triangulation from the two projection matrices.
    P1, P2 = K @ np.eye(3, 4), K @ np.column_stack([R.T, -R.T @ p])
    A = np.array([uv1[0] * P1[2] - P1[0], uv1[1] * P1[2] - P1[1], uv2[0] * P2[2] - P2[0], uv2[1] * P2[2] - P2[1]])
    X = np.linalg.svd(A)[2][-1]
    return X[:3] / X[3]


@answer("triangulate")
def _(K, baseline, pixels):
    points, ok = np.full((len(pixels), 3), np.nan), []
    for i, (ul, vl, ur, _) in enumerate(pixels):
        ok.append(bool(ul - ur > 0))
        if ok[-1]:
            z = K[0, 0] * baseline / (ul - ur)
            points[i] = [(ul - K[0, 2]) * z / K[0, 0], (vl - K[1, 2]) * z / K[1, 1], z]
    return points, ok


@answer("triangulate")
def _(K, baseline, pixels):
    d = pixels[:, 0] - pixels[:, 2]
    rays = np.linalg.inv(K) @ np.vstack([pixels[:, :2].T, np.ones(len(d))])
    return (rays * K[0, 0] * baseline / d).T, d > 0


@answer("triangulation_covariance")
def _(K, baseline, point, sigma_px):
    x, y, z = point
    fu, fv = K[0, 0], K[1, 1]
    H = np.array([[fu / z, 0, -fu * x / z**2], [0, fv / z, -fv * y / z**2],
                  [fu / z, 0, -fu * (x - baseline) / z**2], [0, fv / z, -fv * y / z**2]])
    return np.linalg.inv(H.T @ np.linalg.inv(sigma_px**2 * np.eye(4)) @ H)


@answer("triangulation_covariance")
def _(K, baseline, point, sigma_px):
    # The other way: through the derivative of x, y, z by u_left, the mean v and the disparity.
    x, y, z = point
    fu, fv = K[0, 0], K[1, 1]
    dz = -z**2 / (fu * baseline)  # per pixel of disparity
    by_u_v_d = np.array([[z / fu, 0, x / z * dz], [0, z / fv, y / z * dz], [0, 0, dz]])
    of_u_v_d = sigma_px**2 * np.array([[1, 0, 1], [0, 0.5, 0], [1, 0, 2]])
    return by_u_v_d @ of_u_v_d @ by_u_v_d.T


# --- chapter 3 --------------------------------------------------------------------------------------------

@answer("project")
def _(camera, points_cam):
    return [camera.K_s @ (np.append(q, 1.0) / q[2]) for q in points_cam]


@answer("project")
def _(camera, points_cam):
    x, y, z = points_cam.T
    (fu, _, cu), (_, fv, cv), _ = camera.K
    u, v = fu * x / z + cu, fv * y / z + cv
    return np.stack([u, v, u - fu * camera.baseline / z, v]).T


@answer("projection_jacobian")
def _(camera, point_cam):
    q1, q2, q3 = point_cam
    return camera.K_s @ np.array([[1, 0, -q1 / q3, 0], [0, 1, -q2 / q3, 0], [0] * 4, [0, 0, -1 / q3, 1]]) / q3


@answer("projection_jacobian")
def _(camera, point_cam):
    q = np.append(point_cam, 1.0)
    return camera.K_s @ (np.eye(4) / q[2] - np.outer(q, [0, 0, 1, 0]) / q[2]**2)


@answer("landmark_jacobian")
def _(camera, world_T_imu, landmark):
    q = camera.cam_T_imu @ np.linalg.inv(world_T_imu) @ np.append(landmark, 1.0)
    D = np.eye(4) / q[2] - np.outer(q, [0, 0, 1, 0]) / q[2]**2
    return (camera.K_s @ D @ camera.cam_T_imu @ np.linalg.inv(world_T_imu))[:, :3]


@answer("landmark_jacobian")
def _(camera, world_T_imu, landmark):
    return _derivative(lambda d: pixels(camera, world_T_imu, landmark + d), 3)


def _derivative(function, n, h=2e-3):
    """Derivative at zero by differences of sixth order, good to about 1e-10 of the largest entry."""
    weights = {-3: -1 / 60, -2: 3 / 20, -1: -3 / 4, 1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    return np.array([sum(w * np.ravel(function(k * h * e)) for k, w in weights.items()) / h for e in np.eye(n)]).T


@answer("kalman_update")
def _(covariance, H, V, residual):
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    return K @ residual, (np.eye(len(covariance)) - K @ H) @ covariance


@answer("kalman_update")
def _(covariance, H, V, residual):
    # In information form.
    P = np.linalg.inv(np.linalg.inv(covariance) + H.T @ np.linalg.inv(V) @ H)
    return P @ H.T @ np.linalg.solve(V, residual), P


@answer("stacked_noise")
def _(V, n):
    return linalg.block_diag(*[V] * n)


@answer("stacked_noise")
def _(V, n):
    out = np.zeros((n, 4, n, 4))
    for i in range(n):
        out[i, :, i] = V
    return out.reshape(4 * n, 4 * n)


@answer("correct_landmarks")
def _(landmarks, ids, accepted, delta):
    rows = landmarks.tolist()
    for i, good, d in zip(ids, accepted, delta):
        if good:
            rows[i] = [a + b for a, b in zip(rows[i], d)]
    return rows


@answer("correct_landmarks")
def _(landmarks, ids, accepted, delta):
    shift = np.zeros_like(landmarks)
    np.add.at(shift, ids, delta * accepted[:, None])
    return landmarks + shift


# --- chapter 4 --------------------------------------------------------------------------------------------

@answer("odot")
def _(point):
    return np.vstack([np.hstack([I3, -skew(point)]), np.zeros(6)])


@answer("odot")
def _(point):
    return np.array([wedge(e) @ np.append(point, 1.0) for e in np.eye(6)]).T


@answer("pose_jacobian")
def _(camera, world_T_imu, landmark):
    s = np.linalg.inv(world_T_imu) @ np.append(landmark, 1.0)
    q = camera.cam_T_imu @ s
    D = camera.K_s @ (np.eye(4) / q[2] - np.outer(q, [0, 0, 1, 0]) / q[2]**2) @ camera.cam_T_imu
    return np.column_stack([-D @ wedge(e) @ s for e in np.eye(6)])


@answer("pose_jacobian")
def _(camera, world_T_imu, landmark):
    return _derivative(lambda e: pixels(camera, world_T_imu @ linalg.expm(wedge(e)), landmark), 6)


def _pose_system(camera, T, landmarks, z):
    H = np.vstack([camera.pose_jacobian(T, m) for m in landmarks])
    return H, np.concatenate([row - pixels(camera, T, m) for row, m in zip(z, landmarks)])


@answer("pose_update")
def _(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
    H, r = _pose_system(camera, world_T_imu, landmarks, pixels)
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + np.kron(np.eye(len(pixels)), sigma_px**2 * np.eye(4)))
    return world_T_imu @ linalg.expm(wedge(K @ r)), (np.eye(6) - K @ H) @ covariance


@answer("pose_update")
def _(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
    # One number after the other, all linearised at the prior: the same as all at once.
    H, r = _pose_system(camera, world_T_imu, landmarks, pixels)
    x, P = np.zeros(6), covariance.copy()
    for h, value in zip(H, r):
        k = P @ h / (h @ P @ h + sigma_px**2)
        x, P = x + k * (value - h @ x), P - np.outer(k, h @ P)
    return world_T_imu @ linalg.expm(wedge(x)), P


# --- chapter 5 --------------------------------------------------------------------------------------------

@answer("predict_joint")
def _(covariance, F, W):
    n = len(covariance) - 6
    A = linalg.block_diag(np.eye(n), F)
    return A @ covariance @ A.T + linalg.block_diag(np.zeros((n, n)), W)


@answer("predict_joint")
def _(covariance, F, W):
    P = covariance.copy()
    P[:-6, -6:] = P[:-6, -6:] @ F.T
    P[-6:, :-6] = P[:-6, -6:].T
    P[-6:, -6:] = F @ P[-6:, -6:] @ F.T + W
    return P


@answer("new_landmark")
def _(covariance, world_T_imu, point_imu, C):
    # As one linear map of [old state, error of the triangulated point].
    d, R = len(covariance), world_T_imu[:3, :3]
    n = d - 6
    A = np.zeros((d + 3, d + 3))
    A[:n, :n] = np.eye(n)
    A[n:n + 3, n:n + 3], A[n:n + 3, n + 3:n + 6], A[n:n + 3, d:] = R, -R @ skew(point_imu), R
    A[n + 3:, n:d] = np.eye(6)
    return moved(world_T_imu, point_imu)[0], A @ linalg.block_diag(covariance, C) @ A.T


@answer("new_landmark")
def _(covariance, world_T_imu, point_imu, C):
    R = world_T_imu[:3, :3]
    G = R @ np.hstack([I3, -skew(point_imu)])
    old, pose = np.arange(len(covariance) - 6), np.arange(len(covariance) - 6, len(covariance))
    P = np.insert(np.insert(covariance, [pose[0]] * 3, 0.0, axis=0), [pose[0]] * 3, 0.0, axis=1)
    new = slice(pose[0], pose[0] + 3)
    P[new, old] = G @ covariance[np.ix_(pose, old)]
    P[old, new] = P[new, old].T
    P[new, pose + 3] = G @ covariance[np.ix_(pose, pose)]
    P[pose + 3, new] = P[new, pose + 3].T
    P[new, new] = G @ covariance[np.ix_(pose, pose)] @ G.T + R @ C @ R.T
    return R @ point_imu + world_T_imu[:3, 3], P


@answer("joint_jacobian")
def _(H_landmark, H_pose, rows, n):
    blocks = []
    for i, row in enumerate(rows):
        parts = [np.zeros((4, 3))] * n + [H_pose[i]]
        parts[row] = H_landmark[i]
        blocks.append(np.hstack(parts))
    return np.vstack(blocks)


@answer("joint_jacobian")
def _(H_landmark, H_pose, rows, n):
    m = len(rows)
    H = np.zeros((m, 4, n, 3))
    H[np.arange(m), :, rows] = H_landmark
    return np.concatenate([H.reshape(m, 4, 3 * n), H_pose], axis=2).reshape(4 * m, -1)


@answer("joint_update")
def _(world_T_imu, landmarks, covariance, H, residual, V):
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta, n = K @ residual, len(landmarks)
    new = [m + delta[3 * j:3 * j + 3] for j, m in enumerate(landmarks)]
    return world_T_imu @ linalg.expm(wedge(delta[3 * n:])), new, (np.eye(len(covariance)) - K @ H) @ covariance


@answer("joint_update")
def _(world_T_imu, landmarks, covariance, H, residual, V):
    P = np.linalg.inv(np.linalg.inv(covariance) + H.T @ np.linalg.inv(V) @ H)
    delta = P @ H.T @ np.linalg.solve(V, residual)
    step = RigidTransform.from_exp_coords(np.r_[delta[-3:], delta[-6:-3]])
    pose = RigidTransform.from_matrix(world_T_imu) * step
    return pose.as_matrix(), landmarks + delta[:-6].reshape(landmarks.shape), P


# --- chapter 6 --------------------------------------------------------------------------------------------

@answer("process_noise")
def _(sigma_v, sigma_omega, tau):
    return np.diag(np.repeat([tau * sigma_v, tau * sigma_omega], 3)**2)


@answer("process_noise")
def _(sigma_v, sigma_omega, tau):
    return linalg.block_diag(tau**2 * sigma_v**2 * I3, tau**2 * sigma_omega**2 * I3)


@answer("nees")
def _(errors, covariances):
    return [e @ np.linalg.inv(P) @ e for e, P in zip(errors, covariances)]


@answer("nees")
def _(errors, covariances):
    return np.einsum("ti,tij,tj->t", errors, np.linalg.inv(covariances), errors)


@answer("chi2_band")
def _(dof, runs, probability):
    low, high = stats.chi2(dof * runs).interval(probability)
    return low / runs, high / runs


@answer("chi2_band")
def _(dof, runs, probability):
    # A chi-square number is a gamma number of shape k/2 and scale 2.
    tail = (1 - probability) / 2
    return [stats.gamma.ppf(q, dof * runs / 2, scale=2 / runs) for q in (tail, 1 - tail)]


# --- chapter 7 --------------------------------------------------------------------------------------------

def _adjoint(T):
    return np.block([[T[:3, :3], skew(T[:3, 3]) @ T[:3, :3]], [np.zeros((3, 3)), T[:3, :3]]])


@answer("invariant_noise")
def _(world_T_imu, landmarks, body_noise):
    B = _adjoint(world_T_imu) @ body_noise
    return np.vstack([skew(m) @ B[3:] for m in landmarks] + [B])


@answer("invariant_noise")
def _(world_T_imu, landmarks, body_noise):
    A = _adjoint(world_T_imu)
    rows = [np.hstack([np.zeros((3, 3)), skew(m) @ world_T_imu[:3, :3]]) for m in landmarks]
    return np.concatenate([*rows, A]) @ body_noise


@answer("invariant_jacobian")
def _(J, world_T_imu):
    H = np.array([j @ np.linalg.inv(world_T_imu[:3, :3]) for j in J])
    return H, np.concatenate([-H, np.zeros(H.shape)], axis=2)


@answer("invariant_jacobian")
def _(J, world_T_imu):
    H = np.einsum("nij,kj->nik", J, world_T_imu[:3, :3])
    return H, H @ np.hstack([-I3, 0 * I3])


@answer("invariant_retract")
def _(world_T_imu, landmarks, delta):
    # SE_{1+n}(3) as one big matrix: rotation, then a column for the position and for each landmark.
    n = len(landmarks)
    state, X = np.eye(4 + n), np.zeros((4 + n, 4 + n))
    state[:3, :4], state[:3, 4:] = world_T_imu[:3], landmarks.T
    X[:3, :3], X[:3, 3], X[:3, 4:] = skew(delta[-3:]), delta[-6:-3], delta[:-6].reshape(n, 3).T
    state = linalg.expm(X) @ state
    T = np.eye(4)
    T[:3] = state[:3, :4]
    return T, state[:3, 4:].T


@answer("invariant_retract")
def _(world_T_imu, landmarks, delta):
    # Each landmark moves as the position does: the pose exponential, once with each translation.
    omega = delta[-3:]
    new = [(linalg.expm(wedge(np.r_[d, omega])) @ np.append(m, 1.0))[:3]
           for m, d in zip(landmarks, delta[:-6].reshape(-1, 3))]
    return linalg.expm(wedge(np.r_[delta[-6:-3], omega])) @ world_T_imu, new


# --- chapters 8 to 10 -------------------------------------------------------------------------------------

@answer("axis_signs")
def _(gyro, seen):
    a, b = gyro - gyro.mean(axis=0), seen - seen.mean(axis=0)
    r = (a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return (r > 0.5) * 1 - (r < -0.5) * 1


@answer("axis_signs")
def _(gyro, seen):
    r = [stats.pearsonr(gyro[:, i], seen[:, i]).statistic for i in range(3)]
    return [math.copysign(1, x) if abs(x) > 0.5 else 0 for x in r]


@answer("window_cost")
def _(first, last, frames):
    seen = [sum(a <= k <= b for a, b in zip(first, last)) for k in range(frames)]
    so_far = [sum(a <= k for a in first) for k in range(frames)]
    return sum(3 * s * (3 * s + 6)**2 for s in seen), sum(3 * s * (3 * n + 6)**2 for s, n in zip(seen, so_far))


@answer("window_cost")
def _(first, last, frames):
    k = np.arange(frames)[:, None]
    seen, so_far = ((first <= k) & (last >= k)).sum(axis=1), (first <= k).sum(axis=1)
    return 27 * np.sum(seen * (seen + 2)**2), 27 * np.sum(seen * (so_far + 2)**2)


@answer("whiteness")
def _(innovations):
    e = innovations - np.mean(innovations)
    return e[1:] @ e[:-1] / (e @ e), 1.96 / len(e)**0.5


@answer("whiteness")
def _(innovations):
    e = [float(x) - sum(innovations) / len(innovations) for x in innovations]
    return [sum(a * b for a, b in itertools.pairwise(e)) / sum(a * a for a in e), 1.96 / math.sqrt(len(e))]


# --- chapter 11 -------------------------------------------------------------------------------------------


@answer("twist_jacobians")
def _(T_this, T_next, tau):
    def twist(a, b):
        X = linalg.logm(np.linalg.inv(T_this @ linalg.expm(wedge(a))) @ T_next @ linalg.expm(wedge(b))).real / tau
        return np.r_[X[:3, 3], X[2, 1], X[0, 2], X[1, 0]]

    h, zero = 1e-3, np.zeros(6)

    def column(f):
        return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)

    return (np.array([column(lambda s, e=e: twist(s * e, zero)) for e in np.eye(6)]).T,
            np.array([column(lambda s, e=e: twist(zero, s * e)) for e in np.eye(6)]).T)


def _curly(x):
    return np.block([[skew(x[3:]), skew(x[:3])], [np.zeros((3, 3)), skew(x[3:])]])


@answer("twist_jacobians")
def _(T_this, T_next, tau):
    # J_l as the integral of exp(s xi^) over s from 0 to 1, out of one matrix exponential.
    X = linalg.logm(np.linalg.inv(T_this) @ T_next).real
    step = np.r_[X[:3, 3], X[2, 1], X[0, 2], X[1, 0]]

    def left(x):
        return linalg.expm(np.block([[_curly(x), np.eye(6)], [np.zeros((6, 12))]]))[:6, 6:]

    return -np.linalg.inv(left(step)) / tau, np.linalg.inv(left(-step)) / tau


@answer("schur")
def _(H, g, n_poses):
    both = np.linalg.solve(H, g)
    return np.linalg.inv(np.linalg.inv(H)[:n_poses, :n_poses]), both[:n_poses], both[n_poses:]


@answer("schur")
def _(H, g, n_poses):
    # Gaussian elimination, one landmark coordinate after the other.
    A, b = H.copy(), g.copy()
    for k in range(len(g) - 1, n_poses - 1, -1):
        for i in range(k):
            factor = A[i, k] / A[k, k]
            A[i, :k + 1] = A[i, :k + 1] - factor * A[k, :k + 1]
            b[i] -= factor * b[k]
    x = np.zeros(len(g))
    x[:n_poses] = np.linalg.solve(A[:n_poses, :n_poses], b[:n_poses])
    for k in range(n_poses, len(g)):
        x[k] = (b[k] - A[k, :k] @ x[:k]) / A[k, k]
    return A[:n_poses, :n_poses], x[:n_poses], x[n_poses:]


@answer("marquardt_step")
def _(r, J, damping):
    # The damping as one more residual for each unknown.
    extra = np.diag(np.sqrt(damping * np.sum(J**2, axis=0)))
    return np.linalg.lstsq(np.vstack([J, extra]), np.r_[-r, np.zeros(J.shape[1])])[0]


@answer("marquardt_step")
def _(r, J, damping):
    H = J.T @ J
    for k in range(len(H)):
        H[k, k] *= 1 + damping
    return -np.linalg.inv(H) @ (J.T @ r)


@answer("robust_weight")
def _(r, c):
    q = [a @ a for a in r]
    return [c * c * math.log(1 + x / c**2) for x in q], [c * c / (c * c + x) for x in q]


@answer("robust_weight")
def _(r, c):
    q = np.linalg.norm(r, axis=1) ** 2
    slope = np.log1p((q + 1e-20j) / c**2).imag * c**2 / 1e-20  # the derivative by a complex step
    return c**2 * np.log1p(q / c**2), slope


# --- chapter 12 -------------------------------------------------------------------------------------------


@answer("pair_covariance")
def _(landmarks, covariance, i, j):
    A = np.zeros((3, len(landmarks), 3))
    A[:, i], A[:, j] = I3, -I3
    A = A.reshape(3, -1)
    return A @ landmarks.ravel(), A @ covariance @ A.T


@answer("pair_covariance")
def _(landmarks, covariance, i, j):
    # As variances of differences, entry by entry.
    S = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            S[a, b] = (covariance[3 * i + a, 3 * i + b] - covariance[3 * i + a, 3 * j + b]
                       - covariance[3 * j + a, 3 * i + b] + covariance[3 * j + a, 3 * j + b])
    return landmarks[i] - landmarks[j], S


@answer("joint_nis")
def _(landmarks, covariance, pairs):
    n = len(landmarks)
    P = covariance.reshape(n, 3, n, 3)
    d = np.concatenate([landmarks[i] - landmarks[j] for i, j in pairs])
    S = np.block([[P[i, :, k] - P[i, :, l] - P[j, :, k] + P[j, :, l] for k, l in pairs] for i, j in pairs])
    return d @ np.linalg.inv(S) @ d, stats.chi2.ppf(0.99, 3 * len(pairs))


@answer("joint_nis")
def _(landmarks, covariance, pairs):
    # The whole map whitened: NIS is the squared length of the least correction that makes all pairs meet.
    L = np.linalg.cholesky(covariance)
    A = np.zeros((3 * len(pairs), len(covariance)))
    for row, (i, j) in enumerate(pairs):
        for a in range(3):
            A[3 * row + a, 3 * i + a] = 1
            A[3 * row + a, 3 * j + a] = -1
    least = np.linalg.lstsq(A @ L, A @ landmarks.ravel())[0]
    return least @ least, stats.chi2.isf(0.01, 3 * len(pairs))


def _drop(landmarks, P, old):
    keep = [k for k in range(len(landmarks)) if k != old]
    rows = [3 * k + a for k in keep for a in range(3)]
    return landmarks[keep], P[rows][:, rows]


@answer("fuse_pair")
def _(landmarks, covariance, new, old):
    # One coordinate after the other: three scalar updates.
    m, P = landmarks.ravel().copy(), covariance.copy()
    for a in range(3):
        h = np.zeros(len(P))
        h[3 * new + a], h[3 * old + a] = 1, -1
        K = P @ h / (h @ P @ h)
        m, P = m - K * (h @ m), P - np.outer(K, h @ P)
    return _drop(m.reshape(-1, 3), P, old)


@answer("fuse_pair")
def _(landmarks, covariance, new, old):
    # In information form: add up the rows and columns of the two, they are one unknown.
    n = len(landmarks)
    keep = [k for k in range(n) if k != old]
    A = np.zeros((n, n - 1))
    for row in range(n):
        A[row, keep.index(new if row == old else row)] = 1
    A = np.kron(A, I3)
    information = np.linalg.inv(covariance)
    P = np.linalg.inv(A.T @ information @ A)
    return (P @ A.T @ information @ landmarks.ravel()).reshape(-1, 3), P


@answer("merge_ids")
def _(n, pairs):
    place = list(range(n))
    for _ in range(n):
        for a, b in pairs:
            place[a] = place[b] = min(place[a], place[b])
    return place


@answer("merge_ids")
def _(n, pairs):
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    a, b = np.array(pairs, int).reshape(-1, 2).T
    label = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[1]
    return [int(np.flatnonzero(label == label[i])[0]) for i in range(n)]


# --- chapter 13: a whole filter, written plainly and by central differences ---------------------------------

def exponential(xi):
    return linalg.expm(wedge(np.asarray(xi)))


def adjoint_of(T):
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = T[:3, :3]
    A[:3, 3:] = skew(T[:3, 3]) @ T[:3, :3]
    return A


def series_jacobian(xi):
    # J_r = sum (-ad)^k / (k + 1)!
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(xi[3:])
    ad[:3, 3:] = skew(xi[:3])
    total = term = np.eye(6)
    for k in range(1, 25):
        term = term @ -ad / (k + 1)
        total = total + term
    return total


@answer("filter_predict")
def predict_by_blocks(T, P, twist, tau, noise):
    step = exponential(tau * twist)
    F, B = adjoint_of(np.linalg.inv(step)), tau * series_jacobian(tau * twist)
    n, new = len(P) - 6, P.copy()
    new[:n, n:] = P[:n, n:] @ F.T
    new[n:, :n] = new[:n, n:].T
    new[n:, n:] = F @ P[n:, n:] @ F.T + B @ noise.twist_covariance @ B.T
    return T @ step, new


@answer("filter_predict")
def predict_with_one_matrix(T, P, twist, tau, noise):
    step = exponential(tau * twist)
    big = linalg.block_diag(np.eye(len(P) - 6), adjoint_of(np.linalg.inv(step)))
    G = np.vstack([np.zeros((len(P) - 6, 6)), tau * series_jacobian(tau * twist)])
    return T @ step, big @ P @ big.T + G @ noise.twist_covariance @ G.T


def full_H(T, landmarks, rows, camera):
    n, H = len(landmarks), []
    for j in rows:
        s = np.linalg.inv(T) @ np.append(landmarks[j], 1)
        q = camera.cam_T_imu @ s
        J = camera.K_s @ (np.eye(4) / q[2] - np.outer(q, [0, 0, 1, 0]) / q[2]**2) @ camera.cam_T_imu[:, :3]
        row = np.zeros((4, 3 * n + 6))
        row[:, 3 * j:3 * j + 3] = J @ T[:3, :3].T
        row[:, 3 * n:] = -J @ np.hstack([I3, -skew(s[:3])])
        H.append(row)
    return np.vstack(H)


@answer("filter_update")
def update_by_gain(T, landmarks, P, rows, z, camera, noise):
    H = full_H(T, landmarks, rows, camera)
    S = H @ P @ H.T + noise.sigma_px**2 * np.eye(len(H))
    K = P @ H.T @ np.linalg.inv(S)
    delta = K @ np.ravel([z[i] - pixels(camera, T, landmarks[j]) for i, j in enumerate(rows)])
    n = landmarks.size
    return T @ exponential(delta[n:]), landmarks + delta[:n].reshape(-1, 3), (np.eye(len(P)) - K @ H) @ P


@answer("filter_update")
def update_by_information(T, landmarks, P, rows, z, camera, noise):
    H = full_H(T, landmarks, rows, camera)
    new = np.linalg.inv(np.linalg.inv(P) + H.T @ H / noise.sigma_px**2)
    residual = np.concatenate([z[i] - pixels(camera, T, landmarks[j]) for i, j in enumerate(rows)])
    delta = new @ H.T @ residual / noise.sigma_px**2
    moved_landmarks = np.array([m + delta[3 * i:3 * i + 3] for i, m in enumerate(landmarks)])
    return T @ exponential(delta[-6:]), moved_landmarks, new


def _stereo_point(z, camera):
    f, b, K = camera.K[0, 0], camera.baseline, camera.K
    depth = f * b / (z[0] - z[2])
    return depth * np.linalg.inv(K) @ np.array([z[0], (z[1] + z[3]) / 2, 1])


@answer("filter_birth")
def birth_by_rows(T, landmarks, P, z, camera, noise):
    R, Rc = T[:3, :3], camera.imu_T_cam[:3, :3]
    q = _stereo_point(z, camera)
    H = (camera.K_s @ (np.eye(4) / q[2] - np.outer(np.append(q, 1), [0, 0, 1, 0]) / q[2]**2))[:, :3]
    C = R @ Rc @ np.linalg.inv(H.T @ H) @ Rc.T @ R.T * noise.sigma_px**2
    s = Rc @ q + camera.imu_T_cam[:3, 3]
    G = np.hstack([R, -R @ skew(s)])
    n = len(P) - 6
    cross = G @ P[n:]
    new = np.block([[P[:n, :n], cross[:, :n].T, P[:n, n:]],
                    [cross[:, :n], G @ P[n:, n:] @ G.T + C, cross[:, n:]],
                    [P[n:, :n], cross[:, n:].T, P[n:, n:]]])
    return np.vstack([landmarks, R @ s + T[:3, 3]]), new


@answer("filter_birth")
def birth_by_a_stack(T, landmarks, P, z, camera, noise):
    # All errors, the pixels' too, as one vector; the new landmark is a linear function of it.
    q, n = _stereo_point(z, camera), len(P) - 6
    H = (camera.K_s @ (np.eye(4) / q[2] - np.outer(np.append(q, 1), [0, 0, 1, 0]) / q[2]**2))[:, :3]
    world_T_cam = T @ np.linalg.inv(camera.cam_T_imu)
    s = np.linalg.inv(camera.cam_T_imu) @ np.append(q, 1)
    A = np.zeros((n + 9, n + 10))
    A[:n, :n], A[n + 3:, n:n + 6] = np.eye(n), np.eye(6)
    A[n:n + 3, n:n + 6] = T[:3, :3] @ np.hstack([I3, -skew(s[:3])])
    A[n:n + 3, n + 6:] = world_T_cam[:3, :3] @ np.linalg.pinv(H)
    point = (T @ s)[:3]
    return np.vstack([landmarks, point]), A @ linalg.block_diag(P, noise.sigma_px**2 * np.eye(4)) @ A.T


def _frame(state, ids, z, camera, noise, update, birth, reverse):
    T, landmarks, known, P = state
    keep = [i for i, name in enumerate(known) if name in ids]
    index = [3 * i + j for i in keep for j in range(3)] + list(range(len(P) - 6, len(P)))
    landmarks, known, P = landmarks[keep], [known[i] for i in keep], P[index][:, index]
    old = [i for i, name in enumerate(ids) if name in known]
    if old:
        rows = np.array([known.index(ids[i]) for i in old])
        T, landmarks, P = update(T, landmarks, P, rows, z[old], camera, noise)
    new = [i for i in range(len(ids)) if i not in old and z[i, 0] - z[i, 2] > 1]
    for i in new[::-1] if reverse else new:
        landmarks, P = birth(T, landmarks, P, z[i], camera, noise)
        known.append(ids[i])
    return T, landmarks, np.array(known, int), P


@answer("filter_frame")
def frame_by_loops(state, ids, z, camera, noise):
    return _frame(state, ids, z, camera, noise, update_by_gain, birth_by_rows, False)


@answer("filter_frame")
def frame_born_backwards(state, ids, z, camera, noise):
    return _frame(state, ids, z, camera, noise, update_by_information, birth_by_a_stack, True)


def _drive(drive, noise, predict, frame):
    state = np.eye(4), np.zeros((0, 3)), np.zeros(0, int), np.array(noise.initial_pose_covariance)
    for k in range(drive.n_frames):
        if k > 0:
            T, P = predict(state[0], state[3], drive.step_twists[k - 1], drive.taus[k - 1], noise)
            state = T, *state[1:3], P
        state = frame(state, *drive.observed(k), drive.camera, noise)
        yield state


@answer("filter_run")
def run_as_a_generator(drive, noise):
    yield from _drive(drive, noise, predict_by_blocks, frame_by_loops)


@answer("filter_run")
def run_as_a_list(drive, noise):
    return list(_drive(drive, noise, predict_with_one_matrix, frame_born_backwards))


@answer("curved_mean")
def curved_by_hessians(f, baseline, point, C):
    def of(a, z):  # second derivatives of f a / z by (a, z)
        return f * np.array([[0, -1 / z**2], [-1 / z**2, 2 * a / z**3]])

    x, y, z = point
    return np.array([np.trace(of(a, z) @ C[np.ix_([i, 2], [i, 2])]) / 2
                     for a, i in ((x, 0), (y, 1), (x - baseline, 0), (y, 1))])


@answer("left_behind")
def left_behind_by_a_selection(landmarks, P, keep):
    rows = [3 * i + j for i in range(len(keep)) if keep[i] for j in range(3)] + list(range(len(P) - 6, len(P)))
    A = np.eye(len(P))[rows]
    return [m for m, stays in zip(landmarks, keep) if stays], A @ P @ A.T


@answer("curved_mean")
def curved_row_by_row(f, baseline, point, C):
    *_, z = point
    offsets = [(0, 0.0), (1, 0.0), (0, baseline), (1, 0.0)]
    return np.array([f * ((point[i] - shift) * C[2, 2] / z**3 - C[i, 2] / z**2) for i, shift in offsets])


@answer("left_behind")
def left_behind_by_deletion(landmarks, P, keep):
    gone = [3 * i + j for i in np.flatnonzero(~keep) for j in range(3)]
    return np.delete(landmarks, np.flatnonzero(~keep), axis=0), np.delete(np.delete(P, gone, 0), gone, 1)


@answer("patch_information")
def information_pixel_by_pixel(g_u, g_v):
    A = sum(np.outer(g, g) for g in zip(g_u.ravel(), g_v.ravel()))
    return A, A.trace() / 2 - np.sqrt((A.trace() / 2)**2 - np.linalg.det(A))


@answer("patch_information")
def information_by_one_product(g_u, g_v):
    g = np.array([g_u.ravel(), g_v.ravel()])
    return g @ g.T, min(np.linalg.eigvals(g @ g.T))


@answer("lucas_kanade_step")
def step_by_least_squares(template, seen, g_u, g_v):
    return np.linalg.lstsq(np.column_stack([g_u.ravel(), g_v.ravel()]), (template - seen).ravel())[0]


@answer("lucas_kanade_step")
def step_by_sums(template, seen, g_u, g_v):
    a, b, d, r = np.sum(g_u**2), np.sum(g_u * g_v), np.sum(g_v**2), template - seen
    p, q = np.sum(g_u * r), np.sum(g_v * r)
    return np.array([d * p - b * q, a * q - b * p]) / (a * d - b * b)


@answer("row_check")
def rows_one_by_one(pixels, tolerance):
    return np.array([abs(b - d) <= tolerance and a - c > 0 for a, b, c, d in pixels])


@answer("row_check")
def rows_by_columns(pixels, tolerance):
    ul, vl, ur, vr = pixels.T
    return np.logical_and.reduce([vl - vr <= tolerance, vr - vl <= tolerance, ul > ur])


@answer("rectify_point")
def rectified_by_a_homography(uv, K, rectified_R_cam, K_new):
    x, y, z = K_new @ rectified_R_cam @ np.linalg.inv(K) @ [*uv, 1]
    return np.array([x / z, y / z])


@answer("rectify_point")
def rectified_by_a_ray(uv, K, rectified_R_cam, K_new):
    ray = rectified_R_cam @ [(uv[0] - K[0, 2]) / K[0, 0], (uv[1] - K[1, 2]) / K[1, 1], 1.0]
    return K_new[:2, :2] @ (ray[:2] / ray[2]) + K_new[:2, 2]


# --- chapter 16 -------------------------------------------------------------------------------------------

@answer("velocity_rows")
def _(rotation, force, tau):
    return np.hstack([-tau * rotation @ skew(force), np.zeros((3, 3)), I3, np.zeros((3, 3)), -tau * rotation])


@answer("velocity_rows")
def _(rotation, force, tau):
    F = np.zeros((3, 15))
    for i in range(3):
        F[:, i] = tau * rotation @ np.cross(I3[i], force)
        F[i, 6 + i] = 1
        F[:, 12 + i] = -tau * rotation[:, i]
    return F


@answer("rotation_bias_jacobian")
def _(omega, taus):
    def total(delta):
        R = Rotation.identity()
        for w, tau in zip(omega, taus):
            R = R * Rotation.from_rotvec(tau * (w - delta))
        return R
    h = 1e-3
    columns = []
    for e in I3:
        turn = [(total(np.zeros(3)).inv() * total(k * h * e)).as_rotvec() for k in (-2, -1, 1, 2)]
        columns.append((turn[0] - 8 * turn[1] + 8 * turn[2] - turn[3]) / (12 * h))
    return np.transpose(columns)


@answer("rotation_bias_jacobian")
def _(omega, taus):
    J = np.zeros((3, 3))
    for k in range(len(omega)):
        later = I3
        for w, tau in zip(omega[k + 1:], taus[k + 1:]):
            later = later @ linalg.expm(skew(tau * w))
        phi = skew(taus[k] * omega[k])
        J_r = sum(np.linalg.matrix_power(-phi, n) / math.factorial(n + 1) for n in range(20))
        J -= later.T @ J_r * taus[k]
    return J


@answer("project_track")
def _(H_x, H_f, residual):
    N = linalg.null_space(H_f.T)
    return (N.T @ H_x).T @ (N.T @ H_x), (N.T @ H_x).T @ (N.T @ residual)


@answer("project_track")
def _(H_x, H_f, residual):
    W = H_x.T @ H_f
    V = np.linalg.inv(H_f.T @ H_f)
    return H_x.T @ H_x - W @ V @ W.T, H_x.T @ residual - W @ V @ H_f.T @ residual


@answer("first_estimates_jacobian")
def _(J, first_pose, first_landmark, pose, landmark):
    R, p = first_pose[:3, :3], first_pose[:3, 3]
    return np.c_[J @ R.T, -J, J @ skew(R.T @ (first_landmark - p))]


@answer("first_estimates_jacobian")
def _(J, first_pose, first_landmark, pose, landmark):
    s = (np.linalg.inv(first_pose) @ np.append(first_landmark, 1))[:3]
    by_rotation = np.column_stack([J @ np.cross(s, e) for e in I3])
    return np.concatenate([J @ first_pose[:3, :3].T, -J, by_rotation], axis=1)


@answer("datasheet")
def _(angle_random_walk, velocity_random_walk, rate):
    hour = 3600
    return math.radians(angle_random_walk) * math.sqrt(rate / hour), velocity_random_walk * math.sqrt(rate / hour)


@answer("datasheet")
def _(angle_random_walk, velocity_random_walk, rate):
    angle_variance = (angle_random_walk * np.pi / 180)**2 / 3600
    return (angle_variance * rate)**0.5, (velocity_random_walk**2 / 3600 * rate)**0.5
