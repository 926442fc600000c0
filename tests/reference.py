"""Pieces of the filters in plain loops, from numpy and `scipy.linalg.expm` alone, to compare the package with."""

import numpy as np


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
