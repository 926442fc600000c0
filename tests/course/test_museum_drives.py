"""The museum's filters make the mistake that they are hung for, and no other."""

import numpy as np
import pytest

from vislam_edu import kalman, motion, simulate, window_slam
from vislam_edu.course.ch10 import broken_filters
from vislam_edu.course.ch10.broken_filters import VARIANTS, Variant, Visit, visit
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.error_state import RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import consistency
from vislam_edu.studies.runs import attempt

NOISE = Noise(sigma_v=0.3, sigma_omega=0.01)
KNOWN = {name: piece for name, piece in VARIANTS.items() if piece.exercise}


@pytest.fixture(scope="module")
def drive():
    return simulate.street_loop(seed=3, frames=12, visible=6, loop_length=250, sigma_v=0.3, sigma_omega=0.01)


@pytest.fixture(scope="module")
def start(drive):
    return consistency.initial_pose(drive, consistency.FilterConfig(NOISE, RightPerturbation()), 3)


@pytest.fixture(scope="module")
def visits(drive, start):
    return {name: visit(piece, drive, NOISE, start) for name, piece in VARIANTS.items()}


@pytest.fixture(scope="module")
def belief(drive, start):
    """The right filter's belief after some frames, far from the identity."""
    *_, last = window_slam.run(drive, NOISE, gate=1, world_T_imu=start)
    return last.posterior


@pytest.fixture(scope="module")
def sensors(drive):
    return window_slam.UpdateSettings(drive.camera, NOISE, RightPerturbation(), threshold=np.inf, min_disparity=1.0)


def wrong_version(piece):
    """The function that hangs in the exercise of this piece."""
    return next(m.function for m in EXERCISES[piece.exercise].mistakes if m.name == piece.mistake)


def error_state(name, drive):
    return VARIANTS[name].applied_to(drive)[1]["error_state"]


def test_every_piece_but_the_right_one_hangs_in_an_exercise_too():
    assert set(VARIANTS) - set(KNOWN) == {"right"}
    for piece in KNOWN.values():
        assert callable(wrong_version(piece))


def test_the_right_one_is_the_package_and_every_mistake_stops_it_or_changes_the_path(drive, start, visits):
    poses = [step.posterior.world_T_imu for step in window_slam.run(drive, NOISE, gate=1, world_T_imu=start)]
    np.testing.assert_array_equal(visits["right"].run.world_T_imu, poses)
    for name in KNOWN:
        path, stopped = visits[name].run.world_T_imu, visits[name].run.stopped
        assert stopped is not None or np.abs(path - poses).max() > 1e-4, name


def test_camera_pieces_are_those_of_the_exercises(drive):
    points = np.array([[1.0, 0.5, 8.0], [-3.0, 1.0, 20.0]])
    camera = VARIANTS["depth"].applied_to(drive)[0].camera
    expected = [wrong_version(VARIANTS["depth"])(drive.camera, point) for point in points]
    np.testing.assert_allclose(camera.projection_jacobian(points), expected)
    np.testing.assert_array_equal(camera.project(points)[0], drive.camera.project(points)[0])

    camera, pixels = VARIANTS["bearings"].applied_to(drive)[0].camera, drive.camera.project(points)[0]
    expected, _ = wrong_version(VARIANTS["bearings"])(camera.K, camera.baseline, pixels)
    np.testing.assert_allclose(camera.triangulate(pixels)[0], expected)


@pytest.mark.parametrize("name", ["extrinsics", "sign"])
def test_pose_jacobians_are_those_of_the_exercises(name, drive, belief):
    J = drive.camera.measurement_jacobian(drive.camera.to_cam(belief.world_T_imu, belief.landmarks))
    arguments = belief.world_T_imu, belief.landmarks, J
    H_landmark, H_pose = error_state(name, drive).jacobians(*arguments)
    wrong = wrong_version(VARIANTS[name])
    np.testing.assert_allclose(H_pose, [wrong(drive.camera, belief.world_T_imu, m) for m in belief.landmarks])
    np.testing.assert_array_equal(H_landmark, RightPerturbation().jacobians(*arguments)[0])


@pytest.mark.parametrize("name", ["world", "copy", "order"])
def test_corrections_are_those_of_the_exercises(name, drive, belief):
    rng = np.random.default_rng(0)
    n = belief.landmarks.size
    H, V, residual = rng.normal(size=(4, n + 6)), np.eye(4), rng.normal(size=4)
    delta, _ = kalman.update(belief.covariance, H, V, residual)
    expected = wrong_version(VARIANTS[name])(belief.world_T_imu, belief.landmarks, belief.covariance, H, residual, V)
    T, landmarks = error_state(name, drive).retract(belief.world_T_imu, belief.landmarks, delta)
    np.testing.assert_allclose(T, expected[0], atol=1e-12)
    np.testing.assert_allclose(landmarks, expected[1], atol=1e-12)


def test_prediction_without_the_cross_terms_is_that_of_the_exercise(drive, belief):
    right = motion.ImuDriven(drive, NOISE, RightPerturbation())
    transition = right.transition(belief, 5)
    W = transition.N_tail @ transition.Q @ transition.N_tail.T
    expected = wrong_version(VARIANTS["cross"])(belief.covariance, transition.F_tail, W)
    model = broken_filters.CrossNotPropagated(drive, NOISE, RightPerturbation())
    np.testing.assert_allclose(model.predict(belief, 5).covariance, expected, atol=1e-15)


def test_motion_pieces_change_the_noise_or_the_twist_only(drive):
    right, unscaled, swapped, degrees = (
        kind(drive, NOISE, RightPerturbation())
        for kind in (motion.ImuDriven, broken_filters.NoiseWithoutTau, broken_filters.SwappedTwist,
                     broken_filters.Degrees)
    )
    np.testing.assert_allclose(unscaled.body_noise * drive.taus[:, None, None], right.body_noise)
    np.testing.assert_array_equal(unscaled.increments, right.increments)
    for name, model in (("swapped", swapped), ("degrees", degrees)):
        expected = [wrong_version(VARIANTS[name])(xi) for xi in drive.taus[:, None] * drive.step_twists]
        np.testing.assert_allclose(model.increments, expected, atol=1e-14)


def frame_with_births(drive, belief):
    """A belief that has forgotten three of its landmarks, and a frame in which they are seen again."""
    keep = np.arange(len(belief.ids)) >= 3
    ids, pixels = drive.observed(drive.n_frames - 1)
    return window_slam.marginalise(belief, keep), ids, pixels, belief.ids[~keep]


def test_uncorrelated_births_keep_all_but_the_correlation(drive, belief, sensors):
    prior, ids, pixels, new = frame_with_births(drive, belief)
    _, right, _ = window_slam.correlated(prior, ids, pixels, sensors)
    _, wrong, _ = broken_filters.born_uncorrelated(prior, ids, pixels, sensors)
    at = np.flatnonzero(window_slam.contains(new, right.ids))
    assert len(at) == 3
    np.testing.assert_array_equal(wrong.landmark_covariance, right.landmark_covariance)
    for i in at:
        rest = np.delete(wrong.covariance[3 * i:3 * i + 3], np.r_[3 * i:3 * i + 3], axis=1)
        assert not rest.any()
        assert np.delete(right.covariance[3 * i:3 * i + 3], np.r_[3 * i:3 * i + 3], axis=1).any()
    old = np.append(np.repeat(~window_slam.contains(new, right.ids), 3), np.ones(6, bool))
    np.testing.assert_array_equal(wrong.covariance[np.ix_(old, old)], right.covariance[np.ix_(old, old)])


def test_used_twice_halves_the_variance_that_triangulation_left(drive, start, sensors):
    """With a pose known to a hair only the triangulation counts, and two equal measurements halve it."""
    prior = motion.start(Noise(initial_pose_covariance=1e-14 * np.eye(6)), start)
    ids, pixels = drive.observed(0)
    _, once, _ = window_slam.correlated(prior, ids, pixels, sensors)
    _, twice, _ = broken_filters.used_twice(prior, ids, pixels, sensors)
    np.testing.assert_allclose(twice.landmark_covariance, once.landmark_covariance / 2, rtol=1e-3, atol=1e-8)


class FallsApart(RightPerturbation):
    """NaN from the third correction on."""

    def __init__(self):
        self.left = 3

    def retract(self, world_T_imu, landmarks, delta):
        self.left -= 1
        return super().retract(world_T_imu, landmarks, delta * (np.nan if self.left < 0 else 1))


def test_a_filter_that_falls_apart_is_stopped_and_said_to_diverge(drive, start):
    seen = visit(Variant("falls apart", lambda drive: (drive, {"error_state": FallsApart()})), drive, NOISE, start)
    assert 0 < seen.run.stopped < drive.n_frames
    assert len(seen.run.world_T_imu) == len(seen.error) == len(seen.nis) == len(seen.nees) == seen.run.stopped
    assert seen.lost
    assert seen.numbers[0] == "diverged"


def test_numbers_are_two_digits_and_capped_where_they_are_chance():
    def of(error, nis, nees):
        return Visit("", attempt([]), np.array([error]), np.array([np.nan, nis]), np.array([nees]))

    assert of(0.126, 4.14, 363.0).numbers == ("0.13 m", "4.1", "360")
    assert of(9.0, 99.0, 1000.0).numbers == ("9.00 m", "99", "1000")
    assert of(11.0, 101.0, np.inf).numbers == ("diverged", "> 100", "> 1000")


@pytest.mark.parametrize("variant", [variant for variant in VARIANTS.values() if variant.edit], ids=lambda v: v.title)
def test_an_edit_shows_a_wrong_line_and_the_right_one(variant):
    """Where a line is to be added or taken away, only one of the two."""
    place, *lines = variant.edit.diff.splitlines()
    assert place.split(".")[0] in ("StereoCamera", "RightPerturbation", "ImuDriven")
    assert {line[0] for line in lines} - {" "} in ({"-", "+"}, {"-"}), lines
