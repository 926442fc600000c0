"""The two half problems, landmarks on given poses and the pose on a given map, against plain loops."""

import numpy as np
import pytest
import reference
from scipy.linalg import expm
from scipy.stats import chi2

from vislam_edu import kalman, mapping, metrics, odometry, simulate
from vislam_edu.error_state import RightPerturbation
from vislam_edu.noise import Noise

NOISE = Noise()
GATE = 0.95  # tighter than usual, so that it is at work
LEAST = 9.0  # px, so that landmarks wait for a better view
START = expm(reference.hat4([0.05, -0.04, 0.03, 0.002, 0.001, -0.003]))  # near the truth, not at it


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=4, frames=50, visible=10)


def plain_map(drive, poses, threshold, as_report):
    """Yields {id: (mean, covariance)} and {id: NIS} after every frame; one landmark after the other."""
    camera, V, landmarks = drive.camera, NOISE.sigma_px**2 * np.eye(4), {}
    for k, T in enumerate(poses):
        nis = {}
        for i, z in zip(*drive.observed(k)):
            if i not in landmarks:
                if z[0] - z[2] <= LEAST:
                    continue
                s, C = reference.triangulate(camera, z)
                R = T[:3, :3]
                landmarks[i] = (T @ [*s, 1])[:3], 2 * np.eye(3) if as_report else NOISE.sigma_px**2 * R @ C @ R.T
                if not as_report:
                    continue
            m, P = landmarks[i]
            h, _, H, _ = reference.project(camera, T, m)
            S = H @ P @ H.T + V
            nis[i] = (z - h) @ np.linalg.inv(S) @ (z - h)
            if nis[i] <= threshold:
                K = P @ H.T @ np.linalg.inv(S)
                landmarks[i] = m + K @ (z - h), (np.eye(3) - K @ H) @ P
        yield dict(landmarks), nis


@pytest.mark.parametrize(("initialise", "as_report"), [(mapping.triangulated, False), (mapping.report_prior, True)])
def test_mapping_agrees_with_plain_loops(drive, initialise, as_report):
    poses, rejected = drive.true_world_T_imu, 0
    plain = plain_map(drive, poses, kalman.gate_threshold(GATE), as_report)
    steps = list(mapping.run(drive, NOISE, poses, initialise, gate=GATE, min_disparity=LEAST))
    assert any((step.k > drive.first_seen[step.born]).any() for step in steps)
    for step, (landmarks, nis) in zip(steps, plain, strict=True):
        belief = step.posterior
        assert set(np.flatnonzero(belief.seen)) == set(landmarks)
        assert set(step.innovation.ids) == set(nis)
        np.testing.assert_allclose(step.innovation.nis, [nis[i] for i in step.innovation.ids], rtol=1e-6)
        for i, (m, P) in landmarks.items():
            np.testing.assert_allclose(belief.landmarks[i], m, atol=1e-8)
            np.testing.assert_allclose(belief.covariance[i], P, rtol=1e-6, atol=1e-9)
        rejected += (~step.innovation.accepted).sum()
    assert rejected > 0


def plain_pose(drive, threshold):
    """Yields (pose, covariance, {id: NIS}) after every frame; all measurements of a frame stacked."""
    T, P = START, NOISE.initial_pose_covariance
    for k in range(drive.n_frames):
        if k:
            u, tau = drive.step_twists[k - 1], drive.taus[k - 1]
            F, B = expm(-tau * reference.curly(u)), tau * reference.right_jacobian(tau * u)
            T, P = T @ expm(tau * reference.hat4(u)), F @ P @ F.T + B @ NOISE.twist_covariance @ B.T
        rows, residuals, nis = [], [], {}
        for i, z in zip(*drive.observed(k)):
            h, _, _, H = reference.project(drive.camera, T, drive.true_landmarks[i])
            nis[i] = (z - h) @ np.linalg.inv(H @ P @ H.T + NOISE.sigma_px**2 * np.eye(4)) @ (z - h)
            if nis[i] <= threshold:
                rows.append(H)
                residuals.append(z - h)
        H, r = np.vstack(rows), np.concatenate(residuals)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + NOISE.sigma_px**2 * np.eye(len(r)))
        T, P = T @ expm(reference.hat4(K @ r)), (np.eye(6) - K @ H) @ P
        yield T, P, nis


def test_localisation_agrees_with_plain_loops(drive):
    rejected = 0
    plain = plain_pose(drive, kalman.gate_threshold(GATE))
    steps = odometry.localize(drive, NOISE, drive.true_landmarks.tolist(), gate=GATE, world_T_imu=START)
    for step, (T, P, nis) in zip(steps, plain, strict=True):
        np.testing.assert_allclose(step.posterior.world_T_imu, T, atol=1e-8)
        np.testing.assert_allclose(step.posterior.covariance, P, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(step.innovation.nis, [nis[i] for i in step.innovation.ids], rtol=1e-6)
        rejected += (~step.innovation.accepted).sum()
    assert rejected > 0


def test_dead_reckoning_knows_how_little_it_knows():
    """Mean NEES over 100 draws of noise and start, frame by frame, in the band that chi-square gives beforehand."""
    runs, error_state = 100, RightPerturbation()
    road = simulate.perfect_street_loop(seed=1, frames=40)
    truth, rng, nees = road.true_world_T_imu, np.random.default_rng(5), []
    for seed in range(runs):
        start = expm(-reference.hat4(rng.multivariate_normal(np.zeros(6), NOISE.initial_pose_covariance)))
        reckoned = odometry.dead_reckon(simulate.add_noise(road, seed), NOISE, start)
        nees.append(metrics.pose_nees(error_state, truth, reckoned.world_T_imu, reckoned.covariance).pose)
    share = 1e-4 / len(truth)  # of false alarms, shared out among the frames
    low, high = chi2.ppf([share / 2, 1 - share / 2], 6 * runs) / runs
    mean = np.mean(nees, axis=0)
    assert mean.min() > low
    assert mean.max() < high


def test_without_any_measurement_the_pose_is_dead_reckoned(drive):
    blind = drive.keep_landmarks(np.zeros(drive.n_landmarks, bool))
    reckoned = odometry.dead_reckon(drive, NOISE)
    for step in odometry.localize(blind, NOISE, np.empty((0, 3))):
        assert step.time == reckoned.times[step.k]
        np.testing.assert_array_equal(step.posterior.world_T_imu, reckoned.world_T_imu[step.k])
        np.testing.assert_array_equal(step.posterior.covariance, reckoned.covariance[step.k])


def test_bad_shapes_are_named(drive):
    with pytest.raises(ValueError, match=r"world_T_imu must have shape \(50, 4, 4\).*got \(49, 4, 4\)"):
        next(mapping.run(drive, NOISE, drive.true_world_T_imu[1:]))
    with pytest.raises(ValueError, match=r"landmarks must have shape \(\d+, 3\).*got \(3, 3\)"):
        next(odometry.localize(drive, NOISE, np.zeros((3, 3))))
