"""Exercises of notebook 04: how a pose is corrected by the cameras."""

import numpy as np

from ... import kalman, odometry, se3
from ...stereo import StereoCamera
from ..ch01.exercises import vectors
from ..ch03.exercises import one_landmark
from ..checks.exercise import exercise
from ..checks.inputs import perturbed, random_camera, random_covariance, random_landmarks, random_pose


@exercise(chapter=4, cases=vectors, shows=[se3.odot, se3.so3_hat], hints=[
    "Write out hat(xi) @ [s, 1] = [omega x s + v, 0] and collect what multiplies v and what multiplies omega.",
    "[[I, -s^], [0, 0]]: omega x s is -s x omega."])
def odot(point):
    """Circled-dot operator: `hat(xi) @ [point, 1] == odot(point) @ xi` for every twist xi = [v, omega].

    point : (3,), m. Returns (4, 6). You may use `se3.so3_hat`.
    """
    D = np.zeros((4, 6))
    D[:3, :3] = np.eye(3)
    D[:3, 3:] = -se3.so3_hat(point)
    return D


odot.slip("sign of the hat", "omega x s = -s x omega: the block is -s^.", ("-se3", "se3"))
odot.slip("rotation and translation swapped", "The columns follow the twist [v, omega]: I first, -s^ second.",
    ("D[:3, :3] = np", "D[:3, 3:] = np"), ("D[:3, 3:] = -", "D[:3, :3] = -"))
odot.slip("last row not zero", """hat(xi) has a zero last row: a direction of motion has a zero where a point has its
    one.""", ("np.zeros((4, 6))", "np.ones((4, 6))"))


@exercise(chapter=4, cases=one_landmark, hints=[
    "A right perturbation moves the point in the IMU frame: (T exp(e^))^-1 m = exp(-e^) s, about s - odot(s) e.",
    "-camera.projection_jacobian(q) @ camera.cam_T_imu @ se3.odot(s), s: landmark in the IMU frame, q: in the camera."],
    shows=[StereoCamera.pose_jacobian, StereoCamera.projection_jacobian, se3.odot])
def pose_jacobian(camera, world_T_imu, landmark):
    """Derivative of the pixels by the right perturbation e of T exp(e^), at e = 0.

    camera : StereoCamera (cam_T_imu, projection_jacobian). world_T_imu : (4, 4). landmark : (3,), m, world.
    Returns (4, 6), px per [m, rad]: -K_s dpi/dq(q) cam_T_imu odot(s), s = T^-1 m in the IMU frame, q = cam_T_imu s.
    You may use `se3`.
    """
    R, p = world_T_imu[:3, :3], world_T_imu[:3, 3]
    s = R.T @ (landmark - p)
    q = camera.cam_T_imu[:3, :3] @ s + camera.cam_T_imu[:3, 3]
    J = camera.projection_jacobian(q)[:, :3] @ camera.cam_T_imu[:3, :3]
    return -J @ np.hstack([np.eye(3), -se3.so3_hat(s)])


pose_jacobian.slip("extrinsics forgotten", """odot(s) is expressed in the IMU frame, dpi/dq in the camera frame:
    cam_T_imu stands between them.""", ("[:, :3] @ camera.cam_T_imu[:3, :3]", "[:, :3]"))
pose_jacobian.slip("sign flipped", """When the camera moves forward the points come towards it: the Jacobian carries a
    minus sign, because the pose enters through its inverse.""", ("-J", "J"))
pose_jacobian.slip("world and body mixed", """This belongs to exp(e^) T, a perturbation expressed in the world frame. A
    right perturbation T exp(e^) is expressed in the body: odot(s), s in the IMU frame.""", ("-J @", "-J @ R.T @"),
    ("hat(s)", "hat(landmark)"))
pose_jacobian.slip("rotation and translation swapped", "The columns follow e = [v, omega]: position first.",
    ("[np.eye(3), -se3.so3_hat(s)]", "[-se3.so3_hat(s), np.eye(3)]"))
pose_jacobian.slip("odot of the point in the camera frame", """The perturbation turns the body about the IMU: odot(s)
    with s in the IMU frame, not odot(q).""", ("hat(s)", "hat(q)"))
pose_jacobian.slip("1/q3 forgotten", "dpi/dq carries a factor 1/q_3.", ("-J @", "-q[2] * J @"))


def frames(rng):
    for n in (5, 5, 2, 7):
        true, camera = random_pose(rng), random_camera(rng)
        landmarks = random_landmarks(rng, true, n, camera)
        pixels = camera.project(camera.to_cam(true, landmarks))[0] + rng.normal(size=(n, 4))
        yield "random", (camera, perturbed(rng, true), random_covariance(rng, 6, 0.05), landmarks, pixels,
                         rng.uniform(0.7, 3.0))


@exercise(chapter=4, cases=frames, shows=[odometry.observe, kalman.update], outputs=("world_T_imu", "covariance"),
          tolerance=1e-7, hints=[
    "Stack the Jacobians (4n, 6) and the residuals (4n,), do one Kalman update, and apply its correction on the pose.",
    "delta, P = kalman.update(P, H.reshape(-1, 6), sigma_px**2 * np.eye(4n), residual.ravel()); T @ se3.exp(delta)."])
def pose_update(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
    """EKF update of a pose against n landmarks whose positions are known, all at once.

    camera : StereoCamera; camera.observe(world_T_imu, landmarks) returns pixels (n, 4) and a mask (n,), True in
    front of the camera as all are here; camera.pose_jacobian(world_T_imu, landmarks) returns (n, 4, 6).
    world_T_imu : (4, 4). covariance : (6, 6) of the right perturbation, [position m, rotation rad]. landmarks :
    (n, 3), m, world. pixels : (n, 4), measured. sigma_px : px. Returns world_T_imu (4, 4) and covariance (6, 6)
    afterwards. You may use `se3` and `kalman.update`.
    """
    predicted = camera.observe(world_T_imu, landmarks)[0]
    residual = (pixels - predicted).ravel()
    H = camera.pose_jacobian(world_T_imu, landmarks).reshape(-1, 6)
    V = sigma_px**2 * np.eye(len(residual))
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + V)
    delta = K @ residual
    return world_T_imu @ se3.exp(delta), (np.eye(6) - K @ H) @ covariance


pose_update.slip("world and body mixed", """The correction is a right perturbation, expressed in the body frame: T
    exp(delta^), not exp(delta^) T.""", ("world_T_imu @ se3.exp(delta)", "se3.exp(delta) @ world_T_imu"))
pose_update.slip("residual of the wrong sign", "The residual is measured minus predicted, not the reverse.",
    ("pixels - predicted", "predicted - pixels"))
pose_update.slip("correction added", """A pose is not corrected by adding: T (I + delta^) is no pose any more. Use the
    exponential.""", ("se3.exp(delta)", "(np.eye(4) + se3.hat(delta))"))
pose_update.slip("position and rotation corrected apart", """exp(delta^) corrects position and rotation as one motion.
    Adding R v to the position and turning R afterwards is not the same.""",
    ("se3.exp(delta)", "se3.pose(se3.so3_exp(delta[3:]), delta[:3])"))
pose_update.slip("np.tile in place of the Kronecker product", """The noise of n measurements is I (x) V. np.tile puts V
    between different landmarks too, as if they all shared one noise.""",
    ("np.eye(len(residual))", "np.tile(np.eye(4), (len(pixels), len(pixels)))"))
pose_update.slip("sigma not squared", "V holds variances: sigma_px squared.", ("sigma_px**2", "sigma_px"))
pose_update.slip("position and rotation taken for independent", """Only the diagonal blocks of the covariance were used:
    what the cameras say about the rotation also tells something about the position.""",
    ("K = ", "covariance = covariance * np.kron(np.eye(2), np.ones((3, 3)))\n    K = "))
pose_update.slip("landmark by landmark", """Each landmark was linearised at the pose that the one before it had left.
    All measurements of a frame are of one moment: linearise all at the predicted pose and stack them.""",
    ("predicted = ",
     "if len(pixels) > 1:\n"
     "        first = pose_update(camera, world_T_imu, covariance, landmarks[:1], pixels[:1], sigma_px)\n"
     "        return pose_update(camera, *first, landmarks[1:], pixels[1:], sigma_px)\n"
     "    predicted = "))
