"""What the pictures show, read back from their artists and held against the histories they were made from."""

import dataclasses

import numpy as np
import picture_checks
import pytest
from matplotlib.path import Path
from numerical import central_difference
from scipy.stats import chi2, multivariate_normal
from vislam_edu.widgets.joint import JointPicture
from vislam_edu.widgets.localisation import LocalisationPicture
from vislam_edu.widgets.mapping import MappingPicture

from vislam_edu import mapping, odometry, se3, simulate, window_slam
from vislam_edu.error_state import RightInvariant, RightPerturbation
from vislam_edu.noise import Noise
from vislam_edu.studies import pipeline
from vislam_edu.widgets import Panel, Stepper, joint, localisation, stereo_depth, twist
from vislam_edu.widgets.stereo_depth import StereoDepthPicture
from vislam_edu.widgets.twist import TwistPicture

NOISE = Noise()
RADIUS2 = chi2.ppf(0.95, 2)


@pytest.fixture(scope="module")
def drive():
    return simulate.first_steps()


@pytest.fixture(scope="module")
def mapped(drive):
    return MappingPicture(mapping.run(drive, NOISE, drive.true_world_T_imu), drive, drive.true_world_T_imu)


@pytest.fixture(scope="module")
def localised(drive):
    return LocalisationPicture(
        odometry.localize(drive, NOISE, drive.true_landmarks), drive, NOISE, drive.true_landmarks
    )


@pytest.fixture(scope="module")
def joint_steps(drive):
    return list(window_slam.run(drive, NOISE))


@pytest.fixture(scope="module")
def joined(drive, joint_steps):
    without = window_slam.run(drive, NOISE, process_frame=window_slam.without_cross_covariance(window_slam.correlated))
    return JointPicture(joint_steps, drive, NOISE, without=without)


@pytest.fixture(scope="module")
def pictures(mapped, localised, joined):
    """Every picture with the states in which it is looked at."""
    steppers = [(p, [{"i": 0}, {"i": 1}, {"i": p.n // 2}, {"i": p.n - 1}]) for p in (mapped, localised, joined)]
    steppers[2][1].append({"i": joined.n - 1, "drop": True})
    panels = []
    for picture in (TwistPicture(), StereoDepthPicture()):
        start = {name: control.value for name, control in picture.controls.items()}
        ends = [
            {**start, name: getattr(control, end)}
            for name, control in picture.controls.items()
            for end in ("low", "high")
        ]
        panels.append((picture, [start, *ends]))
    return steppers + panels


def polygon_area(points):
    x, y = np.asarray(points).T
    return abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def distance2(points, mean, covariance):
    """Squared Mahalanobis distances (n,) of points (n, 2)."""
    return np.sum((points - mean) * np.linalg.solve(covariance, (points - mean).T).T, axis=1)


# --- all of them ---


@pytest.mark.parametrize("check", picture_checks.ALL, ids=lambda check: check.__name__)
def test_what_every_picture_must_stand(check, pictures):
    for picture, states in pictures:
        check(picture, states)


# --- 01 ---


def test_euler_reaches_the_exponential_at_first_order_only():
    xi, T = np.array([5.0, 1.0, 0.5, 0.1, 0.2, 0.3]), 4.0
    error = [np.abs(twist.euler(xi, T, n)[-1] - se3.exp(T * xi)).max() for n in (2000, 4000)]
    assert error[0] / error[1] == pytest.approx(2.0, rel=2e-3)
    np.testing.assert_allclose(twist.euler(xi, T, 1)[-1], np.eye(4) + T * se3.hat(xi))


def test_points_on_the_screw_axis_move_along_it_only():
    rng = np.random.default_rng(3)
    for xi in rng.standard_normal((20, 6)):
        direction, point = twist.screw_axis(xi)
        moved = se3.transform(se3.exp(xi), point)
        np.testing.assert_allclose(np.cross(moved - point, direction), 0, atol=1e-12)
    assert twist.screw_axis([1, 2, 3, 0, 0, 0]) is None


def test_banana_holds_what_it_promises_where_the_ellipse_does_not():
    """4000 runs: 95 % +- 1.4 % (four sigma). The covariance is first order: the rest of the tolerance."""
    xi, noise = np.array([5.0, 0, 0, 0, 0, 0.1]), twist.PlanarNoise(0.5, 0.15)
    normal = np.random.default_rng(0).standard_normal((12, 4000, 6))
    ends = twist.integrate_noisy(xi, noise, normal)[:, :2, 3]
    belief = twist.propagate(xi, noise, 12)
    inside = [Path(outline(belief)).contains_points(ends).mean() for outline in (twist.banana, twist.plane_ellipse)]
    assert abs(inside[0] - 0.95) < 0.02
    assert inside[1] < 0.91


def test_banana_is_the_ellipse_when_little_is_uncertain():
    xi, noise = np.array([5.0, 0, 0, 0, 0, 0.1]), twist.PlanarNoise(1e-5, 1e-6)
    belief = twist.propagate(xi, noise, 12)
    outline = twist.banana(belief)
    A = belief.world_T_imu[:2, :3]
    d2 = distance2(outline, belief.world_T_imu[:2, 3], A @ belief.covariance[:3, :3] @ A.T)
    np.testing.assert_allclose(d2, RADIUS2, rtol=1e-3)


def test_twist_sliders_move_the_frame():
    panel = Panel(TwistPicture())
    panel.controls["v_z"].value = 2.0
    panel.controls["samples"].value = 4
    panel.controls["omega_z"].value = -0.3
    state = panel.state
    end = se3.exp(twist.TAU * 4 * np.array([state["v_x"], 0, 2.0, 0, 0, -0.3]))
    shown = [line.get_xydata()[-1] for line in (panel.picture.path, panel.picture.mean_path)]
    np.testing.assert_allclose(shown[0], twist.VIEW @ end[:3, 3], atol=1e-12)
    np.testing.assert_allclose(shown[1], end[:2, 3], atol=1e-12)
    panel.controls["steps"].value = 7
    assert len(panel.picture.euler.get_xdata()) == 8


# --- 02 ---


def test_depth_law_is_the_triangulation_covariance_and_grows_with_the_square():
    camera = simulate.kitti_camera()
    for z in (5.0, 17.0, 60.0):
        P = camera.triangulation_covariance([0.4, 0.0, z], 0.7)
        assert stereo_depth.depth_sigma(z, camera, 0.7) == pytest.approx(np.sqrt(P[2, 2]), rel=1e-9)
    assert stereo_depth.depth_sigma(40.0, camera, 0.7) == pytest.approx(4 * stereo_depth.depth_sigma(20.0, camera, 0.7))


def test_dragging_the_point_shows_its_cloud_and_its_ellipse():
    panel = Panel(StereoDepthPicture())
    picture, camera = panel.picture, simulate.kitti_camera()
    spans = []
    for depth in (12.0, 24.0):
        panel.controls["depth"].value = depth
        point = np.array([panel.state["right"], 0, depth])
        P = camera.triangulation_covariance(point, 0.7)[np.ix_([2, 0], [2, 0])]
        np.testing.assert_allclose(distance2(picture.ellipse.get_xydata(), point[[2, 0]], P), RADIUS2)
        true, _ = camera.project(point)
        pixel, noise, _ = picture.images[1]
        np.testing.assert_allclose(pixel.get_xydata()[0], true[2:])
        cloud, ok = camera.triangulate(true + np.column_stack([picture.images[0][1].get_xydata(), noise.get_xydata()]))
        assert ok.all()
        np.testing.assert_allclose(picture.cloud.get_xydata(), cloud[:, [2, 0]])
        assert picture.here.get_xydata()[0] == pytest.approx([depth, np.sqrt(P[0, 0])])
        spans.append(picture.spread.get_ydata()[0])
    assert spans[1] / spans[0] == pytest.approx(4, rel=0.05)


# --- 03 ---


def test_measured_pixels_are_the_drives(drive, mapped, localised):
    for picture in (mapped, localised):
        stepper = Stepper(picture)
        for i in (0, 1, 24, 77, picture.n - 1):
            stepper.slider.value = i
            np.testing.assert_array_equal(picture.image.measured.get_xydata(), drive.observed(i // 2)[1][:, :2])


def test_map_ellipses_rest_while_predicting_and_shrink_in_the_update(mapped):
    areas, beliefs = [], []
    for i in range(mapped.n):
        mapped.draw(i)
        belief = mapped.belief(i)
        paths = mapped.map.ellipses.get_paths()
        ids = np.flatnonzero(belief.seen)
        assert len(paths) == len(ids)
        areas.append({j: polygon_area(path.vertices[:-1]) for j, path in zip(ids, paths)})
        beliefs.append(belief)
    for k in range(1, mapped.n // 2):
        assert areas[2 * k] == areas[2 * k - 1]
        innovation = mapped.steps[k].innovation
        used = set(innovation.ids[innovation.accepted])
        for j, area in areas[2 * k].items():
            assert (areas[2 * k + 1][j] < area) if j in used else (areas[2 * k + 1][j] == area)


def test_map_ellipse_is_the_95_percent_ellipse_of_its_landmark(mapped):
    mapped.draw(41)
    belief = mapped.belief(41)
    for j, path in zip(np.flatnonzero(belief.seen), mapped.map.ellipses.get_paths()):
        d2 = distance2(path.vertices[:-1], belief.landmarks[j, :2], belief.covariance[j, :2, :2])
        np.testing.assert_allclose(d2, RADIUS2)


def test_innovations_are_drawn_enlarged_around_the_measured_pixels(mapped):
    mapped.draw(40)
    innovation, enlarged = mapped.steps[20].innovation, mapped.image.enlarged
    assert len(innovation.ids) > 5
    for j, (arrow, ellipse) in enumerate(zip(mapped.image.arrows.get_segments(), mapped.image.ellipses.get_paths())):
        np.testing.assert_allclose(arrow[1], innovation.measured[j, :2])
        np.testing.assert_allclose((arrow[1] - arrow[0]) / enlarged, innovation.residual[j, :2])
        S = innovation.covariance[j, :2, :2]
        np.testing.assert_allclose(distance2((ellipse.vertices[:-1] - arrow[0]) / enlarged, 0, S), RADIUS2)


def test_update_moves_the_predictions_towards_the_measurements(mapped, localised):
    for picture in (mapped, localised):
        away = []
        for i in (50, 51):
            picture.draw(i)
            measured = picture.steps[25].innovation.measured[:, :2]
            away.append(np.linalg.norm(picture.image.predicted.get_xydata() - measured, axis=1).mean())
        assert away[1] < away[0]


def test_followed_landmark_is_shown_with_its_principal_axes(mapped):
    for i in (1, 60, 61):
        mapped.draw(i)
        values = np.linalg.eigvalsh(mapped.belief(i).covariance[mapped.landmark])[::-1]
        for line, value in zip(mapped.time.lines, values):
            assert len(line.get_ydata()) == i + 1
            assert line.get_ydata()[-1] == pytest.approx(3 * np.sqrt(value))


# --- 04 ---


def test_pose_ellipse_swells_in_the_prediction_and_shrinks_in_the_update(localised):
    stepper = Stepper(localised)
    areas = []
    for i in range(localised.n):
        stepper.slider.value = i
        areas.append(polygon_area(localised.ellipse.get_xy()))
    assert all(areas[i + 1] < areas[i] for i in range(0, localised.n, 2))
    assert all(areas[i + 1] > areas[i] for i in range(1, localised.n - 1, 2))


def test_pulls_add_up_to_the_correction(drive, localised):
    for step in localised.steps[::7]:
        pulls = localisation.pulls(step.prior, step.innovation, drive.camera, NOISE, drive.true_landmarks)
        correction = se3.log(se3.inverse(step.prior.world_T_imu) @ step.posterior.world_T_imu)
        np.testing.assert_allclose(pulls.sum(axis=0), correction, atol=1e-9)
        assert not pulls[~step.innovation.accepted].any()


def test_nis_of_a_frame_is_that_of_its_joint_gaussian(drive, localised):
    for k in (0, 13, 59):
        step = localised.steps[k]
        H = drive.camera.pose_jacobian(step.prior.world_T_imu, drive.true_landmarks[step.innovation.ids]).reshape(-1, 6)
        gaussian = multivariate_normal(cov=H @ step.prior.covariance @ H.T + NOISE.sigma_px**2 * np.eye(len(H)))
        r = step.innovation.residual.ravel()
        four = 2 * (gaussian.logpdf(0 * r) - gaussian.logpdf(r))
        rows = step.innovation.residual
        expected = four - np.sum((rows[:, 1] - rows[:, 3]) ** 2) / (2 * NOISE.sigma_px**2)  # v_left - v_right: noise
        localised.draw(2 * k + 1)
        assert localised.time.lines[0].get_ydata()[-1] * 3 * len(rows) == pytest.approx(expected, rel=1e-6)


def test_magnified_pose_shows_the_truth_relative_to_the_prediction(drive, localised):
    for i in (30, 31):
        localised.draw(i)
        step = localised.steps[15]
        offset = se3.transform(se3.inverse(step.prior.world_T_imu), drive.true_world_T_imu[15, :3, 3])
        np.testing.assert_allclose(localised.truth.get_xydata()[0], 100 * offset[:2], atol=1e-9)
    assert localised.mean.get_xydata()[0].any()


# --- 05 ---


def test_heat_map_is_the_correlation_matrix(joined):
    for i in (0, 1, 66, 67):
        joined.draw(i)
        P = joined.belief(i).covariance
        expected = [[P[a, b] / np.sqrt(P[a, a] * P[b, b]) for b in range(len(P))] for a in range(len(P))]
        np.testing.assert_allclose(joined.image.get_array(), expected, atol=1e-12)
        assert tuple(joined.image.get_extent()) == (0, len(P), len(P), 0)


def test_switch_shows_the_run_without_cross_covariances_and_what_breaks(joined):
    stepper = Stepper(joined)
    stepper.slider.value = joined.n - 1
    honest = joined.image.get_array().copy()
    stepper.controls["drop"].value = True
    blind = joined.image.get_array()
    n = len(blind) - 6
    assert np.abs(honest[:n, n:]).max() > 0.5
    assert not blind[:n, n:].any()
    # Overconfident: the error leaves its band of 3 sigma, where an honest one would be 0.3 % of the time.
    outside = [np.mean(np.abs(h.error[:, joint.AXIS]) > h.three_sigma[:, joint.AXIS]) for h in joined.histories]
    assert outside[0] < 0.02
    assert outside[1] > 0.3
    assert joined.forward.lines[0].get_ydata()[-1] == joined.histories[1].error[-1, joint.AXIS]


def test_new_and_retired_landmarks_are_marked(joined):
    for k, step in enumerate(joined.steps[:-1]):
        joined.draw(2 * k + 1)
        ids = step.posterior.ids
        marked = sorted(ids[int(segment[0, 1] // 3)] for segment in joined.marks.get_segments())
        leaving = set(joined.steps[k + 1].retired)
        assert marked == sorted(set(step.born) | leaving)
        assert len(joined.gone.get_xdata()) == len(leaving)
        assert len(joined.new.get_xdata()) == len(step.born)


def test_joint_nis_is_that_of_all_four_numbers_less_their_pure_noise(drive, joint_steps):
    sensors = window_slam.UpdateSettings(drive.camera, NOISE, RightPerturbation(), np.inf, 0.0)
    for k in (1, 30):
        step = joint_steps[k]
        prior, innovation = step.prior, step.innovation
        H = np.zeros((len(innovation.ids), 4, len(prior.covariance)))
        rows = [int(np.flatnonzero(prior.ids == j)[0]) for j in innovation.ids]
        H_landmark = drive.camera.landmark_jacobian(prior.world_T_imu, prior.landmarks)
        for j, row in enumerate(rows):
            H[j, :, 3 * row : 3 * row + 3] = H_landmark[row]
        H[:, :, prior.pose] = drive.camera.pose_jacobian(prior.world_T_imu, prior.landmarks)[rows]
        H = H.reshape(-1, len(prior.covariance))
        gaussian = multivariate_normal(cov=H @ prior.covariance @ H.T + NOISE.sigma_px**2 * np.eye(len(H)))
        r = innovation.residual
        four = 2 * (gaussian.logpdf(0 * r.ravel()) - gaussian.logpdf(r.ravel()))
        noise = np.sum((r[:, 1] - r[:, 3]) ** 2) / (2 * NOISE.sigma_px**2)
        value, numbers = joint.frame_nis(step, sensors)
        assert (value, numbers) == (pytest.approx(four - noise, rel=1e-6), 3 * len(r))


@pytest.mark.parametrize("error_state", [RightPerturbation(), RightInvariant()])
def test_world_covariance_of_the_landmarks_against_central_differences(drive, error_state):
    belief = list(window_slam.run(drive.slice(0, 20), NOISE, error_state))[-1].posterior

    def landmarks(delta):
        return error_state.retract(belief.world_T_imu, belief.landmarks, delta)[1].ravel()

    J = central_difference(landmarks, len(belief.covariance))
    full = J @ belief.covariance @ J.T
    expected = [full[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] for j in range(len(belief.ids))]
    np.testing.assert_allclose(pipeline.world_landmark_covariance(belief, error_state), expected, rtol=1e-6, atol=1e-9)


def test_joint_pose_is_less_certain_after_prediction_than_after_update(joined):
    sigma = joined.histories[0].three_sigma[:, joint.AXIS]
    assert (sigma[1::2] <= sigma[::2]).all()
    assert (sigma[2::2] > sigma[1:-1:2]).all()


def test_runs_of_different_length_are_refused(drive, joint_steps):
    with pytest.raises(ValueError, match="59 steps, expected 60"):
        JointPicture(joint_steps, drive, NOISE, without=joint_steps[:-1])


def test_pictures_do_without_the_truth(drive, joint_steps):
    bare = dataclasses.replace(drive, truth_world_T_cam=None, truth_landmarks=None)
    T = drive.true_world_T_imu
    for picture in (
        JointPicture(joint_steps[:4], bare, NOISE),
        MappingPicture(mapping.run(bare, NOISE, T), bare, T),
        LocalisationPicture(odometry.localize(bare, NOISE, drive.true_landmarks), bare, NOISE, drive.true_landmarks),
    ):
        assert picture.still(i=3).png[:4] == b"\x89PNG"
