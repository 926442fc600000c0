"""A joint filter that is as plain as can be: full H, all four rows, explicit inverse, nothing ever dropped.

Written from the equations with numpy and `scipy.linalg.expm` alone, in loops, to hold the package's filter against.
Right perturbation. The state is a dict of landmarks and one dense covariance, the pose LAST, landmarks by birth.
"""

import numpy as np
from scipy.linalg import expm


def hat3(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def hat4(x):
    out = np.zeros((4, 4))
    out[:3, :3] = hat3(x[3:])
    out[:3, 3] = x[:3]
    return out


def curly(x):
    return np.block([[hat3(x[3:]), hat3(x[:3])], [np.zeros((3, 3)), hat3(x[3:])]])


def right_jacobian(x):
    """Sum over n of (-curly)^n / (n + 1)!."""
    term, total = np.eye(6), np.eye(6)
    for n in range(1, 25):
        term = term @ -curly(x) / (n + 1)
        total = total + term
    return total


def project(camera, T, m):
    """h(T, m) and its Jacobians with respect to m and to the right perturbation of T."""
    C = camera.cam_T_imu
    s = np.linalg.inv(T) @ np.append(m, 1)
    x, y, z = (C @ s)[:3]
    fu, fv, cu, cv, b = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], camera.baseline
    h = np.array([fu * x / z + cu, fv * y / z + cv, fu * (x - b) / z + cu, fv * y / z + cv])
    by_cam = np.array([[fu / z, 0, -fu * x / z**2], [0, fv / z, -fv * y / z**2],
                       [fu / z, 0, -fu * (x - b) / z**2], [0, fv / z, -fv * y / z**2]])
    by_imu = by_cam @ C[:3, :3]
    return h, z, by_imu @ T[:3, :3].T, by_imu @ -np.hstack([np.eye(3), -hat3(s[:3])])


def triangulate(camera, z):
    """The point in the IMU frame that fits one measurement best, and the covariance per unit pixel variance."""
    fu, fv, cu, cv, b = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], camera.baseline
    depth = fu * b / (z[0] - z[2])
    q = np.array([(z[0] - cu) * depth / fu, ((z[1] + z[3]) / 2 - cv) * depth / fv, depth])
    imu_T_cam = np.linalg.inv(camera.cam_T_imu)
    s = (imu_T_cam @ np.append(q, 1))[:3]
    H = project(camera, np.eye(4), s)[2]
    return s, np.linalg.inv(H.T @ H)


def run(drive, noise, threshold, min_disparity, as_report=False):
    """Yields (T, pose covariance, {id: (mean, covariance)}, NIS by id) after every frame."""
    camera, V = drive.camera, noise.sigma_px**2 * np.eye(4)
    T, P = np.eye(4), np.array(noise.initial_pose_covariance)
    ids, means = [], {}
    for k in range(drive.n_frames):
        n = 3 * len(ids)
        if k > 0:
            tau, u = drive.taus[k - 1], drive.step_twists[k - 1]
            T = T @ expm(tau * hat4(u))
            F = np.eye(n + 6)
            F[n:, n:] = expm(-tau * curly(u))
            W = np.zeros((n + 6, n + 6))
            B = right_jacobian(tau * u)
            W[n:, n:] = tau**2 * B @ np.diag([noise.sigma_v**2] * 3 + [noise.sigma_omega**2] * 3) @ B.T
            P = F @ P @ F.T + W

        seen, pixels = drive.observed(k)

        def born(T, P, seen=seen, pixels=pixels):
            for i, z in zip(seen, pixels):
                if i in means or z[0] - z[2] <= min_disparity:
                    continue
                n = 3 * len(ids)
                s, C = triangulate(camera, z)
                means[i] = (T @ np.append(s, 1))[:3]
                R = T[:3, :3]
                A = np.zeros((n + 9, n + 6))  # old state -> [landmarks, the new one, pose]
                A[:n, :n], A[n + 3:, n:] = np.eye(n), np.eye(6)
                extra = np.zeros((n + 9, n + 9))
                if as_report:
                    extra[n:n + 3, n:n + 3] = noise.landmark_prior * np.eye(3)
                else:
                    A[n:n + 3, n:] = R @ np.hstack([np.eye(3), -hat3(s)])
                    extra[n:n + 3, n:n + 3] = noise.sigma_px**2 * R @ C @ R.T
                P = A @ P @ A.T + extra
                ids.append(i)
            return P

        if as_report:
            P = born(T, P)
        n = 3 * len(ids)
        H, r, nis = [], [], {}
        for i, z in zip(seen, pixels):
            if i not in means:
                continue
            h, depth, H_m, H_T = project(camera, T, means[i])
            row = np.zeros((4, n + 6))
            j = 3 * ids.index(i)
            row[:, j:j + 3], row[:, n:] = H_m, H_T
            nis[i] = (z - h) @ np.linalg.inv(row @ P @ row.T + V) @ (z - h)
            if depth <= 0.1:
                nis[i] = np.inf
            elif nis[i] <= threshold:
                H.append(row)
                r.append(z - h)
        if H:
            H, r = np.vstack(H), np.concatenate(r)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.kron(np.eye(len(r) // 4), V))
            delta = K @ r
            A = np.eye(n + 6) - K @ H
            P = A @ P @ A.T + K @ np.kron(np.eye(len(r) // 4), V) @ K.T
            for j, i in enumerate(ids):
                means[i] = means[i] + delta[3 * j:3 * j + 3]
            T = T @ expm(hat4(delta[n:]))
        if not as_report:
            P = born(T, P)
        n = 3 * len(ids)
        yield T, P[n:, n:], {i: (means[i], P[3 * j:3 * j + 3, 3 * j:3 * j + 3]) for j, i in enumerate(ids)}, nis
