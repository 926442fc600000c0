"""Exercises of notebook 03: the projection, its derivative, and the Kalman update of landmarks."""

import numpy as np

from ... import kalman, mapping, stereo
from ...stereo import StereoCamera
from ..checks.exercise import exercise
from ..checks.inputs import CAMERA, random_camera, random_covariance, random_landmarks, random_points_cam, random_pose


def points(rng):
    yield "one point, 10 m ahead", (CAMERA, np.array([[0.0, 0.0, 10.0]]))
    for _ in range(5):
        yield "random", (random_camera(rng), random_points_cam(rng, 4))


@exercise(chapter=3, cases=points, shows=[StereoCamera.project, stereo.pi, vars(StereoCamera)["K_s"].func], hints=[
    "Make the points homogeneous, q = [x, y, z, 1], divide by the depth, multiply with camera.K_s.",
    "(camera.K_s @ (q / q[:, 2:3]).T).T; the last entry of q / q_3 is 1/z, which is what the baseline needs."])
def project(camera, points_cam):
    """Pixels of points: K_s pi(q) with q = [x, y, z, 1] and pi(q) = q / q_3.

    camera : StereoCamera; camera.K_s is the stereo calibration matrix (4, 4). points_cam : (n, 3), m, in the left
    camera, all in front of it. Returns (n, 4), [u_left, v_left, u_right, v_right], px.
    """
    x, y, z = points_cam.T
    q = np.stack([x, y, z, np.ones(len(z))])
    return (camera.K_s @ (q / q[2])).T


@project.otherwise
def _(camera, points_cam):
    K = camera.K_s
    x, y, z = points_cam.T
    u_left = K[0, 0] * x / z + K[0, 2]
    v_left = K[1, 1] * y / z + K[1, 2]
    u_right = K[0, 0] * x / z + K[0, 2] + K[2, 3] / z
    return np.column_stack([u_left, v_left, u_right, v_left])


project.slip("not divided by depth", "Perspective is the division by the depth q_3: pi(q) = q / q_3.",
    ("q / q[2]", "q"))
project.slip("baseline not divided by depth", """Divide all of q by its depth, the 1 at its end too: the shift between
    the images is f_u b / z, not f_u b.""", ("q / q[2]", "np.vstack([q[:3] / z, q[3:]])"))
project.slip("right camera on the left", "The right camera sees everything further left: u_right = u_left - f_u b / z.",
    ("np.ones(len(z))", "-np.ones(len(z))"))
project.slip("no baseline", "u_right is not u_left: the right camera is moved by the baseline.",
    ("np.ones(len(z))", "np.zeros(len(z))"))
project.slip("principal point forgotten", "Pixels are counted from the corner of the image: add c_u and c_v.",
    ("(q / q[2])).T", "(q / q[2])).T - camera.K_s[:, 2]"))
project.slip("divided by the distance", """The depth is the coordinate along the optical axis, q_3, not the distance to
    the point.""", ("q / q[2]", "q / np.linalg.norm(q[:3], axis=0)"))
project.slip("all divided by the first depth", "Each point is divided by its own depth.", ("q / q[2]", "q / q[2, 0]"))
project.slip("columns in another order", "The order is u_left, v_left, u_right, v_right.",
    ("(q / q[2])).T", "(q / q[2])).T[:, [0, 2, 1, 3]]"))


def one_point(rng):
    yield "10 m ahead", (CAMERA, np.array([0.0, 0.0, 10.0]))
    for _ in range(6):
        yield "random", (random_camera(rng), random_points_cam(rng, 1)[0])


@exercise(chapter=3, cases=one_point, shows=[StereoCamera.projection_jacobian, stereo.dpi_dq], hints=[
    "Differentiate each of the four entries of q / q_3 by each entry of q; K_s is a constant factor.",
    "1/q_3 [[1, 0, -q_1/q_3, 0], [0, 1, -q_2/q_3, 0], [0, 0, 0, 0], [0, 0, -q_4/q_3, 1]], K_s in front."])
def projection_jacobian(camera, point_cam):
    """Derivative of the pixels by the homogeneous point: K_s dpi/dq at q = [x, y, z, 1].

    camera : StereoCamera (camera.K_s). point_cam : (3,), m, in the left camera. Returns (4, 4), px/m.
    """
    x, y, z = point_cam
    D = np.array([[1 / z, 0, -x / z**2, 0],
                  [0, 1 / z, -y / z**2, 0],
                  [0, 0, 0, 0],
                  [0, 0, -1 / z**2, 1 / z]])
    return camera.K_s @ D


projection_jacobian.slip("1/q3 forgotten", """The whole matrix carries a factor 1/q_3: a point twice as far away moves
    half as much in the image.""", ("@ D", "@ (z * D)"))
projection_jacobian.slip("third column divided once", """The third column is divided by q_3 twice: d(q_1 / q_3) / d q_3
    = -q_1 / q_3^2.""", ("-x / z**2", "-x / z"), ("-y / z**2", "-y / z"), ("-1 / z**2", "-1 / z"))
projection_jacobian.slip("sign of the third column", "d(1 / q_3) / d q_3 is negative: -q_1 / q_3^2.", ("-x", "x"),
    ("-y", "y"), ("-1", "1"))
projection_jacobian.slip("third column forgotten", """Moving a point away moves its pixels towards the centre: the
    derivative by q_3 is not zero.""", ("-x / z**2", "0"), ("-y / z**2", "0"), ("-1 / z**2", "0"))
projection_jacobian.slip("third row not zero", """The third entry of q / q_3 is always 1: its derivative is zero, by q_3
    too.""", ("[0, 0, 0, 0]", "[0, 0, 1 / z, 0]"))
projection_jacobian.slip("K_s forgotten", "This is dpi/dq alone; the pixels are K_s pi(q).", ("camera.K_s @ D", "D"))
projection_jacobian.slip("1/z once in the rows of x and y", """d (x / z) / d z = -x / z^2: the depth enters squared in
    all rows, not only in the last.""", ("-x / z**2", "-x / z"), ("-y / z**2", "-y / z"))
projection_jacobian.slip("sign of x and y in the third column", """d (x / z) / d z = -x / z^2, negative as in the last
    row.""", ("-x", "x"), ("-y", "y"))


def one_landmark(rng):
    for _ in range(6):
        world_T_imu, camera = random_pose(rng), random_camera(rng)
        yield "random", (camera, world_T_imu, random_landmarks(rng, world_T_imu, 1, camera)[0])


@exercise(chapter=3, cases=one_landmark, hints=[
    "Chain rule: world to IMU, IMU to camera, camera to pixels. Only the rotations of the first two steps remain.",
    "(camera.projection_jacobian(q) @ camera.cam_T_imu)[:, :3] @ R.T with q the landmark in the camera frame."],
    shows=[StereoCamera.landmark_jacobian, StereoCamera.measurement_jacobian, StereoCamera.projection_jacobian])
def landmark_jacobian(camera, world_T_imu, landmark):
    """Derivative of the pixels K_s pi(cam_T_imu T^-1 m) by the landmark m.

    camera : StereoCamera (cam_T_imu, projection_jacobian, to_cam). world_T_imu : (4, 4). landmark : (3,), m,
    world. Returns (4, 3), px/m.
    """
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    s = R.T @ (landmark - p)
    q = camera.cam_T_imu[:3, :3] @ s + camera.cam_T_imu[:3, 3]
    J = camera.projection_jacobian(q)[:, :3]
    return J @ camera.cam_T_imu[:3, :3] @ R.T


landmark_jacobian.slip("extrinsics forgotten", """Between the IMU and the camera there is a rotation too: cam_T_imu
    belongs between K_s dpi/dq and R^T.""", ("J @ camera.cam_T_imu[:3, :3]", "J"))
landmark_jacobian.slip("pose in place of its inverse", """Landmarks go from the world to the IMU: T^-1, so R^T. The
    report's section 3.2.2 writes T.""", ("@ R.T", "@ R"))
landmark_jacobian.slip("R^T forgotten", "This is the derivative by the point in the IMU frame; R^T is missing.",
    (" @ R.T\n", "\n"))
landmark_jacobian.slip("1/q3 forgotten", "dpi/dq carries a factor 1/q_3.", ("J @", "q[2] * J @"))
landmark_jacobian.slip("sign flipped", """Only the pose enters through its inverse; the derivative by the landmark has
    no minus.""", ("J @", "-J @"))
landmark_jacobian.slip("imu_T_cam in place of cam_T_imu", "From the IMU to the camera goes cam_T_imu.",
    ("@ camera.cam_T_imu", "@ camera.imu_T_cam"))
landmark_jacobian.slip("taken at the point in the IMU frame", """dpi/dq is taken at q, the point in the camera frame,
    depth along z. In the IMU frame z points up.""", ("jacobian(q)", "jacobian(s)"))
landmark_jacobian.slip("R^T and the extrinsics exchanged", """From the world to the camera: R^T first, then cam_T_imu.
    The first acts first, so it stands on the right.""",
    ("camera.cam_T_imu[:3, :3] @ R.T\n", "R.T @ camera.cam_T_imu[:3, :3]\n"))
landmark_jacobian.slip("projection alone", """This is the derivative by the point in the camera frame. The landmark is
    in the world: cam_T_imu and R^T follow.""", ("J @ camera.cam_T_imu[:3, :3] @ R.T", "J"))


def updates(rng):
    for n, m in [(1, 1), (3, 2), (3, 2), (6, 4), (6, 4)]:
        label = "random" if n > 1 else "1 unknown, 1 measurement"
        yield label, (random_covariance(rng, n, 1.0), rng.normal(size=(m, n)), random_covariance(rng, m, 1.0),
                      rng.normal(size=m))


@exercise(chapter=3, cases=updates, shows=[kalman.update, kalman.gain, kalman.innovation_covariance],
          outputs=("delta", "covariance"), hints=[
    "First S, then the gain K = P H^T S^-1 (np.linalg.solve rather than an inverse), then the two results.",
    "delta = K r; covariance = (I - K H) P (I - K H)^T + K V K^T, the Joseph form, equal to (I - K H) P on paper."])
def kalman_update(covariance, H, V, residual):
    """One Kalman update: the correction of the mean and the new covariance.

    covariance : (n, n). H : (m, n). V : (m, m), noise. residual : (m,), measured minus predicted.
    Returns delta (n,), to be added to the mean, and the covariance (n, n) afterwards.
    """
    S = H @ covariance @ H.T + V
    K = covariance @ H.T @ np.linalg.inv(S)
    return K @ residual, (np.eye(len(covariance)) - K @ H) @ covariance


@kalman_update.otherwise
def _joseph(covariance, H, V, residual):
    S = H @ covariance @ H.T + V
    K = covariance @ H.T @ np.linalg.inv(S)
    A = np.eye(len(covariance)) - K @ H
    return K @ residual, A @ covariance @ A.T + K @ V @ K.T


kalman_update.slip("noise left out of S", """S = H P H^T + V: the residual also scatters by the noise of the
    measurement.""", (" + V", ""))
kalman_update.slip("covariance of the wrong sign", """A measurement never makes you less sure: (I - K H) P, not (I + K
    H) P.""", ("- K @ H", "+ K @ H"))
kalman_update.slip("covariance not updated", "The mean has moved, so the filter has learned: the covariance shrinks.",
    ("(np.eye(len(covariance)) - K @ H) @ covariance", "covariance"))
kalman_update.slip("Joseph form without K V K^T", """(I - K H) P (I - K H)^T is only half of the Joseph form; the noise
    that came in through the gain is the other half.""", (" + K @ V @ K.T", ""), of=_joseph)
kalman_update.slip("correction of the wrong sign", """The residual is measured minus predicted: the state moves by plus
    K r.""", ("return K", "return -K"))
kalman_update.slip("S not inverted", "The gain is P H^T S^-1: solve with S, do not multiply by it.",
    ("np.linalg.inv(S)", "S"))
kalman_update.slip("gain without the covariance", """The gain is P H^T S^-1: without P it does not know what is
    uncertain.""", ("K = covariance @ H.T", "K = H.T"))


def noises(rng):
    yield "one measurement", (random_covariance(rng, 4, 1.0), 1)
    for n in (2, 3, 5):
        yield "random", (random_covariance(rng, 4, 1.0), n)


@exercise(chapter=3, cases=noises, shows=[np.kron], hints=[
    "Write it down for two measurements: V upper left, V lower right. What stands between different measurements?",
    "A Kronecker product with an identity: np.kron(np.eye(n), V)."])
def stacked_noise(V, n):
    """Covariance of n stereo measurements in one long vector: I (x) V, V on the diagonal, zero elsewhere.

    V : (4, 4), px^2, of one measurement. n : how many. Returns (4n, 4n), px^2, measurement after measurement.
    """
    W = np.zeros((4 * n, 4 * n))
    for i in range(n):
        W[4 * i:4 * i + 4, 4 * i:4 * i + 4] = V
    return W


@stacked_noise.otherwise
def _by_kron(V, n):
    return np.kron(np.eye(n), V)


stacked_noise.slip("np.tile in place of the Kronecker product", """np.tile repeats V everywhere: then all measurements
    share one noise, and the filter believes that two landmarks err together.""",
    ("np.kron(np.eye(n), V)", "np.tile(V, (n, n))"), of=_by_kron)
stacked_noise.slip("Kronecker product the wrong way round", """np.kron(V, I) groups all u_left, then all v_left, and so
    on. Here each measurement keeps its four numbers together: I first.""", ("np.eye(n), V", "V, np.eye(n)"),
    of=_by_kron)
stacked_noise.slip("correlations dropped", """Only the diagonal of V has arrived. V is a full matrix and its blocks are
    copied whole.""", ("= V", "= np.diag(np.diag(V))"))
stacked_noise.slip("V of one measurement", """One V for each of the n measurements: (4n, 4n), not the sum or mean of
    them.""", ("range(n)", "range(1)"))


def corrections(rng):
    yield "all accepted", (rng.normal(size=(3, 3)), np.array([0, 1, 2]), np.ones(3, bool), rng.normal(size=(3, 3)))
    for _ in range(4):
        ids = rng.choice(8, size=5, replace=False)
        accepted = rng.permutation([True, False, True, True, False])
        yield "random", (rng.normal(size=(8, 3)), ids, accepted, rng.normal(size=(5, 3)))


@exercise(chapter=3, cases=corrections, shows=[mapping.run], hints=[
    "Which rows of landmarks do the accepted measurements belong to? Index once, with one array.",
    "new = landmarks.copy(); new[ids[accepted]] += delta[accepted]"])
def correct_landmarks(landmarks, ids, accepted, delta):
    """The map after the corrections of one frame; landmarks keeps its values, the result is a new array.

    landmarks : (M, 3), m. ids : (n,), rows of landmarks that were measured. accepted : (n,) bool, which of these
    passed the gate. delta : (n, 3), m, correction of each measured landmark. Returns (M, 3), m.
    """
    new = landmarks.copy()
    for i in range(len(ids)):
        if accepted[i]:
            new[ids[i]] += delta[i]
    return new


correct_landmarks.slip("chained indexing updates a copy", """new[ids][accepted] += ... changes the temporary array that
    new[ids] made, and nothing else. Index once: new[ids[accepted]] += delta[accepted].""",
    ("return new", "return landmarks"))
correct_landmarks.slip("gate ignored", "Measurements that the gate rejected must not move their landmark.",
    ("if accepted[i]", "if True"))
correct_landmarks.slip("first rows instead of the accepted ones", """delta has a row for each measurement, rejected ones
    included: pick delta[accepted], not its first rows.""", ("delta[i]", "delta[accepted[:i].sum()]"))
correct_landmarks.slip("correction put in place of the landmark", """delta is a correction: add it (+=), do not assign
    it (=).""", ("+=", "="))
