"""Exercises of notebook 13: the pieces of a joint filter, in the order in which a frame uses them.

Everything is plain arrays. A state is the tuple (world_T_imu (4, 4), landmarks (n, 3), ids (n,), covariance
(3n+6, 3n+6)), landmarks before the pose. The filter is that of `ekf_slam` to first order, without a gate, and it drops
the landmarks that are out of sight. Source: report section 3.3.2, corrected.
"""

import contextlib
import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ... import ekf_slam, se3, stereo, window_slam
from ...noise import Noise
from ...simulate import first_steps
from ..checks import inputs
from ..checks.comparing import close, number
from ..checks.edit import calling, edited
from ..checks.exercise import Mistake, exercise
from ..checks.right_parts import wrong_entries
from ..checks.running import Unreadable

NOISE = Noise()


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
    state = (T, landmarks[:4], np.array([7, 2, 8, 5]), P[6:, 6:])
    yield "all known", (state, np.array([7, 2, 8, 5]), pixels[:4], inputs.CAMERA, NOISE)
    yield "one lost, two new", (state, np.array([8, 11, 7, 5, 9]), pixels[[2, 5, 0, 3, 4]], inputs.CAMERA, NOISE)
    far = pixels.copy()
    far[4:, 2] = far[4:, 0] - [0.9, 1.1]
    yield "one of the new ones too far", (state, np.array([8, 11, 7, 5, 9]), far[[2, 5, 0, 3, 4]], inputs.CAMERA, NOISE)
    yield "nothing in view", (state, np.empty(0, int), np.empty((0, 4)), inputs.CAMERA, NOISE)


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
filter_predict.slip("sigma not squared", "Q holds variances, the squares of the sigmas: noise.twist_covariance.",
                    ("noise.twist_covariance", "np.sqrt(noise.twist_covariance)"))
filter_predict.slip("right Jacobian left out", """W = tau^2 Q is the report's form. An error of the sample moves the
pose by tau J_r(tau u): write B Q B^T.""", ("se3.right_jacobian(tau * twist)", "np.eye(6)"))
filter_predict.slip("transition of the other direction", "F = Ad(exp(-tau u^)), with the minus sign.", ("-tau", "tau"))
filter_predict.slip("world and body mixed", "The twist is measured in the body: its motion stands on the right.",
                    ("world_T_imu @ step", "step @ world_T_imu"))
_STEP = "step = se3.exp(tau * twist)"
filter_predict.slip("rotation and translation swapped", "A twist is [v, omega], translation first.",
                    (_STEP, f"twist = np.roll(twist, 3)\n    {_STEP}"))
filter_predict.slip("degrees", "The gyro gives radians per second already.",
                    (_STEP, f"twist = np.append(twist[:3], np.radians(twist[3:]))\n    {_STEP}"))


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
filter_update.slip("extrinsics forgotten", "Between the camera and the body stands cam_T_imu, in H as well.",
                   ("camera.pose_jacobian(world_T_imu, landmarks[j])", """(
            -camera.projection_jacobian(camera.to_cam(world_T_imu, landmarks[j]))
            @ se3.odot(se3.transform(se3.inverse(world_T_imu), landmarks[j])))"""))
filter_update.slip("1/q3 forgotten", "dpi/dq has the factor 1 / q_3, the depth.",
                   ("        V[k, k]", "        H[k] *= camera.to_cam(world_T_imu, landmarks[j])[2]\n        V[k, k]"))
filter_update.slip("world and body mixed", "The correction is expressed in the body: T exp(delta^).",
                   ("world_T_imu @ se3.exp(delta[n:])", "se3.exp(delta[n:]) @ world_T_imu"))
filter_update.slip("a copy updated", "landmarks[rows][:] += ... changes a temporary array: the landmarks stayed.",
                   ("landmarks + delta[:n].reshape(-1, 3)", "landmarks"))
filter_update.slip("only the seen landmarks corrected", """The others are correlated with the pose and move too:
this is what the joint covariance is for.""",
                   ("landmarks + delta", "landmarks + np.isin(np.arange(len(landmarks)), rows)[:, None] * delta"))
filter_update.slip("orders mixed", "delta holds x, y, z of one landmark after the other: reshape(n, 3).",
                   ("delta[:n].reshape(-1, 3)", "delta[:n].reshape(3, -1).T"))
filter_update.slip("cross terms never written", """After the update the landmarks and the pose are correlated: the
whole of (I - K H) P is kept.""",
                   ("    return", "    block = np.append(np.arange(n) // 3, np.full(6, n))\n"
                                  "    P = P * (block[:, None] == block)\n    return"))
filter_update.slip("columns of another landmark", """Measurement i shows landmark rows[i]: its block stands in the
columns 3 rows[i] to 3 rows[i] + 3 of H, not 3 i.""", ("3 * j:3 * j + 3", "3 * i:3 * i + 3"))


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
filter_birth.slip("pixels used as bearings", "The bearing is K^-1 [u, v, 1], not [u, v, 1].",
                  ("triangulate(pixels)[0]", "triangulate(pixels)[0][2] * np.array([pixels[0], pixels[1], 1.0])"))
filter_birth.slip("extrinsics forgotten", "The triangulated point is in the camera frame: imu_T_cam comes first.",
                  ("se3.transform(camera.imu_T_cam, q)", "q"), ("R_cam @ C @ R_cam.T", "C"))
filter_birth.slip("covariance not turned", """`triangulation_covariance` is in the camera frame. C belongs to s, in
the IMU frame: turn it by the rotation of imu_T_cam on both sides.""", ("R_cam @ C @ R_cam.T", "C"))
filter_birth.slip("orders mixed", """The new landmark is the last of the landmarks, so its rows and columns stand
before those of the pose.""", ("    return", """    order = np.r_[:n, n + 3:n + 9, n:n + 3]
    P = P[np.ix_(order, order)]
    return"""))
filter_birth.slip("prior 2 I", """The report's 2 I says neither how well the point was triangulated nor how well the
pose is known.""", ("cross = G", "cross = 0 * G"), ("G @ covariance[n:, n:] @ G.T + R @ R_cam @ C @ R_cam.T @ R.T",
                                                    "noise.landmark_prior * np.eye(3)"))


def by_id(values):
    """The parts of a state with the landmarks in the order of their ids, which is left to taste."""
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
    T, landmarks, known, P = state
    keep = np.isin(known, ids)
    stay = np.append(np.repeat(keep, 3), np.ones(6, bool))
    landmarks, known, P = landmarks[keep], known[keep], P[stay][:, stay]
    old = np.isin(ids, known)
    rows = np.array([np.flatnonzero(known == i)[0] for i in ids[old]], int)
    if old.any():
        T, landmarks, P = filter_update(T, landmarks, P, rows, pixels[old], camera, noise)
    for i, z in zip(ids[~old], pixels[~old]):
        if z[0] - z[2] > 1:
            landmarks, P = filter_birth(T, landmarks, P, z, camera, noise)
            known = np.append(known, i)
    return T, landmarks, known, P


_AGAIN = "T, landmarks, P = filter_update(T, landmarks, P, np.array([len(known) - 1]), z[None], camera, noise)\n"
_UPDATE = """    if old.any():
        T, landmarks, P = filter_update(T, landmarks, P, rows, pixels[old], camera, noise)
"""
filter_frame.slip("first measurement used twice", """The pixels that made a landmark have told all they know: an
    update with them again counts them twice.""",
    ("known = np.append(known, i)\n", f"known = np.append(known, i)\n            {_AGAIN}"))
filter_frame.slip("nothing retired", "Landmarks out of sight leave the state, or it grows with the drive.",
    ("keep = np.isin(known, ids)", "keep = np.ones(len(known), bool)"))
filter_frame.slip("disparity not checked", """A landmark with next to no disparity has next to no depth: it waits
    until u_left - u_right is above 1 px.""", ("z[0] - z[2] > 1", "True"))
filter_frame.slip("new ones joined before the update", """That is consistent as well, as long as each measurement is
    used once, but it is another filter: here the known ones correct the pose first, and new ones join the better
    pose.""", (_UPDATE, ""), ("    return T", f"{_UPDATE}    return T"))
filter_frame.slip("new ones joined, then all updated", """The new ones have used their measurement up when they
    join. The update takes the known ones alone, and comes first.""", (_UPDATE, ""),
    ("    return T", """    rows = np.array([np.flatnonzero(known == i)[0] for i in ids if i in known], int)
    if len(rows):
        T, landmarks, P = filter_update(T, landmarks, P, rows, pixels[np.isin(ids, known)], camera, noise)
    return T"""))
filter_frame.slip("landmark by landmark", """One update with all known landmarks is asked for. In one after the other
    each is linearised where the last has put the state: another filter, to first order the same.""",
    (_UPDATE, """    for j, z in zip(rows, pixels[old]):
        T, landmarks, P = filter_update(T, landmarks, P, np.array([j]), z[None], camera, noise)
"""))
filter_frame.slip("rows of the frame taken for rows of the state", """`rows` says which landmark of the state each
    measurement shows: where in the state's ids its id stands, not where in the frame.""",
    ("np.array([np.flatnonzero(known == i)[0] for i in ids[old]], int)", "np.arange(old.sum())"))
filter_frame.slip("no new landmarks", "What the frame sees for the first time joins the state.",
    ("zip(ids[~old]", "zip(ids[:0]"))
filter_frame.slip("no update", "The measurements of the known landmarks correct the state.", (_UPDATE, ""))
filter_frame.slip("new ids in front", "A new landmark is the last of the landmarks, so its id is the last of the ids.",
    ("np.append(known, i)", "np.append(i, known)"))
filter_frame.slip("ids sorted without their landmarks", """An id stands where its landmark stands: whoever sorts the ids
    sorts landmarks and covariance with them.""",
    ("return T, landmarks, known, P", "return T, landmarks, np.sort(known), P"))


def renumbered(drive):
    """The drive with its landmarks numbered from last to first: the order of a frame is not that of the state."""
    order = np.concatenate([np.arange(*span)[::-1] for span in itertools.pairwise(drive.frame_start)])
    return drive.replace(landmark=drive.n_landmarks - 1 - drive.landmark[order], pixels=drive.pixels[order],
                         truth_landmarks=drive.truth_landmarks[::-1])


def drives(rng):
    drive = first_steps()
    blind, far = drive.slice(30, 34), drive.slice(30, 31).subsample(4)
    yield "nothing in view", (blind.keep_landmarks(np.zeros(blind.n_landmarks, bool)), NOISE)
    yield "the first frames of first_steps", (drive.slice(0, 4).subsample(3), NOISE)
    yield "frames in the bend", (renumbered(drive.slice(34, 38).subsample(2)), NOISE)
    pixels = far.pixels.copy()
    pixels[:2, 2] = pixels[:2, 0] - [0.9, 1.1]
    yield "a frame with landmarks far away", (far.replace(pixels=pixels), NOISE)


def stacked(result):
    """A filter's states as arrays, padded to one size: ids (T, n), covariances, landmarks, poses, their covariances."""
    states = list(result)
    if not all(isinstance(state, tuple | list) and len(state) == 4 for state in states):
        raise Unreadable("it must yield the four parts of a state after each frame")
    states = [by_id([np.asarray(part) for part in state]) for state in states]
    most = max((np.size(ids) for _, _, ids, _ in states), default=0)
    ids, P = np.full((len(states), most), -1), np.zeros((len(states), 3 * most + 6, 3 * most + 6))
    landmarks, poses = np.zeros((len(states), most, 3)), np.zeros((len(states), 4, 4))
    of_poses = np.zeros((len(states), 6, 6))
    for k, (T, m, known, covariance) in enumerate(states):
        n = len(known)
        for name, part, shape in [("world_T_imu", T, (4, 4)), ("landmarks", m, (n, 3)),
                                  ("covariance", covariance, (3 * n + 6,) * 2)]:
            if part.shape != shape:
                raise Unreadable(f"frame {k}: with {n} ids {name} must have shape {shape}, not {part.shape}")
        ids[k, :n], P[k, :3 * n + 6, :3 * n + 6], landmarks[k, :n], poses[k] = known, covariance, m, T
        of_poses[k] = covariance[-6:, -6:]
    return ids, P, landmarks, poses, of_poses


def unstacked(values):
    """The states (ids, covariance, landmarks, world_T_imu) that `stacked` has made arrays of."""
    for ids, P, landmarks, T in zip(*values[:4]):
        n = int((ids >= 0).sum())
        yield ids[:n], P[:3 * n + 6, :3 * n + 6], landmarks[:n], T


@dataclass(frozen=True, eq=False)
class Apart:
    """Where two runs of a filter differ first. frame, part : of the state. entry : index in it, () for shapes.

    mine, right : that part. look : a sentence that says which stage it comes from.
    """

    frame: int
    part: str
    entry: tuple[int, ...]
    mine: np.ndarray
    right: np.ndarray
    look: str

    @property
    def where(self) -> str:
        """In words."""
        place = f"What differs first is {self.part} of frame {self.frame}"
        if not self.entry:
            return f"{place}: {self.mine.astype(int).tolist()}, where {self.right.astype(int).tolist()} is right"
        mine, right = self.mine[self.entry], self.right[self.entry]
        digits = max(4, 2 + int(np.ceil(-np.log10(abs(mine - right) / (abs(right) or 1.0))))) if mine - right else 4
        return f"{place}, entry {list(self.entry)}: {number(mine, digits)}, where {number(right, digits)} is right"


def apart(arguments, values, expected, tolerance=1e-6) -> Apart | None:
    """Where a filter's states differ first: frame by frame, in each the ids, the covariance, the mean.

    values, expected : as `stacked` makes them.
    """
    before = (np.empty(0, int), arguments[1].initial_pose_covariance, np.empty((0, 3)), np.eye(4))
    for k, (mine, right) in enumerate(zip(unstacked(values), unstacked(expected))):
        for part, came, should in zip(("ids", "covariance", "landmarks", "world_T_imu"), mine, right):
            if came.shape != should.shape or (part == "ids" and (came != should).any()):
                return Apart(k, part, (), came, should, _look(arguments, k, "ids", mine, right, before))
            wrong = wrong_entries(came, should, tolerance)
            if part == "covariance":  # the pose by its own scale, which is far below that of the landmarks
                wrong[-6:, -6:] |= wrong_entries(came[-6:, -6:], should[-6:, -6:], tolerance)
            if wrong.any():
                entry = tuple(int(i) for i in np.argwhere(wrong)[0])
                return Apart(k, part, entry, came, should, _look(arguments, k, part, mine, right, before))
        before = right
    return None


def _look(arguments, k, part, mine, right, before) -> str:
    """The stage that the first difference comes from. before : the state of the frame before, which is right."""
    drive, noise = arguments
    seen = drive.observed(k)[0]
    if part == "ids":
        return "Which landmarks stay and join is decided in filter_frame."
    if not len(seen):
        return "This is the start, before any motion: look in filter_run." if k == 0 else (
            "The frame sees nothing, so only the prediction was at work: look in filter_predict, or at what "
            "filter_run gives it, the twist and tau of step k - 1.")
    ids, P, landmarks, _ = right
    old = np.isin(ids, before[0])
    known = np.append(np.repeat(old, 3), np.ones(6, bool))
    if close(mine[1][known][:, known], P[known][:, known], 1e-6) and close(mine[2][old], landmarks[old], 1e-6) and (
            close(mine[3], right[3], 1e-6)):
        return "Only what belongs to new landmarks is wrong: look in filter_birth."
    if not old.any():
        return "No known landmark is in view, and births do not change the pose: look in filter_frame."
    T, P = filter_predict(before[3], before[1], drive.step_twists[k - 1], drive.taus[k - 1], noise)
    stay = np.isin(before[0], seen)
    index = np.append(np.repeat(stay, 3), np.ones(6, bool))
    m, rows = before[2][stay], np.arange(stay.sum())
    H = ekf_slam.joint_jacobian(drive.camera.landmark_jacobian(T, m), drive.camera.pose_jacobian(T, m), rows, len(m))
    information = H.T @ np.kron(np.eye(stay.sum()), np.linalg.inv(noise.pixel_covariance)) @ H
    with contextlib.suppress(np.linalg.LinAlgError):
        # What the update has started from, if it is right. A prediction leaves the block of the landmarks as it is.
        prior = np.linalg.inv(np.linalg.inv(mine[1][known][:, known]) - information)
        if part == "covariance" and close(prior[:-6, :-6], P[index][:, index][:-6, :-6], 1e-3):
            return "The update has done its part, but what it was given was not right: look in filter_predict."
    return "The births are not to blame, and the prediction leaves no such trace: look in filter_update."


def where_apart(arguments, values, expected) -> tuple[str, str]:
    """What differs first, and the stage to look in; as `Exercise.first`."""
    if len(values[0]) != len(expected[0]):
        return f"It yields {len(values[0])} states for {len(expected[0])} frames", ""
    found = apart(arguments, values, expected)
    return (found.where, found.look) if found else ("", "")


@exercise(chapter=13, cases=drives, outputs=("ids", "covariances", "landmarks", "poses", "pose covariances"),
          reading=stacked, first=where_apart, tolerance=1e-6, shows=[ekf_slam.run], hints=[
    "Frame 0 has no prediction: the identity, no landmarks, noise.initial_pose_covariance.",
    "Frame k is predicted with drive.step_twists[k - 1] and drive.taus[k - 1]; drive.observed(k) gives ids "
    "and pixels."])
def filter_run(drive, noise):
    """Your filter over a drive: yields the state (world_T_imu, landmarks, ids, covariance) after each frame.

    drive : `Drive` with `n_frames`, `step_twists` (T-1, 6), `taus` (T-1,), `observed(k)` (ids and pixels of a frame)
    and `camera`. noise : `Noise`. It starts at the identity, with no landmarks and `noise.initial_pose_covariance`.
    Write it as a generator: `yield` each state, keep none. Returns an iterator over the T states.
    """
    T, landmarks, known, P = np.eye(4), np.empty((0, 3)), np.empty(0, int), noise.initial_pose_covariance
    for k in range(drive.n_frames):
        if k > 0:
            T, P = filter_predict(T, P, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        ids, pixels = drive.observed(k)
        T, landmarks, known, P = filter_frame((T, landmarks, known, P), ids, pixels, drive.camera, noise)
        yield T, landmarks, known, P


filter_run.slip("IMU sample of the wrong step", """Step k - 1 to k is driven by drive.step_twists[k - 1], the sample of
    the frame it leaves.""", ("drive.step_twists[k - 1]", "drive.twists[k]"))
filter_run.slip("IMU sample of the step before", """Step k - 1 to k is driven by drive.step_twists[k - 1], not by the
    sample before that one.""", ("drive.step_twists[k - 1]", "drive.step_twists[max(k - 2, 0)]"))
filter_run.slip("predicted before frame 0", "Frame 0 is the start: no time has passed, the covariance is Sigma_0.",
    ("if k > 0:", "if True:"), ("drive.step_twists[k - 1], drive.taus[k - 1]",
                                "drive.step_twists[max(k - 1, 0)], drive.taus[max(k - 1, 0)]"))
filter_run.slip("one tau for all", "The frames are not evenly spaced: step k - 1 takes drive.taus[k - 1].",
    ("drive.taus[k - 1]", "drive.taus.mean()"))
filter_run.slip("tau of another step", "Step k - 1 to k takes drive.taus[k - 1].",
    ("drive.taus[k - 1]", "drive.taus[min(k, len(drive.taus) - 1)]"))
filter_run.slip("no prediction", "Before each frame but the first the IMU moves the pose: filter_predict.",
    ("k > 0", "False"))
filter_run.slip("zero covariance at the start", "The pose starts with noise.initial_pose_covariance.",
    ("noise.initial_pose_covariance", "np.zeros((6, 6))"))
filter_run.slip("identity covariance at the start", "The start is known to noise.initial_pose_covariance, not to 1 m.",
    ("noise.initial_pose_covariance", "np.eye(6)"))
filter_run.slip("predicted after the frame", "First the prediction to frame k, then the frame.",
    ("""        if k > 0:
            T, P = filter_predict(T, P, drive.step_twists[k - 1], drive.taus[k - 1], noise)
""", ""), ("        yield T", """        if k > 0:
            T, P = filter_predict(T, P, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        yield T"""))


def assembled(**stages):
    """The whole filter with other functions for some of the stages, by their names."""
    frame = calling(stages.pop("filter_frame", filter_frame.reference), **stages)
    return calling(stages.pop("filter_run", filter_run.reference), filter_frame=frame, **stages)


@dataclass(frozen=True)
class InStage(Mistake):
    """A usual mistake of a stage, put into the whole filter. base : the stage's plain answer."""

    stage: str = ""

    @functools.cached_property
    def function(self) -> Callable:
        return assembled(**{self.stage: edited(self.base, *self.edits)})


filter_run.inherited.extend(
    InStage(f"{mistake.name}, in {stage.name}", mistake.hint, mistake.base, mistake.edits, stage.name)
    for stage in (filter_predict, filter_update, filter_birth, filter_frame) for mistake in stage.mistakes)


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
