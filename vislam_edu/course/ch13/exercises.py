"""Exercises of notebook 13: the pieces of a joint filter, in the order in which a frame uses them.

Everything is plain arrays. A state is the tuple (world_T_imu (4, 4), landmarks (n, 3), ids (n,), covariance
(3n+6, 3n+6)), landmarks before the pose. The filter is that of `ekf_slam` to first order, without a gate, and it drops
the landmarks that are out of sight. Source: report section 3.3.2, corrected.
"""

import numpy as np
from scipy.linalg import block_diag

from ... import ekf_slam, kalman, se3, stereo, window_slam
from ...noise import Noise
from ...simulate import first_steps
from ..checks import inputs
from ..checks.exercise import exercise
from ..checks.running import Unreadable

NOISE = Noise()
MIN_DISPARITY = 1.0  # px, below it a landmark waits for a better view

# --- what the pieces are tried on -------------------------------------------------------------------------


def predictions(rng):
    for n in (0, 1, 3):
        twist = np.append(rng.normal([10, 0, 0], 1.0), 0.3 * rng.normal(size=3))
        yield "no landmark yet" if n == 0 else "a small map", (
            inputs.random_pose(rng), inputs.random_covariance(rng, 3 * n + 6), twist, rng.uniform(0.05, 0.2), NOISE)


def _scene(rng, n):
    T = inputs.random_pose(rng)
    landmarks = inputs.random_landmarks(rng, T, n)
    pixels = inputs.CAMERA.observe(T, landmarks)[0] + rng.normal(size=(n, 4))
    return T, landmarks, inputs.random_covariance(rng, 3 * n + 6), pixels


def updates(rng):
    for label, n, rows in [("one landmark", 1, [0]), ("all landmarks", 4, [0, 1, 2, 3]), ("some landmarks", 5, [1, 3])]:
        T, landmarks, P, pixels = _scene(rng, n)
        yield label, (T, landmarks, P, np.array(rows), pixels[rows], inputs.CAMERA, NOISE)
    T, landmarks, P, pixels = _scene(rng, 4)
    yield "in another order", (T, landmarks, P, np.array([3, 0, 2]), pixels[[3, 0, 2]], inputs.CAMERA, NOISE)


def births(rng):
    for n in (0, 1, 3):
        T, landmarks, P, pixels = _scene(rng, n + 1)
        yield "the first landmark" if n == 0 else "a further landmark", (
            T, landmarks[:n], P[3:, 3:], pixels[-1], inputs.CAMERA, NOISE)


def frames(rng):
    T, landmarks, P, pixels = _scene(rng, 6)
    yield "nothing known", (
        (T, landmarks[:0], np.empty(0, int), P[18:, 18:]), np.arange(6), pixels, inputs.CAMERA, NOISE)
    state = (T, landmarks[:4], np.array([2, 5, 7, 8]), P[6:, 6:])
    yield "all known", (state, np.array([2, 5, 7, 8]), pixels[:4], inputs.CAMERA, NOISE)
    yield "one lost, two new", (state, np.array([2, 7, 8, 9, 11]), pixels[[0, 2, 3, 4, 5]], inputs.CAMERA, NOISE)
    far = pixels.copy()
    far[4, 2] = far[4, 0] - 0.5
    yield "one of the new ones too far", (state, np.array([2, 7, 8, 9, 11]), far[[0, 2, 3, 4, 5]], inputs.CAMERA, NOISE)
    yield "nothing in view", (state, np.empty(0, int), np.empty((0, 4)), inputs.CAMERA, NOISE)


# --- predict ----------------------------------------------------------------------------------------------


def _predicted(T, P, twist, tau, noise, *, mean=None, F=None, W=None):
    step = se3.exp(tau * twist)
    F = se3.adjoint(se3.inverse(step)) if F is None else F
    B = tau * se3.right_jacobian(tau * twist)
    new = ekf_slam.predict_joint(P, F, B @ noise.twist_covariance @ B.T if W is None else W)
    return T @ step if mean is None else mean, new


@exercise(chapter=13, cases=predictions, outputs=("world_T_imu", "covariance"),
          shows=[ekf_slam.predict, ekf_slam.predict_joint], hints=[
    "The pose moves to T exp(tau u^). Its error is carried along by F = Ad(exp(-tau u^)); landmarks stand still.",
    "P_RR becomes F P_RR F^T + B Q B^T with B = tau J_r(tau u) and Q the covariance of one IMU sample, "
    "P_LR becomes P_LR F^T, P_LL stays."])
def filter_predict(world_T_imu, covariance, twist, tau, noise):
    """Steps 1 and 2: the pose and the joint covariance after tau seconds along the measured twist.

    world_T_imu : (4, 4). covariance : (3n+6, 3n+6), landmarks first, then the pose. twist : (6,) [v, omega], m/s and
    rad/s. tau : s. noise : `Noise`; `noise.twist_covariance` is that of one IMU sample, and an error of the sample
    moves the pose by tau J_r(tau twist) times itself. Returns world_T_imu and covariance.
    """
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


filter_predict.slip("cross-covariances not propagated", """Only the pose block was carried along: P_LR becomes P_LR
F^T, P_RL its transpose.""", ("P[:n, n:] = covariance[:n, n:] @ F.T\n", "\n"),
                    ("P[n:, :n] = F @ covariance[n:, :n]", ""))


filter_predict.slip("not scaled by tau", "W = tau^2 Q: the twist's variance is not that of one step.",
                    ("tau * se3.right_jacobian(tau * twist)", "se3.right_jacobian(tau * twist)"))


filter_predict.slip("right Jacobian left out", """W = tau^2 Q is the report's form. An error of the sample moves the
pose by tau J_r(tau u): write B Q B^T.""", ("se3.right_jacobian(tau * twist)", "np.eye(6)"))


filter_predict.slip("transition of the other direction", "F = Ad(exp(-tau u^)), with the minus sign.", ("-tau", "tau"))


filter_predict.slip("world and body mixed", "The twist is measured in the body: its motion stands on the right.",
                    ("world_T_imu @ step", "step @ world_T_imu"))


@filter_predict.mistake("rotation and translation swapped", "A twist is [v, omega], translation first.")
def _(world_T_imu, covariance, twist, tau, noise):
    return _predicted(world_T_imu, covariance, np.roll(twist, 3), tau, noise)


@filter_predict.mistake("degrees", "The gyro gives radians per second already.")
def _(world_T_imu, covariance, twist, tau, noise):
    return _predicted(world_T_imu, covariance, np.append(twist[:3], np.radians(twist[3:])), tau, noise)


# --- update -----------------------------------------------------------------------------------------------


def _H(T, landmarks, rows, camera, pose=1.0, frame=None):
    seen = landmarks[rows]
    H_pose = camera.pose_jacobian(T, seen) if frame is None else frame(camera, T, seen)
    return ekf_slam.joint_jacobian(camera.landmark_jacobian(T, seen), pose * H_pose, rows, len(landmarks))


def _updated(T, landmarks, P, rows, pixels, camera, noise, H=None, retract=None):
    H = _H(T, landmarks, rows, camera) if H is None else H
    V = np.kron(np.eye(len(rows)), noise.pixel_covariance)
    residual = (pixels - camera.observe(T, landmarks[rows])[0]).ravel()
    if retract is None:
        return ekf_slam.joint_update(T, landmarks, P, H, residual, V)
    delta, P = kalman.update(P, H, V, residual)
    n = landmarks.size
    return *retract(T, landmarks, delta[:n], delta[n:]), P


@exercise(chapter=13, cases=updates, outputs=("world_T_imu", "landmarks", "covariance"),
          shows=[ekf_slam.joint_jacobian, ekf_slam.joint_update], hints=[
    "H has four rows for each measurement: three columns of its landmark, six of the pose, zeros elsewhere.",
    "K = P H^T (H P H^T + V)^-1, delta = K (measured - predicted). Landmarks by +, the pose by T exp(delta^), "
    "P becomes (I - K H) P."])
def filter_update(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    """Steps 3 to 5: the whole state corrected by the measurements of one frame, to first order.

    landmarks : (n, 3), m, world. covariance : (3n+6, 3n+6). pixels : (m, 4); measurement i shows landmark rows[i].
    camera : `StereoCamera`; of (world_T_imu, landmark), `observe` returns the pixels and whether it is in front of the
    camera, `landmark_jacobian` (4, 3), `pose_jacobian` (4, 6). noise.pixel_covariance : (4, 4). Returns world_T_imu,
    landmarks and covariance.
    """
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


filter_update.slip("pose sign flipped", "The pose part of H is -J [I, -s^]: the observation model holds T^-1.",
    ("camera.pose_jacobian(world_T_imu, landmarks[j])", "-camera.pose_jacobian(world_T_imu, landmarks[j])"))


def _odot_without_extrinsics(camera, T, m):
    q = camera.to_cam(T, m)
    return -camera.projection_jacobian(q) @ se3.odot(se3.transform(se3.inverse(T), m))


@filter_update.mistake("extrinsics forgotten", "Between the camera and the body stands cam_T_imu, in H as well.")
def _(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    return _updated(world_T_imu, landmarks, covariance, rows, pixels, camera, noise,
                    H=_H(world_T_imu, landmarks, rows, camera, frame=_odot_without_extrinsics))


@filter_update.mistake("1/q3 forgotten", "dpi/dq has the factor 1 / q_3, the depth.")
def _(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    depth = np.repeat(camera.to_cam(world_T_imu, landmarks[rows])[:, 2], 4)[:, None]
    return _updated(world_T_imu, landmarks, covariance, rows, pixels, camera, noise,
                    H=depth * _H(world_T_imu, landmarks, rows, camera))


filter_update.slip("world and body mixed", "The correction is expressed in the body: T exp(delta^).",
                   ("world_T_imu @ se3.exp(delta[n:])", "se3.exp(delta[n:]) @ world_T_imu"))


filter_update.slip("a copy updated", "landmarks[rows][:] += ... changes a temporary array: the landmarks stayed.",
                   ("landmarks + delta[:n].reshape(-1, 3)", "landmarks"))


@filter_update.mistake("only the seen landmarks corrected", """The others are correlated with the pose and move too:
this is what the joint covariance is for.""")
def _(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    def retract(T, m, d, e):
        moved = m.copy()
        moved[rows] += d.reshape(-1, 3)[rows]
        return T @ se3.exp(e), moved
    return _updated(world_T_imu, landmarks, covariance, rows, pixels, camera, noise, retract=retract)


filter_update.slip("orders mixed", "delta holds x, y, z of one landmark after the other: reshape(n, 3).",
                   ("delta[:n].reshape(-1, 3)", "delta[:n].reshape(3, -1).T"))


@filter_update.mistake("cross terms never written", """After the update the landmarks and the pose are correlated: the
whole of (I - K H) P is kept.""")
def _(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    T, m, P = _updated(world_T_imu, landmarks, covariance, rows, pixels, camera, noise)
    n = len(m)
    return T, m, block_diag(*(P[3 * i:3 * i + 3, 3 * i:3 * i + 3] for i in range(n)), P[3 * n:, 3 * n:])


@filter_update.mistake("columns of another landmark", """Measurement i shows landmark rows[i]: its block stands in the
columns 3 rows[i] to 3 rows[i] + 3 of H, not 3 i.""")
def _(world_T_imu, landmarks, covariance, rows, pixels, camera, noise):
    seen = landmarks[rows]
    H = ekf_slam.joint_jacobian(camera.landmark_jacobian(world_T_imu, seen), camera.pose_jacobian(world_T_imu, seen),
                                np.arange(len(rows)), len(landmarks))
    return _updated(world_T_imu, landmarks, covariance, rows, pixels, camera, noise, H=H)


# --- birth ------------------------------------------------------------------------------------------------


def _born(T, landmarks, P, pixels, camera, noise, point=None, cross=True, C=None):
    cam = camera.triangulate(pixels)[0] if point is None else point
    R = camera.imu_T_cam[:3, :3]
    C = R @ camera.triangulation_covariance(cam, noise.sigma_px) @ R.T if C is None else C
    landmark, new = ekf_slam.new_landmark(P, T, se3.transform(camera.imu_T_cam, cam), C)
    n = landmarks.size
    if not cross:
        own = slice(n, n + 3)
        block = new[own, own].copy()
        new[own], new[:, own] = 0, 0
        new[own, own] = block
    return np.vstack([landmarks, landmark]), new


@exercise(chapter=13, cases=births, outputs=("landmarks", "covariance"), shows=[ekf_slam.new_landmark], hints=[
    "Triangulate in the camera frame, then imu_T_cam, then the pose. m = R s + p depends on the pose too.",
    "G = R [I, -s^]: own block G P_RR G^T + R C R^T, with every old variable G P[-6:]. C is the triangulation "
    "covariance turned into the IMU frame. The new rows stand between the old landmarks and the pose."])
def filter_birth(world_T_imu, landmarks, covariance, pixels, camera, noise):
    """A new landmark joins as the last of the landmarks, correlated with the pose that saw it.

    landmarks : (n, 3), m, world. covariance : (3n+6, 3n+6). pixels : (4,). camera : `StereoCamera`;
    `triangulate(pixels)` returns point_cam (3,), m, and whether it can be used,
    `triangulation_covariance(point_cam, sigma_px)` (3, 3) is in the camera frame too; `imu_T_cam` (4, 4).
    noise.sigma_px : px. Returns landmarks (n+1, 3) and covariance (3n+9, 3n+9).
    """
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


filter_birth.slip("no correlation with the pose", """The new landmark inherits the error of the pose: its cross
terms are G P[-6:], not zero.""", ("cross = G", "cross = 0 * G"))


@filter_birth.mistake("pixels used as bearings", "The bearing is K^-1 [u, v, 1], not [u, v, 1].")
def _(world_T_imu, landmarks, covariance, pixels, camera, noise):
    point = camera.triangulate(pixels)[0]
    return _born(world_T_imu, landmarks, covariance, pixels, camera, noise,
                 point=point[2] * np.array([pixels[0], pixels[1], 1.0]))


@filter_birth.mistake("extrinsics forgotten", "The triangulated point is in the camera frame: imu_T_cam comes first.")
def _(world_T_imu, landmarks, covariance, pixels, camera, noise):
    point = camera.triangulate(pixels)[0]
    C = camera.triangulation_covariance(point, noise.sigma_px)
    landmark, P = ekf_slam.new_landmark(covariance, world_T_imu, point, C)
    return np.vstack([landmarks, landmark]), P


@filter_birth.mistake("covariance not turned", """`triangulation_covariance` is in the camera frame. C belongs to s, in
the IMU frame: turn it by the rotation of imu_T_cam on both sides.""")
def _(world_T_imu, landmarks, covariance, pixels, camera, noise):
    C = camera.triangulation_covariance(camera.triangulate(pixels)[0], noise.sigma_px)
    return _born(world_T_imu, landmarks, covariance, pixels, camera, noise, C=C)


@filter_birth.mistake("orders mixed", """The new landmark is the last of the landmarks, so its rows and columns stand
before those of the pose.""")
def _(world_T_imu, landmarks, covariance, pixels, camera, noise):
    landmarks, P = _born(world_T_imu, landmarks, covariance, pixels, camera, noise)
    n = landmarks.size
    order = np.r_[:n - 3, n:n + 6, n - 3:n]
    return landmarks, P[np.ix_(order, order)]


@filter_birth.mistake("prior 2 I", """The report's 2 I says neither how well the point was triangulated nor how well the
pose is known.""")
def _(world_T_imu, landmarks, covariance, pixels, camera, noise):
    n = landmarks.size
    point = se3.transform(world_T_imu @ camera.imu_T_cam, camera.triangulate(pixels)[0])
    P = np.insert(np.insert(covariance, 3 * [n], 0, axis=0), 3 * [n], 0, axis=1)
    P[n:n + 3, n:n + 3] = noise.landmark_prior * np.eye(3)
    return np.vstack([landmarks, point]), P


# --- one frame --------------------------------------------------------------------------------------------


def only(state, keep):
    """A state without some landmarks: their rows and columns dropped. keep : (n,) bool."""
    T, landmarks, ids, P = state
    index = np.flatnonzero(np.append(np.repeat(keep, 3), np.ones(6, bool)))
    return T, landmarks[keep], ids[keep], P[np.ix_(index, index)]


def frame_of(update, birth, again=False, retire=True, least=MIN_DISPARITY):
    """The frame made of an update and a birth; again : whether a new landmark's first measurement is used twice.

    least : px, the disparity that a new landmark has to exceed.
    """
    def frame(state, ids, pixels, camera, noise):
        if retire:
            state = only(state, np.isin(state[2], ids))
        T, landmarks, known, P = state
        old = np.isin(ids, known)
        rows = np.array([np.flatnonzero(known == i)[0] for i in ids[old]], int)
        if len(rows):
            T, landmarks, P = update(T, landmarks, P, rows, pixels[old], camera, noise)
        for i, z in zip(ids[~old], pixels[~old]):
            if z[0] - z[2] > least:
                landmarks, P = birth(T, landmarks, P, z, camera, noise)
                known = np.append(known, i)
                if again:
                    T, landmarks, P = update(T, landmarks, P, np.array([len(known) - 1]), z[None], camera, noise)
        return T, landmarks, known, P
    return frame


def by_id(values):
    """The results of a frame with the landmarks in the order of their ids, which is left to taste."""
    T, landmarks, ids, P = values
    if ids.ndim != 1 or landmarks.shape != (len(ids), 3) or P.shape != (3 * len(ids) + 6,) * 2:
        return values
    order = np.argsort(ids)
    index = np.append((3 * order[:, None] + np.arange(3)).ravel(), 3 * len(ids) + np.arange(6))
    return [T, landmarks[order], ids[order], P[np.ix_(index, index)]]


@exercise(chapter=13, cases=frames, outputs=("world_T_imu", "landmarks", "ids", "covariance"), canonical=by_id,
          shows=[ekf_slam.correlated], hints=[
    "In this order: drop what is out of sight, update with what is known, then let the new ones join.",
    "np.isin(ids, known) says which are old. Dropping a landmark is dropping its three rows and columns."])
def filter_frame(state, ids, pixels, camera, noise):
    """One whole frame after the prediction: retire, update, initialise, by means of your pieces.

    state : (world_T_imu, landmarks (n, 3), ids (n,), covariance). ids : (m,), what the frame sees, pixels : (m, 4).
    First the landmarks that the frame does not see leave the state, then the known ones correct it, then the new ones
    join, in the order of `ids`, their first measurement used once. A new one whose disparity u_left - u_right is not
    above 1 px waits for another frame. Returns the four parts of the new state.
    """
    return frame_of(_updated, _born)(state, ids, pixels, camera, noise)


@filter_frame.mistake("first measurement used twice", """The pixels that made a landmark have told all they know: an
update with them again counts them twice.""")
def _(state, ids, pixels, camera, noise):
    return frame_of(_updated, _born, again=True)(state, ids, pixels, camera, noise)


@filter_frame.mistake("nothing retired", "Landmarks out of sight leave the state, or it grows with the drive.")
def _(state, ids, pixels, camera, noise):
    return frame_of(_updated, _born, retire=False)(state, ids, pixels, camera, noise)


@filter_frame.mistake("disparity not checked", """A landmark with next to no disparity has next to no depth: it waits
until u_left - u_right is above 1 px.""")
def _(state, ids, pixels, camera, noise):
    return frame_of(_updated, _born, least=0.0)(state, ids, pixels, camera, noise)


@filter_frame.mistake("new ones joined before the update", """That is honest as well, as long as each measurement is
used once, but it is another filter: here the known ones correct the pose first, and new ones join the better pose.""")
def _(state, ids, pixels, camera, noise):
    old = np.isin(ids, state[2])
    retired = only(state, np.isin(state[2], ids))
    frame = frame_of(_updated, _born, retire=False)
    joined = frame(retired, ids[~old], pixels[~old], camera, noise)
    return frame(joined, ids[old], pixels[old], camera, noise)


# --- the whole filter -------------------------------------------------------------------------------------

def run_of(predict, frame):
    """The filter made of a prediction and a frame."""
    def run(drive, noise):
        state = (np.eye(4), np.empty((0, 3)), np.empty(0, int), noise.initial_pose_covariance)
        for k in range(drive.n_frames):
            if k:
                T, P = predict(state[0], state[3], drive.step_twists[k - 1], drive.taus[k - 1], noise)
                state = (T, state[1], state[2], P)
            state = frame(state, *drive.observed(k), drive.camera, noise)
            yield state
    return run


def drives(rng):
    yield "the first 12 frames of first_steps", (first_steps().slice(0, 12), NOISE)
    yield "12 frames in the bend", (first_steps().slice(30, 42), NOISE)


def poses_and_covariances(result):
    """What is compared of a filter's states: the poses (T, 4, 4) and their covariances (T, 6, 6)."""
    states = list(result)
    if not all(isinstance(state, tuple | list) and len(state) == 4 for state in states):
        raise Unreadable("it must yield the four parts of a state after each frame")
    return (np.array([state[0] for state in states]), np.array([np.asarray(state[3])[-6:, -6:] for state in states]))


@exercise(chapter=13, cases=drives, outputs=("poses", "pose covariances"), reading=poses_and_covariances,
          tolerance=1e-6, shows=[ekf_slam.run], hints=[
    "Frame 0 has no prediction: the identity, no landmarks, noise.initial_pose_covariance.",
    "Frame k is predicted with drive.step_twists[k - 1] and drive.taus[k - 1]; drive.observed(k) gives ids "
    "and pixels."])
def filter_run(drive, noise):
    """Your filter over a drive: yields the state (world_T_imu, landmarks, ids, covariance) after each frame.

    drive : `Drive` with `n_frames`, `step_twists` (T-1, 6), `taus` (T-1,), `observed(k)` (ids and pixels of a frame)
    and `camera`. noise : `Noise`. It starts at the identity, with no landmarks and `noise.initial_pose_covariance`.
    Write it as a generator: `yield` each state, keep none. Returns an iterator over the T states.
    """
    return run_of(_predicted, frame_of(_updated, _born))(drive, noise)


@filter_run.mistake("IMU sample of the wrong step", """Step k - 1 to k is driven by drive.step_twists[k - 1], the sample
of the frame it leaves.""")
def _(drive, noise):
    late = np.vstack([drive.twists[1:], drive.twists[-1:]])
    return filter_run.reference(drive.replace(twists=late), noise)


@filter_run.mistake("predicted before frame 0", "Frame 0 is the start: no time has passed, the covariance is Sigma_0.")
def _(drive, noise):
    T, P = _predicted(np.eye(4), noise.initial_pose_covariance, drive.step_twists[0], drive.taus[0], noise)
    start = Noise(noise.sigma_v, noise.sigma_omega, noise.sigma_px, P)
    for T_k, *rest in filter_run.reference(drive, start):
        yield T @ T_k, *rest


@filter_run.mistake("one tau for all", "The frames are not evenly spaced: step k - 1 takes drive.taus[k - 1].")
def _(drive, noise):
    return filter_run.reference(drive.replace(times=drive.taus.mean() * np.arange(drive.n_frames)), noise)


# --- extensions -------------------------------------------------------------------------------------------


def uncertain_points(rng):
    yield "straight ahead", (500.0, 0.5, np.array([0.0, 0.0, 10.0]), np.diag([0.01, 0.01, 1.0]))
    for _ in range(4):
        point = np.array([rng.uniform(-4, 4), rng.uniform(-2, 2), rng.uniform(4, 30)])
        yield "beside the axis", (rng.uniform(300, 700), rng.uniform(0.2, 0.8), point,
                                  0.02 * point[2] * inputs.random_covariance(rng, 3))


@exercise(chapter=13, cases=uncertain_points, shows=[stereo.second_order], hints=[
    """One coordinate is u = f x / z. Write its three second derivatives by (x, z); the one by x twice is zero. Then
    half the trace of h'' C is two terms.""",
    "u_left: f / z^2 * (x / z * C_zz - C_xz). The right camera has x - baseline in place of x, v has y."])
def curved_mean(f, baseline, point, covariance):
    """How far the mean of the pixels lies from the pixels of the mean, to second order: half the trace of h'' C.

    f : px. baseline : m. point (3,) : m, mean of a landmark in the left camera's frame. covariance (3, 3) : m^2.
    Returns (4,), px, of u_left, v_left, u_right, v_right.
    """
    x, y, z = point
    C = covariance
    u_left = f / z**2 * (x / z * C[2, 2] - C[0, 2])
    v = f / z**2 * (y / z * C[2, 2] - C[1, 2])
    u_right = f / z**2 * ((x - baseline) / z * C[2, 2] - C[0, 2])
    return np.array([u_left, v, u_right, v])


curved_mean.slip("half forgotten", "The second-order term of Taylor's series has a factor 1/2.",
    ("return np.array([u_left, v, u_right, v])", "return 2 * np.array([u_left, v, u_right, v])"))
curved_mean.slip("sign flipped", "This has the wrong sign: beside the axis the mean moves outwards.",
    ("return np.array", "return -np.array"))
curved_mean.slip("right camera taken for the left", "The right camera sees x - baseline in place of x.",
    ("x - baseline", "x"))
curved_mean.slip("depth alone", """h'' has entries beside the diagonal too, and x and z are correlated, because a
    landmark is uncertain along its ray.""", ("C = covariance", "C = np.diag(np.diag(covariance))"))
curved_mean.slip("cross term halved", "C_xz stands in C twice, as C_xz and C_zx: half the trace has it once in full.",
    ("C = covariance", "C = covariance.copy()\n    C[:2, 2] = C[:2, 2] / 2"))
curved_mean.slip("cross term twice", "Half the trace has -C_xz / z^2 once.",
    ("C = covariance", "C = covariance.copy()\n    C[:2, 2] = 2 * C[:2, 2]"))
curved_mean.slip("second derivative by the depth halved", """d^2 (x / z) / dz^2 = 2 x / z^3; the 2 and the half of
    Taylor's series cancel.""", ("C = covariance", "C = covariance.copy()\n    C[2, 2] = C[2, 2] / 2"))
curved_mean.slip("one depth too few", "d^2 (x / z) / dz^2 = 2 x / z^3: the depth enters with its third power.",
    ("(x / z *", "(x *"), ("(y / z *", "(y *"), ("(x - baseline) / z *", "(x - baseline) *"))
curved_mean.slip("x in place of y", "v is f y / z: its terms are those of u with y in place of x.",
    ("y / z * C[2, 2] - C[1, 2]", "x / z * C[2, 2] - C[0, 2]"))
curved_mean.slip("cross term added", "d^2 (x / z) / dx dz = -1 / z^2: the cross term is subtracted.",
    ("C = covariance", "C = covariance.copy()\n    C[:2, 2] = -C[:2, 2]"))


def windows(rng):
    for keep in ([True, False], [False, True, True, False], [True, True, True]):
        n = len(keep)
        yield f"{n - sum(keep)} of {n} left", (10 * rng.normal(size=(n, 3)), inputs.random_covariance(rng, 3 * n + 6),
                                               np.array(keep))


@exercise(chapter=13, cases=windows, shows=[window_slam.marginalise], outputs=("landmarks", "covariance"), hints=[
    "To marginalise a Gaussian is to do nothing to what stays: no inverse, no product.",
    "Take the rows and the columns of the landmarks that stay, and the last six."])
def left_behind(landmarks, covariance, keep):
    """The state after some landmarks have left the window: the others, and the pose, are known as well as before.

    landmarks (n, 3) : m, world. covariance (3n+6, 3n+6), landmarks before the pose. keep (n,) : bool, which stay.
    Returns the landmarks that stay and the covariance of these and the pose.
    """
    pose = np.ones(6, bool)
    stay = np.concatenate([np.repeat(keep, 3), pose])
    P = covariance[stay][:, stay]
    return landmarks[keep], P


left_behind.slip("conditioned", """This is what is known once the landmarks that leave are known *exactly*: the Schur
    complement, or rows dropped from the inverse. They are only no longer asked for: take rows of the covariance.""",
    ("covariance[stay][:, stay]", "np.linalg.inv(np.linalg.inv(covariance)[stay][:, stay])"))
left_behind.slip("correlations with the pose lost", """What stays keeps its correlation with the pose: without it the
    next update cannot correct the map through the pose.""",
    ("return landmarks", "P[:-6, -6:], P[-6:, :-6] = 0, 0\n    return landmarks"))
left_behind.slip("the wrong ones kept", "`keep` says which stay, not which leave.",
    ("stay = ", "keep = ~keep\n    stay = "))
