"""Exercises of notebook 07: the right-invariant error, which does not learn what nothing can tell."""

import numpy as np

from ... import se3
from ...error_state import RightInvariant
from ..checks.exercise import exercise
from ..checks.inputs import random_camera, random_landmarks, random_pose


def steps(rng):
    yield "no landmark", (random_pose(rng), np.empty((0, 3)), 0.1 * np.eye(6))
    for n in (1, 2, 4):
        T = random_pose(rng)
        twist = rng.normal(size=6)
        tau = rng.uniform(0.05, 0.3)
        yield "random", (T, random_landmarks(rng, T, n), tau * se3.right_jacobian(tau * twist))


@exercise(chapter=7, cases=steps, shows=[RightInvariant.pose_transition, RightInvariant.landmark_transition], hints=[
    "The Adjoint of the pose takes the body's noise into the world. Its rotation part also turns the landmark errors.",
    "B = se3.adjoint(world_T_imu) @ body_noise for the pose; m^ B_R for a landmark m, B_R the last three rows of B."])
def invariant_noise(world_T_imu, landmarks, body_noise):
    """How an error of the twist enters the right-invariant error, [landmarks, position, rotation], over one step.

    The transition itself is F = I. world_T_imu : (4, 4), the pose after the step. landmarks : (n, 3), m, world.
    body_noise : (6, 6), tau J_r(tau u), twist error to pose error in the body frame. Returns N (3n+6, 6), so that
    P' = P + N Q N^T. You may use `se3`.
    """
    B = se3.adjoint(world_T_imu) @ body_noise
    rows = []
    for k in range(len(landmarks)):
        m = landmarks[k]
        rows.append(se3.so3_hat(m) @ B[3:])
    rows.append(B)
    return np.vstack(rows)


invariant_noise.slip("landmarks left out", """The landmarks stand still, but their error is expressed relative to a
    world that turns with the pose's error: m^ B_R. Without it the filter is inconsistent again.""",
    ("se3.so3_hat(m) @ B[3:]", "np.zeros((3, 6))"))
invariant_noise.slip("world and body mixed", """The IMU's noise is expressed in the body frame, the invariant error in
    the world: the Adjoint of the pose stands between them.""", ("se3.adjoint(world_T_imu)", "np.eye(6)"))
invariant_noise.slip("sign of m^", """A turn x of the world moves a landmark by x^ m = -m^ x, which its error has to
    make good: +m^ B_R.""", ("hat(m)", "hat(-m)"))
invariant_noise.slip("p^ R of the Adjoint forgotten", """The error turns about the world's origin, not about the car:
    the Adjoint has the block p^ R, not only R and R.""",
    ("se3.adjoint(world_T_imu)", "np.kron(np.eye(2), world_T_imu[:3, :3])"))
invariant_noise.slip("Adjoint of the inverse", """From the body into the world goes Ad(world_T_imu), not that of its
    inverse.""", ("adjoint(world_T_imu)", "adjoint(se3.inverse(world_T_imu))"))
invariant_noise.slip("relative to the car", """The error turns about the world's origin: m^ with m in the world, not m -
    p.""", ("so3_hat(m)", "so3_hat(m - world_T_imu[:3, 3])"))


def measurements(rng):
    for n in (1, 3, 3):
        T, camera = random_pose(rng), random_camera(rng)
        landmarks = random_landmarks(rng, T, n, camera)
        yield "random", (camera.measurement_jacobian(camera.to_cam(T, landmarks)), T)


@exercise(chapter=7, cases=measurements, shows=[RightInvariant.jacobians], outputs=("H_landmark", "H_pose"), hints=[
    "The cameras see R^T (m - p). Turn landmark and position by the same x_R: what changes in R^T (m - p)?",
    "Nothing: the rotation drops out. H_landmark = J R^T and H_pose = [-J R^T, 0]."])
def invariant_jacobian(J, world_T_imu):
    """Jacobians of n stereo measurements by the right-invariant error of their landmark and of the pose.

    J : (n, 4, 3), px/m, derivative of the pixels by the point in the IMU frame. world_T_imu : (4, 4).
    Returns H_landmark (n, 4, 3) and H_pose (n, 4, 6), columns [position, rotation].
    """
    R = world_T_imu[:3, :3]
    H_landmark = J @ R.T
    H_pose = np.concatenate([-H_landmark, np.zeros(J.shape)], axis=-1)
    return H_landmark, H_pose


invariant_jacobian.slip("rotation kept", """Columns for the rotation other than zero tell the filter that one look at
    one landmark says something about the heading of the whole world. Nothing measures that.""",
    ("np.zeros(J.shape)", "H_landmark @ se3.so3_hat(world_T_imu[:3, 3])"))
invariant_jacobian.slip("expressed in the body frame", """-J alone is the right perturbation's block, expressed in the
    body frame. Here the position error is expressed in the world: -J R^T.""", ("[-H_landmark", "[-J"))
invariant_jacobian.slip("sign of the position", """Landmark and position enter as m - p: the position's block is minus
    the landmark's.""", ("-H_landmark", "H_landmark"))
invariant_jacobian.slip("R in place of its transpose", "The point in the IMU frame is R^T (m - p): the transpose.",
    ("R.T", "R"))
invariant_jacobian.slip("rotation and translation swapped", """The columns are [position, rotation]: zero stands on the
    right.""", ("[-H_landmark, np.zeros(J.shape)]", "[np.zeros(J.shape), -H_landmark]"))


def corrections(rng):
    for label, angle, n in [("no rotation", 0.0, 3), ("small rotation", 0.01, 3),
                            *(("random", 0.5, n) for n in (3, 1, 2, 4))]:
        T = random_pose(rng)
        delta = rng.normal(size=3 * n + 6)
        delta[-3:] *= angle
        yield label, (T, random_landmarks(rng, T, n), delta)


@exercise(chapter=7, cases=corrections, shows=[RightInvariant.retract], outputs=("world_T_imu", "landmarks"), hints=[
    "One rotation exp(x_R) turns everything about the world's origin; then each point is shifted by J_l(x_R) x.",
    "R = exp(x_R) R, p = exp(x_R) p + J_l(x_R) x_p, m = exp(x_R) m + J_l(x_R) x_m; J_l is se3.so3_left_jacobian."])
def invariant_retract(world_T_imu, landmarks, delta):
    """The state corrected by a right-invariant error: the exponential of SE_{1+n}(3).

    world_T_imu : (4, 4). landmarks : (n, 3), m, world. delta : (3n+6,), [landmarks, position, rotation].
    Returns world_T_imu (4, 4) and landmarks (n, 3). You may use `se3`.
    """
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


invariant_retract.slip("left Jacobian forgotten", """Every translation is multiplied by J_l(x_R). Leaving it out looks
    harmless; the harm grows with the distance from the world's origin: on chapter 07's drives the NEES is up to 5 times
    as large at 300 m, 12 to 39 times at 1000 m.""", ("se3.so3_left_jacobian(x_R)", "np.eye(3)"))
invariant_retract.slip("right Jacobian", """The translations are multiplied by the left Jacobian, J_l(x_R), not by the
    right one.""", ("se3.so3_left_jacobian", "se3.so3_right_jacobian"))
invariant_retract.slip("landmarks not turned", """x_R turns the whole world, landmarks included: exp(x_R) m, then the
    shift.""", ("turn @ m", "m"))
invariant_retract.slip("position not turned", "x_R turns the car's position about the world's origin too: exp(x_R) p.",
    ("turn @ p", "p"))
invariant_retract.slip("world and body mixed", """This is the right perturbation's T exp(delta^) and m + delta. The
    right-invariant error stands to the left of the state: exp(x^) T.""",
    ("return T, np.array(moved)", "return world_T_imu @ se3.exp(delta[n:]), landmarks + delta[:n].reshape(-1, 3)"))
invariant_retract.slip("interleaved and grouped orders mixed", """delta is x0 y0 z0 x1 y1 z1 ...: reshape(n, 3), not
    reshape(3, n).T.""", ("delta[:n].reshape(-1, 3)", "delta[:n].reshape(3, -1).T"))
invariant_retract.slip("landmarks only shifted", """x_R turns the whole world, landmarks included, and J_l belongs to
    every translation: exp(x_R) m + J_l(x_R) x_m.""", ("turn @ m + J @ x_m", "m + x_m"))
invariant_retract.slip("turned after the shift", """exp(x_R) turns the old point; the shift is not turned again but
    multiplied by J_l.""", ("turn @ p + J @ x_p", "turn @ (p + J @ x_p)"),
    ("turn @ m + J @ x_m", "turn @ (m + J @ x_m)"))
invariant_retract.slip("rotation before position", "The last six of delta are [position, rotation].",
    ("x_p, x_R =", "x_R, x_p ="))
invariant_retract.slip("pose taken to come first", "delta is ordered landmarks first, then pose.",
    ("delta[n:n + 3], delta[n + 3:]", "delta[:3], delta[3:6]"), ("delta[:n].reshape", "delta[6:].reshape"))
