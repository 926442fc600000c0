"""The backward pass against the filter that keeps every landmark to the end."""

import numpy as np
import pytest

from vislam_edu import simulate, smoother, window_slam
from vislam_edu.error_state import RightInvariant
from vislam_edu.noise import Noise

NOISE = Noise()


@pytest.fixture(scope="module")
def drive():
    """Over 200 landmarks, outliers among them, the gate at work."""
    return simulate.street_loop(seed=11, frames=150, visible=22, outlier_share=0.08)


def dense(drive, **options):
    rejected = 0
    for step in window_slam.run(drive, NOISE, retire=window_slam.retire_none, **options):
        rejected += (~step.innovation.accepted).sum()
    return step.posterior, rejected


@pytest.mark.parametrize("process_frame", [window_slam.correlated, window_slam.as_report])
def test_every_landmark_is_what_the_dense_filter_says_at_the_end(drive, process_frame):
    full, rejected = dense(drive, process_frame=process_frame)
    final = smoother.final_map(drive, NOISE, process_frame=process_frame)
    assert len(full.ids) >= 200
    assert rejected > 20
    np.testing.assert_array_equal(np.flatnonzero(final.seen), full.ids)
    # 1e-8 m; rtol is for outliers that the filter puts half a kilometre away, known to hundreds of metres
    np.testing.assert_allclose(final.landmarks[full.ids], full.landmarks, rtol=1e-10, atol=1e-8)
    scale = np.abs(full.landmark_covariance).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(final.covariance[full.ids] / scale, full.landmark_covariance / scale, rtol=0, atol=1e-6)


def test_the_future_had_something_to_say(drive):
    """Otherwise the test above would pass for a pass that does nothing."""
    at_retirement = {}
    for step in window_slam.run(drive, NOISE):
        for i, m in zip(step.posterior.ids, step.posterior.landmarks):
            at_retirement[i] = m
    final = smoother.final_map(drive, NOISE)
    moved = [np.linalg.norm(final.landmarks[i] - m) for i, m in at_retirement.items()]
    assert np.median(moved) > 1e-3


def test_right_invariant_agrees_to_first_order():
    """With little noise the turn of the whole map is nearly a sum, and the two agree far below their uncertainty."""
    quiet = Noise(sigma_v=0.02, sigma_omega=0.002, sigma_px=0.1, initial_pose_covariance=1e-8 * np.eye(6))
    drive = simulate.street_loop(seed=2, frames=60, visible=15, sigma_v=0.02, sigma_omega=0.002, sigma_px=0.1)
    *_, step = window_slam.run(drive, quiet, RightInvariant(), retire=window_slam.retire_none)
    full = step.posterior
    final = smoother.final_map(drive, quiet, RightInvariant())
    C = np.concatenate([np.broadcast_to(np.eye(3), (len(full.ids), 3, 3)),
                        RightInvariant().world_landmark(full.landmarks)], axis=-1)
    P = full.covariance
    i = (3 * np.arange(len(full.ids))[:, None] + np.arange(3))
    index = np.concatenate([i, np.broadcast_to(np.arange(len(P) - 6, len(P)), (len(i), 6))], axis=1)
    world = C @ P[index[:, :, None], index[:, None, :]] @ C.swapaxes(1, 2)
    sigma = np.sqrt(np.trace(world, axis1=1, axis2=2))
    assert np.max(np.linalg.norm(final.landmarks[full.ids] - full.landmarks, axis=1) / sigma) < 0.02
    np.testing.assert_allclose(final.covariance[full.ids] / sigma[:, None, None]**2,
                               world / sigma[:, None, None]**2, atol=0.01)
