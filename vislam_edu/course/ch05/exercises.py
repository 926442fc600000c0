"""Exercises of notebook 05: one Gaussian over landmarks and pose, landmarks first."""

import numpy as np

from ... import ekf_slam, kalman, se3
from ..checks.exercise import exercise
from ..checks.inputs import random_covariance, random_pose


def joint_predictions(rng):
    yield "no landmark yet", (random_covariance(rng, 6), se3.adjoint(random_pose(rng)), random_covariance(rng, 6))
    for n in (1, 2, 4):
        yield "random", (random_covariance(rng, 3 * n + 6), se3.adjoint(random_pose(rng, 1.0)),
                         random_covariance(rng, 6))


@exercise(chapter=5, cases=joint_predictions, shows=[ekf_slam.predict_joint], hints=[
    "Landmarks stand still, the pose error is multiplied by F: the whole transition is block_diag(I, F).",
    "P_LL stays; P_LR becomes P_LR F^T and P_RL becomes F P_RL; P_RR becomes F P_RR F^T + W."])
def predict_joint(covariance, F, W):
    """The joint covariance after one step of the IMU: the pose moves, the landmarks do not.

    covariance : (3n+6, 3n+6), landmarks first, then the pose. F : (6, 6), transition of the pose error. W : (6, 6).
    Returns (3n+6, 3n+6).
    """
    n = len(covariance) - 6
    P = covariance.copy()
    P[n:, n:] = F @ covariance[n:, n:] @ F.T + W
    P[:n, n:] = covariance[:n, n:] @ F.T
    P[n:, :n] = F @ covariance[n:, :n]
    return P


@predict_joint.otherwise
def _by_one_matrix(covariance, F, W):
    n = len(covariance) - 6
    A = np.eye(n + 6)
    A[n:, n:] = F
    P = A @ covariance @ A.T
    P[n:, n:] += W
    return P


predict_joint.slip("cross-covariances not propagated", """Only the pose block was carried along. What ties pose and
    landmarks together moves too: P_LR becomes P_LR F^T, P_RL becomes F P_RL.""",
    ("covariance[:n, n:] @ F.T", "covariance[:n, n:]"), ("F @ covariance[n:, :n]", "covariance[n:, :n]"))
predict_joint.slip("one cross-covariance not written", """Both cross blocks change, one is the transpose of the other:
    writing P_LR alone leaves the matrix unsymmetric.""", ("F @ covariance[n:, :n]", "covariance[n:, :n]"))
predict_joint.slip("cross-covariances set to zero", """Moving does not make the pose independent of the map: P_LR
    becomes P_LR F^T, not zero.""", ("covariance[:n, n:] @ F.T", "0"), ("F @ covariance[n:, :n]", "0"))
predict_joint.slip("cross-covariances without the transpose", """Covariance of landmark error and F times pose error is
    P_LR F^T: the transpose stands on the right.""", ("covariance[:n, n:] @ F.T", "covariance[:n, n:] @ F"),
    ("F @ covariance[n:, :n]", "F.T @ covariance[n:, :n]"))
predict_joint.slip("chained indexing updates a copy", """P[rows][:, columns] = ... changes the temporary array that
    P[rows] made, if rows is an array or a mask. Use P[np.ix_(rows, columns)] or slices, P[n:, n:].""",
    ("return P", "return covariance"))
predict_joint.slip("pose taken to come first", """The state is ordered landmarks first, then pose: the pose is the last
    six.""", ("A[n:, n:]", "A[:6, :6]"), ("P[n:, n:]", "P[:6, :6]"), of=_by_one_matrix)
predict_joint.slip("noise carried along by F", """W is expressed in the body frame at the end of the step already: F
    P_RR F^T + W.""", ("F @ covariance[n:, n:] @ F.T + W", "F @ (covariance[n:, n:] + W) @ F.T"))


def births(rng):
    yield "the first landmark", (random_covariance(rng, 6), random_pose(rng), np.array([8.0, 1.0, 0.5]),
                                 random_covariance(rng, 3, 0.3))
    for n in (1, 2, 3):
        yield "random", (random_covariance(rng, 3 * n + 6), random_pose(rng),
                                     np.array([8.0, 0.0, 0.0]) + rng.normal(size=3), random_covariance(rng, 3, 0.3))


@exercise(chapter=5, cases=births, shows=[ekf_slam.new_landmark],
          outputs=("landmark", "covariance"), hints=[
    "m = R s + p. An error of the pose moves the new landmark by G e, an error of s by R times it.",
    "G = R [I, -s^]; own block G P_RR G^T + R C R^T; with every old variable G P[-6:], landmarks included."])
def new_landmark(covariance, world_T_imu, point_imu, C):
    """A landmark joins the state, its first measurement used once; it stands after the old landmarks, before the pose.

    covariance : (3n+6, 3n+6), [landmarks, pose], right perturbation. world_T_imu : (4, 4). point_imu : (3,), m, the
    triangulated point s in the IMU frame. C : (3, 3), m^2, covariance of its triangulation, in the IMU frame.
    Returns the landmark (3,), m, world, and the covariance (3n+9, 3n+9). You may use `se3`.
    """
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


new_landmark.slip("no correlation with the pose", """The landmark was placed from the pose, so it shares the pose's
    error: its cross-covariances are G P_R., not zero.""",
    ("cross = G @ covariance[n:]", "cross = np.zeros((3, n + 6))"))
new_landmark.slip("cross-covariances with old landmarks never written", """The pose is correlated with the landmarks
    that are there already, and the new one inherits that: G P_RL.""",
    ("cross = G @ covariance[n:]", "cross = np.hstack([np.zeros((3, n)), G @ covariance[n:, n:]])"))
new_landmark.slip("pose assumed known", """R C R^T is the landmark's uncertainty if the pose were exact. The pose's own
    error comes on top: G P_RR G^T, and the correlation with it.""",
    ("cross = G @ covariance[n:]", "cross = np.zeros((3, n + 6))"), ("G @ covariance[n:, n:] @ G.T + ", ""))
new_landmark.slip("the report's 2 I", """The report gives every new landmark 2 m^2 per axis and no correlation. A far
    one is known worse, a near one better, and all of them share the error of the pose.""",
    ("cross = G @ covariance[n:]", "cross = np.zeros((3, n + 6))"),
    ("G @ covariance[n:, n:] @ G.T + R @ C @ R.T", "2 * np.eye(3)"))
new_landmark.slip("first measurement used twice", """The triangulation has used the first measurement up. An update with
    it counts the same pixels again, and the covariance comes out too small.""",
    ("return R",
     "H = np.hstack([np.zeros((3, n)), R.T, -np.eye(3), se3.so3_hat(point_imu)])\n"
     "    P = kalman.update(P, H, C, np.zeros(3))[1]\n"
     "    return R"))
new_landmark.slip("triangulation not turned into the world", """C is expressed in the IMU frame, the landmark in the
    world: R C R^T.""", ("R @ C @ R.T", "C"))
new_landmark.slip("world and body mixed", """[I, -m^] belongs to a perturbation expressed in the world frame. For the
    right perturbation G = R [I, -s^], s in the IMU frame.""",
    ("R @ np.hstack([np.eye(3), -se3.so3_hat(point_imu)])", "np.hstack([np.eye(3), -se3.so3_hat(R @ point_imu + p)])"))
new_landmark.slip("put after the pose", """The order is landmarks first, then pose: the new landmark goes in front of
    the pose.""", ("n + 3:n + 9", "n:n + 6"), ("P[n:n + 3, old]", "P[n + 6:, old]"),
    ("P[old, n:n + 3]", "P[old, n + 6:]"), ("P[n:n + 3, n:n + 3]", "P[n + 6:, n + 6:]"))
new_landmark.slip("turned the other way", "From the IMU into the world goes R, so C becomes R C R^T.",
    ("R @ C @ R.T", "R.T @ C @ R"))
new_landmark.slip("landmark in the world in place of s", """G = R [I, -s^] with s in the IMU frame: the pose turns about
    the IMU, not about the world's origin.""", ("so3_hat(point_imu)", "so3_hat(R @ point_imu + p)"))


def jacobians(rng):
    yield "one landmark", (rng.normal(size=(1, 4, 3)), rng.normal(size=(1, 4, 6)), np.array([0]), 1)
    for rows in ([0, 1], [2, 0, 3], [1, 4, 2, 0]):
        m = len(rows)
        yield "random", (rng.normal(size=(m, 4, 3)), rng.normal(size=(m, 4, 6)), np.array(rows), 5)


@exercise(chapter=5, cases=jacobians, shows=[ekf_slam.joint_jacobian], hints=[
    "Four rows for each measurement. In them only two blocks are not zero: its own landmark's and the pose's.",
    "H[4*i:4*i+4, 3*rows[i]:3*rows[i]+3] = H_landmark[i] and H[4*i:4*i+4, 3*n:] = H_pose[i]"])
def joint_jacobian(H_landmark, H_pose, rows, n):
    """Jacobian of m stereo measurements by the joint state [landmark 0, landmark 1, ..., pose].

    H_landmark : (m, 4, 3), px/m. H_pose : (m, 4, 6), px per [m, rad]. rows : (m,), which landmark of the state each
    measurement shows. n : landmarks in the state. Returns (4m, 3n+6), measurement after measurement.
    """
    H = np.zeros((4 * len(rows), 3 * n + 6))
    for i in range(len(rows)):
        H[4 * i:4 * i + 4, 3 * rows[i]:3 * rows[i] + 3] = H_landmark[i]
        H[4 * i:4 * i + 4, 3 * n:] = H_pose[i]
    return H


joint_jacobian.slip("interleaved and grouped orders mixed", """The state is x0 y0 z0 x1 y1 z1 ...: landmark j has
    columns 3j to 3j+2. Columns j, j+n, j+2n belong to an order that groups all x, all y, all z.""",
    ("3 * rows[i]:3 * rows[i] + 3", "rows[i]:3 * n:n"))
joint_jacobian.slip("rows grouped by coordinate", """The rows go measurement after measurement: u_left, v_left, u_right,
    v_right of the first, then of the second. Here all u_left come first.""",
    ("4 * i:4 * i + 4, 3 * rows", "i::len(rows), 3 * rows"), ("4 * i:4 * i + 4, 3 * n:", "i::len(rows), 3 * n:"))
joint_jacobian.slip("rows ignored", """Measurement i shows landmark rows[i], not landmark i: its block goes to columns 3
    rows[i] and on.""", ("3 * rows[i]:3 * rows[i] + 3", "3 * i:3 * i + 3"))
joint_jacobian.slip("pose taken to come first", """The state is ordered landmarks first, then pose: the pose has the
    last six columns.""", ("3 * rows[i]:3 * rows[i] + 3", "6 + 3 * rows[i]:9 + 3 * rows[i]"), ("3 * n:]", ":6]"))
joint_jacobian.slip("pose block forgotten", """Every measurement depends on the pose too: its block goes into the last
    six columns.""", ("H_pose[i]", "0"))


def joint_updates(rng):
    for n in (1, 2, 3):
        d = 3 * n + 6
        yield "random" if n > 1 else "1 landmark", (
            random_pose(rng), rng.normal(size=(n, 3)), random_covariance(rng, d, 0.3),
            rng.normal(size=(4 * n, d)), rng.normal(size=4 * n), random_covariance(rng, 4 * n, 0.5))


@exercise(chapter=5, cases=joint_updates, shows=[ekf_slam.joint_update, kalman.update],
          outputs=("world_T_imu", "landmarks", "covariance"), tolerance=1e-7, hints=[
    "One Kalman update over the whole state; then its correction is cut into landmarks (added) and pose (exponential).",
    "delta, P = kalman.update(...); landmarks + delta[:3n].reshape(n, 3); world_T_imu @ se3.exp(delta[3n:])"])
def joint_update(world_T_imu, landmarks, covariance, H, residual, V):
    """EKF update of landmarks and pose together.

    world_T_imu : (4, 4). landmarks : (n, 3), m. covariance : (3n+6, 3n+6), [landmarks, pose], right perturbation.
    H : (k, 3n+6). residual : (k,), px, measured minus predicted. V : (k, k), px^2.
    Returns world_T_imu (4, 4), landmarks (n, 3) and covariance (3n+6, 3n+6). You may use `se3` and `kalman.update`.
    """
    n = 3 * len(landmarks)
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta = K @ residual
    P = (np.eye(n + 6) - K @ H) @ covariance
    return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3), P


joint_update.slip("interleaved and grouped orders mixed", """delta is x0 y0 z0 x1 y1 z1 ...: reshape(n, 3). With
    reshape(3, n).T the coordinates of different landmarks change places.""",
    ("delta[:n].reshape(-1, 3)", "delta[:n].reshape(3, -1).T"))
joint_update.slip("cross-covariances cut", """Landmarks and pose were taken for independent. Their correlation is what
    lets a measurement of one landmark correct the others.""",
    ("K = ", "covariance = covariance.copy()\n    covariance[:n, n:], covariance[n:, :n] = 0, 0\n    K = "))
joint_update.slip("chained indexing updates a copy", """new[seen][...] += ... changes a temporary array: the landmarks
    came back as they were. Index once.""", ("landmarks + delta[:n].reshape(-1, 3)", "landmarks"))
joint_update.slip("world and body mixed", """The pose's correction is a right perturbation, expressed in the body frame:
    T exp(delta^), not exp(delta^) T.""", ("world_T_imu @ se3.exp(delta[n:])", "se3.exp(delta[n:]) @ world_T_imu"))
joint_update.slip("pose not corrected", "The last six entries of delta correct the pose.",
    ("world_T_imu @ se3.exp(delta[n:])", "world_T_imu"))
joint_update.slip("correction added", "T (I + delta^) is no pose any more. Use the exponential.",
    ("se3.exp(delta[n:])", "(np.eye(4) + se3.hat(delta[n:]))"))
