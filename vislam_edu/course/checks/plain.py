"""A plain answer to each exercise, written as a student would write it, with the symbols of the statement.

Nobody calls these to compute anything: `mutants` makes small changes in them, one at a time, to find the change that
turns the right answer into a student's. So a line does one thing, and nothing is shared between the answers.
"""

import numpy as np

from ... import kalman, se3, stereo

# --- chapter 1 --------------------------------------------------------------------------------------------


def so3_hat(omega):
    x, y, z = omega
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def se3_hat(xi):
    v, omega = xi[:3], xi[3:]
    X = np.zeros((4, 4))
    X[:3, :3] = se3.so3_hat(omega)
    X[:3, 3] = v
    return X


def so3_exp(phi):
    t = np.linalg.norm(phi)
    S = se3.so3_hat(phi)
    if t < 1e-6:
        return np.eye(3) + S
    return np.eye(3) + np.sin(t) / t * S + (1 - np.cos(t)) / t**2 * (S @ S)


def se3_exp(xi):
    v, omega = xi[:3], xi[3:]
    t = np.linalg.norm(omega)
    S = se3.so3_hat(omega)
    R = se3.so3_exp(omega)
    V = np.eye(3) + S / 2
    if t > 1e-6:
        V = np.eye(3) + (1 - np.cos(t)) / t**2 * S + (t - np.sin(t)) / t**3 * (S @ S)
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = V @ v
    return T


def adjoint(T):
    R, p = T[:3, :3], T[:3, 3]
    A = np.zeros((6, 6))
    A[:3, :3] = R
    A[:3, 3:] = se3.so3_hat(p) @ R
    A[3:, 3:] = R
    return A


def left_jacobian(xi):
    X = np.zeros((6, 6))
    X[:3, :3] = se3.so3_hat(xi[3:])
    X[:3, 3:] = se3.so3_hat(xi[:3])
    X[3:, 3:] = se3.so3_hat(xi[3:])
    J = np.eye(6)
    term = np.eye(6)
    for n in range(1, 30):
        term = term @ X / (n + 1)
        J = J + term
    return J


def dead_reckon(world_T_imu, twists, taus):
    poses = [world_T_imu]
    for k in range(len(taus)):
        poses.append(poses[k] @ se3.exp(taus[k] * twists[k]))
    return np.array(poses)


def predict_covariance(covariance, twist, tau, Q):
    F = se3.adjoint(se3.exp(-tau * twist))
    B = tau * se3.right_jacobian(tau * twist)
    return F @ covariance @ F.T + B @ Q @ B.T


def datasheet_noise(angle_random_walk, velocity_density, rate):
    tau = 1 / rate
    gyro_density = np.radians(angle_random_walk) / np.sqrt(3600)
    sigma_v = velocity_density * np.sqrt(rate)
    sigma_omega = gyro_density * np.sqrt(rate)
    W = np.zeros((6, 6))
    W[:3, :3] = tau**2 * sigma_v**2 * np.eye(3)
    W[3:, 3:] = tau**2 * sigma_omega**2 * np.eye(3)
    return W


# --- chapter 2 --------------------------------------------------------------------------------------------


def bearing(K, uv):
    x = (uv[0] - K[0, 2]) / K[0, 0]
    y = (uv[1] - K[1, 2]) / K[1, 1]
    return np.array([x, y, 1.0])


def triangulate_bearings(K, uv1, uv2, R, p):
    z1 = stereo.bearing(K, uv1)
    z2 = stereo.bearing(K, uv2)
    a = R.T @ z1
    b = R.T @ p
    a = a - a[2] * z2
    b = b - b[2] * z2
    depth = (a @ b) / (a @ a)
    return depth * z1


def triangulate_bearings__least_squares(K, uv1, uv2, R, p):
    z1 = stereo.bearing(K, uv1)
    z2 = stereo.bearing(K, uv2)
    A = np.column_stack([z1, -R @ z2])
    depths = np.linalg.inv(A.T @ A) @ A.T @ p
    return depths[0] * z1


def triangulate(K, baseline, pixels):
    u_left, v_left, u_right, _v_right = pixels.T
    d = u_left - u_right
    ok = d > 0
    z = K[0, 0] * baseline / d
    x = z * (u_left - K[0, 2]) / K[0, 0]
    y = z * (v_left - K[1, 2]) / K[1, 1]
    return np.column_stack([x, y, z]), ok


def triangulation_covariance(K, baseline, point, sigma_px):
    x, y, z = point
    f_u, f_v = K[0, 0], K[1, 1]
    H = np.array([[f_u / z, 0, -f_u * x / z**2],
                  [0, f_v / z, -f_v * y / z**2],
                  [f_u / z, 0, -f_u * (x - baseline) / z**2],
                  [0, f_v / z, -f_v * y / z**2]])
    return sigma_px**2 * np.linalg.inv(H.T @ H)


# --- chapter 3 --------------------------------------------------------------------------------------------


def project(camera, points_cam):
    x, y, z = points_cam.T
    q = np.stack([x, y, z, np.ones(len(z))])
    return (camera.K_s @ (q / q[2])).T


def project__by_columns(camera, points_cam):
    K = camera.K_s
    x, y, z = points_cam.T
    u_left = K[0, 0] * x / z + K[0, 2]
    v_left = K[1, 1] * y / z + K[1, 2]
    u_right = K[0, 0] * x / z + K[0, 2] + K[2, 3] / z
    return np.column_stack([u_left, v_left, u_right, v_left])


def projection_jacobian(camera, point_cam):
    x, y, z = point_cam
    D = np.array([[1 / z, 0, -x / z**2, 0],
                  [0, 1 / z, -y / z**2, 0],
                  [0, 0, 0, 0],
                  [0, 0, -1 / z**2, 1 / z]])
    return camera.K_s @ D


def landmark_jacobian(camera, world_T_imu, landmark):
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    s = R.T @ (landmark - p)
    q = camera.cam_T_imu[:3, :3] @ s + camera.cam_T_imu[:3, 3]
    J = camera.projection_jacobian(q)[:, :3]
    return J @ camera.cam_T_imu[:3, :3] @ R.T


def kalman_update(covariance, H, V, residual):
    S = H @ covariance @ H.T + V
    K = covariance @ H.T @ np.linalg.inv(S)
    A = np.eye(len(covariance)) - K @ H
    return K @ residual, A @ covariance @ A.T + K @ V @ K.T


def kalman_update__short(covariance, H, V, residual):
    S = H @ covariance @ H.T + V
    K = covariance @ H.T @ np.linalg.inv(S)
    return K @ residual, (np.eye(len(covariance)) - K @ H) @ covariance


def stacked_noise__kron(V, n):
    return np.kron(np.eye(n), V)


def stacked_noise(V, n):
    W = np.zeros((4 * n, 4 * n))
    for i in range(n):
        W[4 * i:4 * i + 4, 4 * i:4 * i + 4] = V
    return W


def correct_landmarks(landmarks, ids, accepted, delta):
    new = landmarks.copy()
    for i in range(len(ids)):
        if accepted[i]:
            new[ids[i]] += delta[i]
    return new


# --- chapter 4 --------------------------------------------------------------------------------------------


def odot(point):
    D = np.zeros((4, 6))
    D[:3, :3] = np.eye(3)
    D[:3, 3:] = -se3.so3_hat(point)
    return D


def pose_jacobian(camera, world_T_imu, landmark):
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    s = R.T @ (landmark - p)
    q = camera.cam_T_imu[:3, :3] @ s + camera.cam_T_imu[:3, 3]
    J = camera.projection_jacobian(q)[:, :3] @ camera.cam_T_imu[:3, :3]
    return -J @ np.hstack([np.eye(3), -se3.so3_hat(s)])


def pose_update(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
    predicted = camera.observe(world_T_imu, landmarks)[0]
    residual = (pixels - predicted).ravel()
    H = camera.pose_jacobian(world_T_imu, landmarks).reshape(-1, 6)
    V = sigma_px**2 * np.eye(len(residual))
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta = K @ residual
    return world_T_imu @ se3.exp(delta), (np.eye(6) - K @ H) @ covariance


# --- chapter 5 --------------------------------------------------------------------------------------------


def predict_joint(covariance, F, W):
    n = len(covariance) - 6
    P = covariance.copy()
    P[n:, n:] = F @ covariance[n:, n:] @ F.T + W
    P[:n, n:] = covariance[:n, n:] @ F.T
    P[n:, :n] = F @ covariance[n:, :n]
    return P


def predict_joint__whole(covariance, F, W):
    n = len(covariance) - 6
    A = np.eye(n + 6)
    A[n:, n:] = F
    P = A @ covariance @ A.T
    P[n:, n:] += W
    return P


def new_landmark(covariance, world_T_imu, point_imu, C):
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    n = len(covariance) - 6
    G = R @ np.hstack([np.eye(3), -se3.so3_hat(point_imu)])
    cross = G @ covariance[n:]
    own = G @ covariance[n:, n:] @ G.T + R @ C @ R.T
    P = np.zeros((n + 9, n + 9))
    old = np.r_[:n, n + 3:n + 9]
    P[np.ix_(old, old)] = covariance
    P[n:n + 3, old] = cross
    P[old, n:n + 3] = cross.T
    P[n:n + 3, n:n + 3] = own
    return R @ point_imu + p, P


def joint_jacobian(H_landmark, H_pose, rows, n):
    H = np.zeros((4 * len(rows), 3 * n + 6))
    for i in range(len(rows)):
        H[4 * i:4 * i + 4, 3 * rows[i]:3 * rows[i] + 3] = H_landmark[i]
        H[4 * i:4 * i + 4, 3 * n:] = H_pose[i]
    return H


def joint_update(world_T_imu, landmarks, covariance, H, residual, V):
    n = 3 * len(landmarks)
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta = K @ residual
    P = (np.eye(n + 6) - K @ H) @ covariance
    return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3), P


# --- chapters 6 and 7 -------------------------------------------------------------------------------------


def process_noise(sigma_v, sigma_omega, tau):
    variances = [sigma_v**2, sigma_v**2, sigma_v**2, sigma_omega**2, sigma_omega**2, sigma_omega**2]
    return tau**2 * np.diag(variances)


def nees(errors, covariances):
    values = []
    for k in range(len(errors)):
        e, P = errors[k], covariances[k]
        values.append(e @ np.linalg.inv(P) @ e)
    return np.array(values)


def chi2_band(dof, runs, probability):
    from scipy.stats import chi2

    tail = (1 - probability) / 2
    low = chi2.ppf(tail, dof * runs) / runs
    high = chi2.ppf(1 - tail, dof * runs) / runs
    return low, high


def invariant_noise(world_T_imu, landmarks, body_noise):
    B = se3.adjoint(world_T_imu) @ body_noise
    rows = []
    for k in range(len(landmarks)):
        m = landmarks[k]
        rows.append(se3.so3_hat(m) @ B[3:])
    rows.append(B)
    return np.vstack(rows)


def invariant_jacobian(J, world_T_imu):
    R = world_T_imu[:3, :3]
    H_landmark = J @ R.T
    H_pose = np.concatenate([-H_landmark, np.zeros(J.shape)], axis=-1)
    return H_landmark, H_pose


def invariant_retract(world_T_imu, landmarks, delta):
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    n = 3 * len(landmarks)
    x_p, x_R = delta[n:n + 3], delta[n + 3:]
    turn = se3.so3_exp(x_R)
    J = se3.so3_left_jacobian(x_R)
    T = np.eye(4)
    T[:3, :3] = turn @ R
    T[:3, 3] = turn @ p + J @ x_p
    moved = []
    for m, x_m in zip(landmarks, delta[:n].reshape(-1, 3)):
        moved.append(turn @ m + J @ x_m)
    return T, np.array(moved)


# --- chapters 11 and 12 -----------------------------------------------------------------------------------


def twist_jacobians(T_this, T_next, tau):
    step = se3.log(se3.inverse(T_this) @ T_next)
    by_this = -np.linalg.inv(se3.left_jacobian(step)) / tau
    by_next = np.linalg.inv(se3.right_jacobian(step)) / tau
    return by_this, by_next


def schur(H, g, n_poses):
    U, E, V = H[:n_poses, :n_poses], H[:n_poses, n_poses:], H[n_poses:, n_poses:]
    a, b = g[:n_poses], g[n_poses:]
    S = U - E @ np.linalg.inv(V) @ E.T
    x = np.linalg.inv(S) @ (a - E @ np.linalg.inv(V) @ b)
    m = np.linalg.inv(V) @ (b - E.T @ x)
    return S, x, m


def marquardt_step(r, J, damping):
    H = J.T @ J
    D = np.diag(np.diag(H))
    return np.linalg.solve(H + damping * D, -J.T @ r)


def robust_weight(r, c):
    q = np.sum(r**2, axis=1)
    cost = c**2 * np.log(1 + q / c**2)
    weight = 1 / (1 + q / c**2)
    return cost, weight


def pair_covariance(landmarks, covariance, i, j):
    a, b = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
    P = covariance
    return landmarks[i] - landmarks[j], P[a, a] + P[b, b] - P[a, b] - P[b, a]


def joint_nis(landmarks, covariance, pairs):
    A = np.zeros((3 * len(pairs), 3 * len(landmarks)))
    for k, (i, j) in enumerate(pairs):
        A[3 * k:3 * k + 3, 3 * i:3 * i + 3] = np.eye(3)
        A[3 * k:3 * k + 3, 3 * j:3 * j + 3] = -np.eye(3)
    d = A @ landmarks.ravel()
    S = A @ covariance @ A.T
    return d @ np.linalg.inv(S) @ d, kalman.gate_threshold(0.99, len(d))


def fuse_pair(landmarks, covariance, new, old):
    n = len(landmarks)
    H = np.zeros((3, 3 * n))
    H[:, 3 * new:3 * new + 3] = np.eye(3)
    H[:, 3 * old:3 * old + 3] = -np.eye(3)
    S = H @ covariance @ H.T
    K = covariance @ H.T @ np.linalg.inv(S)
    delta = K @ (landmarks[old] - landmarks[new])
    moved = landmarks + delta.reshape(-1, 3)
    P = covariance - K @ H @ covariance
    rows = np.arange(3 * old, 3 * old + 3)
    return np.delete(moved, old, axis=0), np.delete(np.delete(P, rows, axis=0), rows, axis=1)


def merge_ids(n, pairs):
    place = np.arange(n)
    for new, old in pairs:
        a, b = place[new], place[old]
        place[(place == a) | (place == b)] = min(a, b)
    return place


# --- chapters 8 to 10 -------------------------------------------------------------------------------------


def axis_signs(gyro, seen):
    signs = np.zeros(3)
    for i in range(3):
        r = np.corrcoef(gyro[:, i], seen[:, i])[0, 1]
        if abs(r) > 0.5:
            signs[i] = np.sign(r)
    return signs


def window_cost(first, last, frames):
    window, dense = 0, 0
    for k in range(frames):
        seen = np.sum((first <= k) & (k <= last))
        so_far = np.sum(first <= k)
        window = window + 3 * seen * (3 * seen + 6)**2
        dense = dense + 3 * seen * (3 * so_far + 6)**2
    return window, dense


def whiteness(innovations):
    e = innovations - np.mean(innovations)
    correlation = np.sum(e[1:] * e[:-1]) / np.sum(e**2)
    return correlation, 1.96 / np.sqrt(len(e))


# --- chapter 13 -------------------------------------------------------------------------------------------


def filter_predict(world_T_imu, covariance, twist, tau, noise):
    step = se3.exp(tau * twist)
    F = se3.adjoint(se3.exp(-tau * twist))
    B = tau * se3.right_jacobian(tau * twist)
    Q = noise.twist_covariance
    n = len(covariance) - 6
    P = covariance.copy()
    P[n:, n:] = F @ covariance[n:, n:] @ F.T + B @ Q @ B.T
    P[:n, n:] = covariance[:n, n:] @ F.T
    P[n:, :n] = F @ covariance[n:, :n]
    return world_T_imu @ step, P


def filter_update(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    n = 3 * len(landmarks)
    H = np.zeros((4 * len(rows), n + 6))
    V = np.zeros((4 * len(rows), 4 * len(rows)))
    residual = np.zeros(4 * len(rows))
    for i in range(len(rows)):
        j = rows[i]
        k = slice(4 * i, 4 * i + 4)
        H[k, 3 * j:3 * j + 3] = camera.landmark_jacobian(world_T_imu, landmarks[j])
        H[k, n:] = camera.pose_jacobian(world_T_imu, landmarks[j])
        V[k, k] = noise.pixel_covariance
        residual[k] = pixels[i] - camera.observe(world_T_imu, landmarks[j])[0]
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta = K @ residual
    P = (np.eye(n + 6) - K @ H) @ covariance
    return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3), P


def filter_birth(world_T_imu, landmarks, covariance, pixels, camera, noise):
    n = len(covariance) - 6
    q = camera.triangulate(pixels)[0]
    s = se3.transform(camera.imu_T_cam, q)
    C = camera.triangulation_covariance(q, noise.sigma_px)
    R, R_cam = world_T_imu[:3, :3], camera.imu_T_cam[:3, :3]
    G = R @ np.hstack([np.eye(3), -se3.so3_hat(s)])
    cross = G @ covariance[n:]
    own = G @ covariance[n:, n:] @ G.T + R @ R_cam @ C @ R_cam.T @ R.T
    P = np.zeros((n + 9, n + 9))
    old = np.r_[:n, n + 3:n + 9]
    P[np.ix_(old, old)] = covariance
    P[n:n + 3, old] = cross
    P[old, n:n + 3] = cross.T
    P[n:n + 3, n:n + 3] = own
    return np.vstack([landmarks, se3.transform(world_T_imu, s)]), P


def curved_mean(f, baseline, point, covariance):
    x, y, z = point
    C = covariance
    u_left = f / z**2 * (x / z * C[2, 2] - C[0, 2])
    v = f / z**2 * (y / z * C[2, 2] - C[1, 2])
    u_right = f / z**2 * ((x - baseline) / z * C[2, 2] - C[0, 2])
    return np.array([u_left, v, u_right, v])


def left_behind(landmarks, covariance, keep):
    pose = np.ones(6, bool)
    stay = np.concatenate([np.repeat(keep, 3), pose])
    P = covariance[stay][:, stay]
    return landmarks[keep], P
