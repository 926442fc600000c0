"""Robust weights against a plain reference, slip against the pixels it stands for, and how safe both are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from whole import few

from vislam_edu import kalman, robust, simulate, stereo, window_slam
from vislam_edu.belief import NO_INNOVATION
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.motion import TwistAndBias
from vislam_edu.noise import Noise
from vislam_edu.simulate import faults
from vislam_edu.studies import pipeline, run_warnings

SEEDS = few(2, range(3))


@cache
def street(seed, share=0.0):
    """A drive with a share of its tracks wrong for life."""
    return faults.outlier_tracks(simulate.street_loop(seed=seed, frames=150), share, seed=seed)


@cache
def joint(seed, share, process_frame=robust.process_frame, error_state=RightInvariant):
    """The joint filter; the covariance of every pose must be positive definite."""
    drive = street(seed, share)
    steps = window_slam.run(drive, Noise(), error_state(), motion_model=robust.RealDrive, process_frame=process_frame)
    slam = pipeline.collect_slam(drive, steps, error_state())
    np.linalg.cholesky(slam.trajectory.covariance)  # raises LinAlgError when it is not
    return slam


def rmse(seed, share, process_frame=robust.process_frame):
    """Position RMSE, m."""
    slam = joint(seed, share, process_frame)
    error = slam.trajectory.world_T_imu - street(seed, share).true_world_T_imu
    return np.sqrt(np.mean(np.sum(error[:, :3, 3] ** 2, axis=-1)))


@pytest.mark.parametrize("seed", SEEDS)
def test_ten_per_cent_outlier_tracks_at_most_double_the_error(seed):
    assert rmse(seed, 0.1) <= 2 * rmse(seed, 0.0)


def test_weights_cost_nothing_on_a_clean_drive():
    weighted, gated = (np.mean([rmse(seed, 0.0, process_frame) for seed in SEEDS])
                       for process_frame in (robust.process_frame, window_slam.correlated))
    assert weighted < 1.1 * gated


def test_a_gate_for_each_landmark_alone_is_not_enough():
    """So the doubling above is a bound that a filter can break."""
    grown = [rmse(seed, 0.1, window_slam.correlated) / rmse(seed, 0.0, window_slam.correlated)
             for seed in SEEDS]
    assert max(grown) > 2


@pytest.mark.parametrize("error_state", [RightInvariant, RightPerturbation])
@pytest.mark.parametrize("process_frame", [window_slam.correlated, robust.process_frame])
def test_thirty_per_cent_outlier_tracks_are_said_aloud(process_frame, error_state):
    for share, warned in ((0.0, False), (0.3, True)):
        run = joint(0, share, process_frame, error_state).run
        assert bool(list(run_warnings.of_innovations(run, gate=0.99))) == warned


def test_weights_fall_to_a_half_at_the_width_and_the_loss_is_bounded():
    squared = np.array([0.0, robust.HALF_WEIGHT**2, 1e12])
    np.testing.assert_allclose(robust.weights(squared), [1, 0.5, 0], atol=1e-9)
    assert (robust.weights(squared) * squared <= robust.HALF_WEIGHT**2).all()


@pytest.mark.parametrize("error_state", [RightInvariant(), RightPerturbation()])
def test_the_update_is_a_dense_update_with_the_weights_written_out(error_state):
    drive = street(0)
    *_, step = window_slam.run(drive.slice(0, 20), Noise(), error_state)
    prior, ids, pixels = step.prior, step.innovation.ids, step.innovation.measured
    settings = window_slam.UpdateSettings(drive.camera, Noise(), error_state, kalman.gate_threshold(0.99), 1.0)
    posterior, innovation = robust.update(prior, ids, pixels, settings)

    passed = step.innovation.accepted
    H, _ = window_slam.linearise(prior, ids[passed], settings)
    dense = np.zeros((len(H.rows), 3, len(prior.covariance)))
    for i, row in enumerate(H.rows):
        dense[i, :, 3 * row:3 * row + 3] = H.H_landmark[i]
        dense[i, :, prior.pose] = H.H_pose[i]
    residual = step.innovation.residual[passed]
    rows = stereo.reduce_rows(residual)
    V = Noise().sigma_px**2 * stereo.ROW_VARIANCE
    squared = step.innovation.nis[passed]
    for _ in range(3):
        noise = np.diag((V * (1 + squared / 4)[:, None]).ravel())
        delta, P = kalman.update(prior.covariance, dense.reshape(-1, dense.shape[-1]), noise, rows.ravel())
        left = rows - dense @ delta
        squared = (left**2 / V).sum(1) + (residual[:, 1] - residual[:, 3]) ** 2 / (2 * Noise().sigma_px**2)
    np.testing.assert_allclose(posterior.covariance, P, atol=1e-10)
    T, _ = error_state.retract(prior.world_T_imu, prior.landmarks, delta[:prior.pose.stop])
    np.testing.assert_allclose(posterior.world_T_imu, T, atol=1e-10)
    assert (innovation.accepted[passed] == (squared <= settings.threshold)).all()


def test_no_measurement_no_update():
    drive = street(0)
    step = next(window_slam.run(drive, Noise(), RightInvariant()))
    settings = window_slam.UpdateSettings(drive.camera, Noise(), RightInvariant(), 13.0, 1.0)
    posterior, innovation = robust.update(step.posterior, np.empty(0, int), np.empty((0, 4)), settings)
    assert posterior is step.posterior
    assert innovation is NO_INNOVATION


@pytest.mark.parametrize("error_state", [RightInvariant(), RightPerturbation()])
def test_slip_is_a_walk_of_the_landmarks_whose_image_is_q_pixels(error_state):
    """What slip adds to the usual prediction: each landmark's own block, q^2 V_1 in its image, nothing else."""
    drive, noise = street(0), Noise()
    model, usual = robust.RealDrive(drive, noise, error_state), TwistAndBias(drive, noise, error_state, 0.1, 0.03)
    *_, step = window_slam.run(drive.slice(0, 6), noise, error_state, motion_model=robust.RealDrive)
    belief = replace(step.posterior, motion=np.r_[10.0, np.zeros(8)])  # moving: images grow
    after, plain = model.predict(belief, 5), usual.predict(belief, 5)
    added, n = after.covariance - plain.covariance, len(after.ids)
    before, now = (drive.camera.to_cam(b.world_T_imu, b.landmarks) for b in (belief, after))
    q = model.slip_px(before[:, 2], now[:, 2])
    assert q.min() > 0.1
    assert q.max() > 2 * q.min()  # near points slip more
    R = after.world_T_imu[:3, :3]
    for i in range(n):
        block = slice(3 * i, 3 * i + 3)
        J = drive.camera.measurement_jacobian(now[i])[[0, 1, 2]] @ R.T
        np.testing.assert_allclose(J @ added[block, block] @ J.T, q[i] ** 2 * np.diag(stereo.ROW_VARIANCE), atol=1e-6)
        added[block, block] = 0
    assert not added.any()
    assert model.slip_px(10.0, 10.0 / np.e) == pytest.approx(np.hypot(0.1, 2.0))
