"""Every plain answer gives the numbers of the package's own function for the same thing, on inputs of further seeds."""

from types import SimpleNamespace

import numpy as np
import pytest

from vislam_edu import association, batch, ekf_slam, kalman, metrics, odometry, se3, stereo, tracking, window_slam
from vislam_edu.belief import Belief
from vislam_edu.course.ch16 import msckf
from vislam_edu.course.checks.comparing import differs
from vislam_edu.course.checks.running import copied, outcome_of, read
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.imu import VELOCITY, ImuNoise, jacobians, preintegrate
from vislam_edu.lens import Lens
from vislam_edu.noise import Noise
from vislam_edu.odometry import PoseBelief
from vislam_edu.stereo import StereoCamera


def stereo_camera(K, baseline):
    return StereoCamera(K, baseline, np.eye(4))


def pose_update(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
    posterior, _ = odometry.observe(PoseBelief(world_T_imu, covariance), camera, Noise(sigma_px=sigma_px),
                                    np.arange(len(pixels)), pixels, landmarks, np.inf)
    return posterior.world_T_imu, posterior.covariance


def invariant_noise(world_T_imu, landmarks, body_noise):
    _, B = RightInvariant().pose_transition(world_T_imu, np.eye(4), body_noise)
    return np.vstack([*RightInvariant().landmark_transition(landmarks, B), B])


def whole_map(landmarks, covariance):
    """A map as candidates: each of its landmarks among the new ones and among the old ones."""
    rows = np.arange(len(landmarks))
    return association.Candidates(rows, rows, np.tile(landmarks, (2, 1)), np.tile(covariance, (2, 2)))


def belief_of(landmarks, covariance):
    return Belief(np.eye(4), landmarks, np.arange(len(landmarks)), covariance)


def fuse_pair(landmarks, covariance, new, old):
    rest = len(covariance)
    P = np.eye(rest + 6)  # with a pose that has nothing to do with the map
    P[:rest, :rest] = covariance
    fused = association.fuse(belief_of(landmarks, P), [(new, old)], RightPerturbation())
    return fused.landmarks, fused.covariance[:-6, :-6]


def left_behind(landmarks, covariance, keep):
    kept = window_slam.marginalise(belief_of(landmarks, covariance), keep)
    return kept.landmarks, kept.covariance


def curved_mean(f, baseline, point, covariance):
    camera = stereo_camera(np.diag([f, f, 1.0]), baseline)
    H = camera.projection_jacobian(point)[:3, :3]
    return stereo.second_order(camera.project(point)[0], H @ covariance @ H.T)


def filter_predict(world_T_imu, covariance, twist, tau, noise):
    n = (len(covariance) - 6) // 3
    after = ekf_slam.predict(Belief(world_T_imu, np.zeros((n, 3)), np.arange(n), covariance), twist, tau, noise)
    return after.world_T_imu, after.covariance


def patch_information(g_u, g_v):
    A = np.einsum("iab,jab->ij", *2 * [np.array([g_u, g_v])])
    return A, tracking.smaller_eigenvalue(A)


def velocity_rows(rotation, force, tau):
    F = jacobians(rotation, np.zeros(3), force, tau)[0][VELOCITY]
    F[:, 9:12] = 0  # the package turns the force by half a step, the exercise does not
    return F


def project_track(H_x, H_f, residual):
    N = msckf.null_space(H_f)
    return H_x.T @ N @ N.T @ H_x, H_x.T @ N @ N.T @ residual


def datasheet(angle_random_walk, velocity_random_walk, rate):
    Q = ImuNoise.from_datasheet(angle_random_walk, velocity_random_walk, 0, 0).covariance(1 / rate)
    return Q[0, 0]**0.5, Q[3, 3]**0.5


PACKAGE = {
    "so3_hat": se3.so3_hat, "se3_hat": se3.hat, "so3_exp": se3.so3_exp, "se3_exp": se3.exp, "adjoint": se3.adjoint,
    "left_jacobian": se3.left_jacobian, "odot": se3.odot,
    "dead_reckon": lambda start, twists, taus: se3.chain(start, se3.exp(taus[:, None] * twists)),
    "predict_covariance": lambda P, twist, tau, Q: odometry.predict(
        PoseBelief(np.eye(4), P), twist, tau, SimpleNamespace(twist_covariance=Q)).covariance,
    "datasheet_noise": lambda walk, density, rate: Noise.from_density(
        density, np.radians(walk) / 60, rate).process_covariance(1 / rate),
    "bearing": stereo.bearing,
    "triangulate_bearings": lambda K, uv1, uv2, R, p: stereo.triangulate_bearings(
        stereo.bearing(K, uv1), stereo.bearing(K, uv2), R, p)[0],
    "triangulate": lambda K, baseline, pixels: stereo_camera(K, baseline).triangulate(pixels),
    "triangulation_covariance": lambda K, baseline, point, sigma: stereo_camera(
        K, baseline).triangulation_covariance(point, sigma),
    "project": lambda camera, points: camera.project(points)[0],
    "projection_jacobian": StereoCamera.projection_jacobian, "landmark_jacobian": StereoCamera.landmark_jacobian,
    "kalman_update": kalman.update, "pose_jacobian": StereoCamera.pose_jacobian, "pose_update": pose_update,
    "predict_joint": ekf_slam.predict_joint, "new_landmark": ekf_slam.new_landmark,
    "joint_jacobian": ekf_slam.joint_jacobian, "joint_update": ekf_slam.joint_update,
    "process_noise": lambda sigma_v, sigma_omega, tau: Noise(sigma_v, sigma_omega).process_covariance(tau),
    "nees": metrics.nees, "chi2_band": metrics.chi2_band,
    "invariant_noise": invariant_noise,
    "invariant_jacobian": lambda J, T: RightInvariant().jacobians(T, np.empty((len(J), 3)), J),
    "invariant_retract": RightInvariant().retract,
    "twist_jacobians": lambda this, after, tau: [
        J[0] for J in batch.path_twists(np.array([this, after]), np.array([tau]))[1:]],
    "robust_weight": lambda r, c: batch.cauchy(np.sum(r**2, axis=1), c),
    "pair_covariance": lambda landmarks, P, i, j: whole_map(landmarks, P).joint([(i, j)]),
    "joint_nis": lambda landmarks, P, pairs: (whole_map(landmarks, P).joint_nis(pairs),
                                              kalman.chi_square_quantile(0.99, 3 * len(pairs))),
    "fuse_pair": fuse_pair, "merge_ids": association.merged,
    "filter_predict": filter_predict, "curved_mean": curved_mean, "left_behind": left_behind,
    "patch_information": patch_information,
    "rectify_point": lambda uv, K, R, K_new: Lens(K, rectified_R_cam=R).rectify(uv, K_new),
    "velocity_rows": velocity_rows,
    "rotation_bias_jacobian": lambda omega, taus: preintegrate(
        omega, np.zeros_like(omega), taus, np.zeros(3), np.zeros(3)).bias_jacobian[:3, :3],
    "project_track": project_track,
    "first_estimates_jacobian": lambda J, pose, landmark, *_: np.hstack(
        RightPerturbation().jacobians(pose, landmark, J)),
    "datasheet": datasheet,
}


@pytest.mark.parametrize("name", PACKAGE)
def test_a_plain_answer_gives_the_packages_numbers(name):
    exercise = EXERCISES[name]
    for _, arguments in (case for seed in range(3) for case in exercise.inputs(seed)):
        expected = read(PACKAGE[name](*map(copied, arguments)), exercise.outputs)[0]
        for answer in exercise.answers:
            with np.errstate(divide="ignore", invalid="ignore"):  # a disparity of zero
                outcome = outcome_of(exercise, answer, arguments)
            assert not differs(exercise, outcome, expected)
