"""What the pictures show, read back from their artists."""

import numpy as np
import picture_checks
import pytest
from matplotlib.path import Path
from scipy.stats import chi2

from vislam_edu import kalman, se3, simulate
from vislam_edu.course.ch01 import panel as twist
from vislam_edu.course.ch01.panel import TwistPicture
from vislam_edu.course.ch02 import panel as stereo_depth
from vislam_edu.course.ch02.panel import StereoDepthPicture
from vislam_edu.course.ch03 import panel as two_gaussians
from vislam_edu.course.ch03.panel import ON_RAY, PRIOR, RayPicture, TwoGaussiansPicture, ray_update
from vislam_edu.course.ch05 import panel as chapter05
from vislam_edu.widgets import Panel

RADIUS2 = chi2.ppf(0.95, 2)


@pytest.fixture(scope="module")
def pictures():
    """Every picture with the states in which it is looked at."""
    panels = []
    for picture in (TwistPicture(), StereoDepthPicture(), TwoGaussiansPicture(), RayPicture()):
        start = {name: control.value for name, control in picture.controls.items()}
        ends = [
            {**start, name: getattr(control, end)}
            for name, control in picture.controls.items()
            for end in ("low", "high")
        ]
        panels.append((picture, [start, *ends]))
    return panels


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
        near, far = np.sort(cloud[:, 2])[[79, 420]]  # 68 % of 500 draws lie between them
        assert spans[-1] == pytest.approx((far - near) / 2, rel=0.02)
    assert spans[1] / spans[0] == pytest.approx(4, rel=0.05)
    panel.controls["depth"].value, panel.controls["sigma_px"].value = 60.0, 1.5
    assert all(line.get_ydata()[0] < picture.law.get_ylim()[1] for line in (picture.spread, picture.here))


# --- 03 ---


@pytest.mark.parametrize(("measured", "sigma_predicted", "sigma_measured"), [(33.0, 2.0, 1.0), (27.5, 0.4, 3.0)])
def test_two_gaussians_make_the_kalman_update_and_their_product(measured, sigma_predicted, sigma_measured):
    gain, mean, sigma = two_gaussians.combine(measured, sigma_predicted, sigma_measured)
    delta, P = kalman.update(np.array([[sigma_predicted**2]]), np.eye(1), np.array([[sigma_measured**2]]),
                             np.array([measured - 30.0]))
    assert (mean - 30, sigma**2) == pytest.approx((delta[0], P[0, 0]))
    assert gain == pytest.approx(delta[0] / (measured - 30))
    picture = TwoGaussiansPicture()
    picture.png(measured=measured, sigma_predicted=sigma_predicted, sigma_measured=sigma_measured)
    predicted, seen, both = (picture.lines[name].get_ydata() for name in ("predicted", "measured", "both"))
    product = predicted * seen / np.trapezoid(predicted * seen, picture.x)
    np.testing.assert_allclose(both, product, atol=2e-3 * both.max())
    assert picture.bars["both"].get_xdata()[1] == pytest.approx(picture.bars["measured"].get_xdata()[1])


@pytest.mark.parametrize(("bearing", "sigma"), [(20.0, 0.3), (-70.0, 1.5)])
def test_a_ray_adds_information_across_itself_only(bearing, sigma):
    gain, mean, covariance = ray_update(bearing, sigma)
    across = np.array([-np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
    information = np.linalg.inv(PRIOR) + np.outer(across, across) / sigma**2
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=1e-9)
    np.testing.assert_allclose(mean, gain * (across @ ON_RAY), rtol=1e-9)


def test_two_numbers_birth_is_the_first_look_and_dropping_the_covariance_is_an_echo():
    birth, looked, driven, after = chapter05.two_numbers(99, drop=False)
    apart = [P[0, 0] + P[1, 1] - 2 * P[0, 1] for P in (birth, looked, driven, after)]
    np.testing.assert_allclose(apart, [0.01, 1e-4, 4 + 1e-4, 0.01], rtol=3e-3)
    np.testing.assert_allclose([P[1, 1] for P in (birth, looked, driven, after)], [1, 1, 5, 1], rtol=2e-2)
    echo = chapter05.two_numbers(99, drop=True)
    assert np.sqrt(echo[1][1, 1]) < 0.02  # though nothing measured where the car is
    assert all(P[0, 1] == 0 for P in echo)


@pytest.mark.parametrize("check", picture_checks.ALL, ids=lambda check: check.__name__)
def test_picture_of_two_numbers_stands_what_every_picture_must(check):
    picture = chapter05.TwoNumbersPicture()
    check(picture, [{"after": step, "looks": looks} for looks in (1, 5, 99) for step in chapter05.STEPS[1:]])


def test_the_looks_of_the_second_step_change_nothing_at_the_birth():
    picture = chapter05.TwoNumbersPicture()
    assert picture.png(after=chapter05.STEPS[0], looks=1) == picture.png(after=chapter05.STEPS[0], looks=99)
