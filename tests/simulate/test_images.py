"""Rendered images: what they show is where truth says it is, and tracker and filter work on them end to end."""

import numpy as np
import pytest
from whole import few

from vislam_edu import Noise, RightInvariant, simulate, tracking
from vislam_edu.simulate import images
from vislam_edu.studies import consistency


@pytest.fixture(scope="module")
def street():
    return images.street_images(1, frames=40)


def tracked_in(street):
    drive = street.drive.replace(**tracking.as_fields(tracking.track(street, street.rig, visible=60, distance=8)))
    return images.with_true_landmarks(street, drive)


@pytest.fixture(scope="module")
def tracked(street):
    return tracked_in(street)


def test_depth_is_where_the_other_camera_sees_the_same_grey_value(street):
    grey, depth = street.render(3)
    right, _ = street.render(3, street.drive.camera.baseline)
    v, u = np.mgrid[20:140:7, 100:380:7].reshape(2, -1)
    camera = street.drive.camera
    at = u - camera.K[0, 0] * camera.baseline / depth[v, u]
    seen = np.isfinite(depth[v, u]) & (at > 0)
    seen_there = np.array([np.interp(x, np.arange(400), right[row]) for x, row in zip(at[seen], v[seen])])
    assert np.median(np.abs(seen_there - grey[v, u][seen])) < 2.0


def test_images_are_reproducible_and_noisy(street):
    first, second = street[5], images.street_images(1, frames=40)[5]
    assert np.array_equal(first[0], second[0])
    noise = first[0] - np.clip(street.render(5)[0], 0, 255)
    assert noise.std() == pytest.approx(2.0, abs=0.15)


def test_tracks_are_where_truth_says(tracked):
    poses, landmarks = tracked.true_world_T_imu[tracked.frame], tracked.true_landmarks[tracked.landmark]
    expected, _ = tracked.camera.observe(poses, landmarks)
    error = tracked.pixels - expected
    age = tracked.frame - tracked.first_seen[tracked.landmark]
    assert np.nanmedian(np.abs(error[:, 0] - error[:, 2])) < 0.05  # disparity
    assert np.nanmedian(np.abs(error[age == 1, 0])) < 0.05
    assert np.nanmedian(np.abs(error[age == 10, 0])) < 0.2


@pytest.mark.parametrize("seed", few(1, range(1, 6)))
def test_from_images_to_a_consistent_path(tracked, seed):
    """The filter's claims hold on tracked images, about as they do on the same tracks with white noise."""
    noise, invariant = Noise(), RightInvariant()
    config = consistency.FilterConfig(noise, invariant)
    drive = simulate.add_noise(tracked if seed == 1 else tracked_in(images.street_images(seed, frames=40)), seed,
                               sigma_px=0.0)
    drive = drive.keep_landmarks(np.isfinite(drive.truth_landmarks).all(axis=1))
    ideal, _ = drive.camera.observe(drive.true_world_T_imu[drive.frame], drive.true_landmarks[drive.landmark])
    white = noise.sigma_px * np.random.default_rng(seed).standard_normal(ideal.shape)
    tracks, simulated = (consistency.judge(one, config, consistency.initial_pose(one, config, seed))
                         for one in (drive, drive.replace(pixels=ideal + white)))
    assert tracks["nees_pose"].mean() < 12
    assert np.mean(tracks["error"]**2) < 4 * np.mean(simulated["error"]**2)
