"""The stereo camera: projection against the pinhole by hand, inverses, central differences, Monte Carlo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numerical import central_difference
from numpy.testing import assert_allclose
from scipy.stats import chi2

from vislam_edu import se3, simulate, stereo

K = np.array([[552.5, 0.0, 682.0], [0.0, 548.0, 238.5], [0.0, 0.0, 1.0]])  # f_u and f_v differ on purpose
BASELINE = 0.6
CAM_R_IMU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # body to left optical axes
CAM_T_IMU = se3.exp([0.0, 0.0, 0.0, 0.02, -0.03, 0.01]) @ se3.pose(CAM_R_IMU, [0.1, -0.6, -1.5])
CAMERA = stereo.StereoCamera(K, BASELINE, CAM_T_IMU)

seeds = st.integers(0, 2**32 - 1)
batch_shapes = st.sampled_from([(), (1,), (5,), (2, 3), (0,)])


def points_in_view(rng, shape=(), depths=(1.0, 80.0)):
    """Points (..., 3), m, camera frame, within 45 degrees of the optical axis."""
    depth = rng.uniform(*depths, shape)
    rays = np.concatenate([rng.uniform(-1, 1, shape + (2,)), np.ones(shape + (1,))], axis=-1)
    return depth[..., None] * rays


def scene(seed, shape=()):
    """A pose in general position and landmarks in front of its camera: (4, 4) and (..., 3)."""
    rng = np.random.default_rng(seed)
    world_T_imu = se3.exp(np.concatenate([rng.uniform(-50, 50, 3), rng.uniform(-1.7, 1.7, 3)]))
    return world_T_imu, CAMERA.to_world(world_T_imu, points_in_view(rng, shape))


def assert_jacobian(analytic, numerical, relative=1e-7):
    """Within `relative` of the largest entry of each matrix."""
    assert analytic.shape == numerical.shape
    scale = np.abs(numerical).max(axis=(-2, -1), initial=0.0, keepdims=True)
    assert (np.abs(analytic - numerical) <= relative * scale).all()


# The model


def test_projection_by_hand():
    """f x / z + c, each camera by itself: the right one sees x - baseline."""
    x, y, z = 2.0, -1.0, 10.0
    pixels, in_front = CAMERA.project([x, y, z])
    u = lambda x: 552.5 * x / z + 682.0  # noqa: E731
    v = 548.0 * y / z + 238.5
    assert_allclose(pixels, [u(x), v, u(x - BASELINE), v], rtol=1e-15)
    assert in_front


def test_observation_goes_through_imu_and_camera():
    """A landmark straight ahead of the car is on the optical axis, one to the left is left in the image."""
    camera = stereo.StereoCamera(K, BASELINE, se3.pose(CAM_R_IMU, np.zeros(3)))
    world_T_imu = se3.pose(np.eye(3), [5.0, 0.0, 0.0])
    ahead, left, above, behind = [15.0, 0, 0], [15.0, 1, 0], [15.0, 0, 1], [4.0, 0, 0]
    pixels, in_front = camera.observe(world_T_imu, [ahead, left, above, behind])
    assert_allclose(pixels[0, :2], [682.0, 238.5])
    assert pixels[1, 0] < 682.0
    assert pixels[2, 1] < 238.5
    assert in_front.tolist() == [True, True, True, False]


@given(seeds, batch_shapes)
def test_frames_round_trip(seed, shape):
    world_T_imu, landmarks = scene(seed, shape)
    points = CAMERA.to_cam(world_T_imu, landmarks)
    assert points.shape == shape + (3,)
    assert_allclose(CAMERA.to_world(world_T_imu, points), landmarks, rtol=0, atol=1e-11)
    by_hand = landmarks @ np.linalg.inv(world_T_imu)[:3, :3].T + np.linalg.inv(world_T_imu)[:3, 3]
    assert_allclose(points, by_hand @ CAM_T_IMU[:3, :3].T + CAM_T_IMU[:3, 3], rtol=0, atol=1e-11)


# Jacobians


@given(seeds, batch_shapes)
def test_dpi_dq_against_central_differences(seed, shape):
    rng = np.random.default_rng(seed)
    q = np.concatenate([points_in_view(rng, shape), rng.uniform(0.5, 2.0, shape + (1,))], axis=-1)
    assert_jacobian(stereo.dpi_dq(q), central_difference(lambda d: stereo.pi(q + d), 4, 1e-3))


@given(seeds, batch_shapes)
def test_projection_jacobians_against_central_differences(seed, shape):
    points = points_in_view(np.random.default_rng(seed), shape)
    q = np.concatenate([points, np.ones(shape + (1,))], axis=-1)
    numerical = central_difference(lambda d: np.matvec(CAMERA.K_s, stereo.pi(q + d)), 4, 1e-3)
    assert_jacobian(CAMERA.projection_jacobian(points), numerical)
    s = se3.transform(CAMERA.imu_T_cam, points)
    numerical = central_difference(lambda d: CAMERA.project(se3.transform(CAM_T_IMU, s + d))[0], 3, 1e-3)
    assert_jacobian(CAMERA.measurement_jacobian(points), numerical)


@given(seeds, batch_shapes)
def test_landmark_jacobian_against_central_differences(seed, shape):
    T, m = scene(seed, shape)
    numerical = central_difference(lambda d: CAMERA.observe(T, m + d)[0], 3, 1e-3)
    assert_jacobian(CAMERA.landmark_jacobian(T, m), numerical)


@given(seeds, batch_shapes)
def test_pose_jacobian_against_central_differences(seed, shape):
    T, m = scene(seed, shape)
    numerical = central_difference(lambda eps: CAMERA.observe(T @ se3.exp(eps), m)[0], 6, 1e-3 / 80)
    assert_jacobian(CAMERA.pose_jacobian(T, m), numerical)


@given(seeds)
def test_jacobians_share_the_one_of_the_imu_frame(seed):
    """J R^T for the landmark, -J [I, -s^] for the pose: what the filters build theirs from."""
    T, m = scene(seed, (4,))
    J = CAMERA.measurement_jacobian(CAMERA.to_cam(T, m))
    s = se3.transform(se3.inverse(T), m)
    assert_allclose(CAMERA.landmark_jacobian(T, m), J @ T[:3, :3].T, rtol=1e-10, atol=1e-9)
    assert_allclose(CAMERA.pose_jacobian(T, m), -J @ se3.odot(s)[..., :3, :], rtol=1e-10, atol=1e-9)


# Triangulation


@given(seeds, batch_shapes)
def test_triangulation_inverts_projection(seed, shape):
    points = points_in_view(np.random.default_rng(seed), shape)
    pixels, in_front = CAMERA.project(points)
    back, ok = CAMERA.triangulate(pixels)
    assert in_front.all()
    assert ok.all()
    assert ok.shape == shape
    assert_allclose(back, points, rtol=1e-9, atol=1e-9)


@given(seeds, batch_shapes)
def test_bearings_in_general_position_meet_in_the_point(seed, shape):
    """Two cameras anywhere, as long as both see the point; the bearings are those of their own frames."""
    rng = np.random.default_rng(seed)
    point = points_in_view(rng, shape, depths=(3.0, 30.0))
    cam1_R_cam2 = se3.so3_exp(rng.uniform(-0.3, 0.3, shape + (3,)))
    cam1_p_cam2 = [2.0, 0.0, 0.0] + rng.uniform(-1, 1, shape + (3,))
    in_2 = se3.transform(se3.inverse(se3.pose(cam1_R_cam2, cam1_p_cam2)), point)
    z1, z2 = point / point[..., 2:], in_2 / in_2[..., 2:]
    found, ok = stereo.triangulate_bearings(z1, z2, cam1_R_cam2, cam1_p_cam2)
    seen = in_2[..., 2] > 1e-3
    apart = np.linalg.norm(np.cross(z1, cam1_p_cam2), axis=-1) > 0.1  # m, of camera 2 from the first bearing
    assert np.array_equal(ok[apart], seen[apart])
    assert_allclose(found[seen & apart], point[seen & apart], rtol=1e-8, atol=1e-8)


def rectified_bearings(pixels):
    z1, z2 = stereo.bearing(K, pixels[..., :2]), stereo.bearing(K, pixels[..., 2:])
    return stereo.triangulate_bearings(z1, z2, np.eye(3), [BASELINE, 0.0, 0.0])


@given(seeds, batch_shapes)
def test_closed_form_is_the_disparity_form_where_the_rows_agree(seed, shape):
    """Noise in u does not part them, as long as v_left == v_right."""
    rng = np.random.default_rng(seed)
    pixels = CAMERA.project(points_in_view(rng, shape))[0] + rng.normal(size=shape + (4,))
    pixels[..., 3] = pixels[..., 1]
    (by_bearings, ok1), (by_disparity, ok2) = rectified_bearings(pixels), CAMERA.triangulate(pixels)
    assert np.array_equal(ok1, ok2)
    assert_allclose(by_bearings, by_disparity, rtol=1e-9, atol=1e-9)


@given(seeds)
def test_closed_form_shortens_the_depth_where_the_rows_differ(seed):
    """By 1 / (1 + (dv/du)^2), as its docstring says; and the point stays on the left bearing."""
    rng = np.random.default_rng(seed)
    pixels = CAMERA.project(points_in_view(rng, (5,)))[0]
    pixels[:, 3] += rng.uniform(0.5, 3.0, 5)
    (by_bearings, ok), (by_disparity, _) = rectified_bearings(pixels), CAMERA.triangulate(pixels)
    du = (pixels[:, 0] - pixels[:, 2]) / K[0, 0]
    dv = (pixels[:, 1] - pixels[:, 3]) / K[1, 1]
    assert ok.all()
    assert_allclose(by_bearings[:, 2], by_disparity[:, 2] / (1.0 + (dv / du) ** 2), rtol=1e-9)
    assert_allclose(by_bearings / by_bearings[:, 2:], stereo.bearing(K, pixels[:, :2]), rtol=1e-12)


def test_bearing_is_the_inverse_of_the_calibration():
    assert_allclose(stereo.bearing(K, [682.0 + 552.5, 238.5 - 548.0]), [1.0, -1.0, 1.0], rtol=1e-14)


# Covariance of a triangulated point


@given(seeds)
def test_covariance_is_the_one_propagated_through_triangulate(seed):
    """(H^T V^-1 H)^-1 equals G V G^T, G the numerical derivative of `triangulate`: it is efficient."""
    point = points_in_view(np.random.default_rng(seed))
    pixels = CAMERA.project(point)[0]
    G = central_difference(lambda d: CAMERA.triangulate(pixels + d)[0], 4, 1e-3)
    assert_jacobian(CAMERA.triangulation_covariance(point, 0.7), 0.7**2 * G @ G.T, relative=1e-6)


def test_covariance_holds_in_monte_carlo():
    """At 15 m with 0.1 px the model is linear enough; errors must be chi-square with 3 degrees of freedom.

    The sum of n squared Mahalanobis distances is chi-square with 3n degrees of freedom: its 99.99 % band.
    """
    n, sigma = 40_000, 0.1
    rng = np.random.default_rng(20)
    point = np.array([4.0, -2.0, 15.0])
    measured = CAMERA.project(point)[0] + sigma * rng.normal(size=(n, 4))
    found, ok = CAMERA.triangulate(measured)
    assert ok.all()
    error = found - point
    covariance = CAMERA.triangulation_covariance(point, sigma)
    squared = np.sum(error * np.linalg.solve(covariance, error.T).T, axis=-1)
    low, high = chi2.ppf([0.5e-4, 1 - 0.5e-4], 3 * n) / n
    assert low < squared.mean() < high
    inside = np.mean(squared < chi2.ppf(0.95, 3))
    assert abs(inside - 0.95) < 3.9 * np.sqrt(0.95 * 0.05 / n)  # 99.99 % of the binomial


def test_depth_variance_grows_with_the_fourth_power_of_depth():
    near, far = CAMERA.triangulation_covariance([[0.0, 0.0, 10.0], [0.0, 0.0, 20.0]], 1.0)[:, 2, 2]
    assert_allclose(far / near, 16.0, rtol=1e-9)
    assert_allclose(near, 2.0 * (10.0**2 / (552.5 * BASELINE)) ** 2, rtol=1e-9)  # (sqrt(2) px z^2 / (f b))^2


# What cannot be seen

BEHIND = [[0, 0, 0], [1, 2, 0], [1, 2, -5], [1, 2, 1e-300]]
NOT_FINITE = [[np.nan, 0, 5], [0, 0, np.nan], [np.inf, 0, 5], [0, 0, np.inf]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("point", BEHIND + NOT_FINITE, ids=str)
def test_points_not_in_front_are_masked_and_finite(point):
    batch = np.array([point, [1.0, 2.0, 10.0]], dtype=float)
    pixels, in_front = CAMERA.project(batch)
    assert in_front.tolist() == [False, True]
    assert np.isfinite(pixels).all()
    assert_allclose(pixels[1], CAMERA.project(batch[1])[0], rtol=0, atol=0)
    for jacobian in (CAMERA.projection_jacobian, CAMERA.measurement_jacobian):
        assert np.isfinite(jacobian(batch)).all()
        assert_allclose(jacobian(batch)[1], jacobian(batch[1]), rtol=1e-15)
    assert np.isfinite(CAMERA.triangulation_covariance(batch, 1.0)).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "pixels",
    [[300, 9, 300, 9], [300, 9, 310, 9], [1e-310, 0, 0, 0], [np.nan] * 4, [300, np.nan, 290, 9]],
    ids=str,
)
def test_disparities_that_are_not_positive_are_masked_and_finite(pixels):
    batch = np.array([pixels, [310.0, 100.0, 300.0, 100.0]], dtype=float)
    for points, ok in (CAMERA.triangulate(batch), rectified_bearings(batch)):
        assert ok.tolist() == [False, True]
        assert np.array_equal(points[0], stereo.PLACEHOLDER)
        assert_allclose(points[1, 2], 552.5 * BASELINE / 10.0, rtol=1e-12)


def test_min_disparity_is_a_strict_bound():
    pixels = np.array([[301.0, 100, 300, 100], [301.5, 100, 300, 100]])
    assert CAMERA.triangulate(pixels, min_disparity=1.0)[1].tolist() == [False, True]
    assert CAMERA.triangulate(pixels)[1].tolist() == [True, True]


def test_bearings_that_meet_behind_a_camera_are_masked():
    """Parallel; diverging (behind both); and in front of camera 1 but behind camera 2, which looks back."""
    p, back = np.array([1.0, 0.0, 0.0]), np.diag([-1.0, 1.0, -1.0])
    z = np.array([0.0, 0.0, 1.0])
    assert not stereo.triangulate_bearings(z, z, np.eye(3), p)[1]
    assert not stereo.triangulate_bearings(z, [0.2, 0.0, 1.0], np.eye(3), p)[1]
    assert not stereo.triangulate_bearings(z, [-0.2, 0.0, 1.0], back, p)[1]
    points, ok = stereo.triangulate_bearings(z, [-0.2, 0.0, 1.0], np.eye(3), p)
    assert ok
    assert_allclose(points, [0.0, 0.0, 5.0], rtol=1e-14)


# A camera that is wrong


def test_camera_is_frozen_and_keeps_its_own_arrays():
    mine = K.copy()
    camera = stereo.StereoCamera(mine, BASELINE, CAM_T_IMU)
    mine[0, 0] = 1.0
    assert camera.K[0, 0] == 552.5
    for array in (camera.K, camera.cam_T_imu, camera.imu_T_cam, camera.K_s, stereo.PLACEHOLDER):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        camera.baseline = 1.0
    assert_allclose(camera.imu_T_cam @ camera.cam_T_imu, np.eye(4), rtol=0, atol=1e-14)


def altered(matrix, index, value):
    matrix = np.array(matrix)
    matrix[index] = value
    return matrix


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("K", np.eye(4), r"K must have shape \(3, 3\), got \(4, 4\)"),
        ("K", altered(K, (0, 0), -552.5), "K must be .* positive focal lengths"),
        ("K", altered(K, (0, 1), 0.5), "K must be"),
        ("K", K.T, "K must be"),
        ("K", altered(K, (1, 2), np.nan), "K must be"),
        ("K", "K.txt", "K must be an array of numbers"),
        ("baseline", 0.0, "baseline must be one positive length"),
        ("baseline", -0.6, "baseline must be one positive length"),
        ("baseline", np.nan, "baseline must be one positive length"),
        ("baseline", [0.6, 0.6], "baseline must be one positive length"),
        ("cam_T_imu", np.eye(3), r"cam_T_imu must have shape \(4, 4\), got \(3, 3\)"),
        ("cam_T_imu", CAM_T_IMU.T, "cam_T_imu must end with the row .* transposed"),
        ("cam_T_imu", altered(CAM_T_IMU, (0, 3), np.inf), "cam_T_imu must be finite"),
        ("cam_T_imu", altered(CAM_T_IMU, (0, 0), 0.5), "cam_T_imu must hold a rotation; it is off"),
        ("cam_T_imu", np.diag([1.0, -1.0, 1.0, 1.0]), "cam_T_imu must hold a rotation, but mirrors"),
    ],
)
def test_a_wrong_camera_is_named(field, value, says):
    fields = {"K": K, "baseline": BASELINE, "cam_T_imu": CAM_T_IMU} | {field: value}
    with pytest.raises(ValueError, match=says):
        stereo.StereoCamera(**fields)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: CAMERA.project(np.zeros((3, 4))), r"\(\.\.\., 3\), got \(3, 4\)"),
        (lambda: CAMERA.triangulate(np.zeros((4, 3))), r"pixels must have shape \(\.\.\., 4\), got \(4, 3\)"),
        (lambda: CAMERA.observe(np.eye(3), np.zeros(3)), r"\(\.\.\., 4, 4\), got \(3, 3\)"),
        (lambda: CAMERA.to_world(np.eye(3), np.zeros(3)), r"world_T_imu must have .* got \(3, 3\)"),
        (lambda: stereo.bearing(K, np.zeros(3)), r"uv must have shape \(\.\.\., 2\), got \(3,\)"),
        (lambda: stereo.pi(np.zeros(3)), r"q must have shape \(\.\.\., 4\), got \(3,\)"),
        (lambda: stereo.triangulate_bearings([0, 0], [0, 0, 1], np.eye(3), np.ones(3)), "z1 must have shape"),
        (lambda: CAMERA.triangulation_covariance([0, 0, 5.0], 0.0), "sigma_px must be positive, got 0.0"),
    ],
)
def test_wrong_arguments_are_named(call, says):
    with pytest.raises(ValueError, match=says):
        call()


def test_a_batch_of_poses_is_a_loop():
    poses, landmarks = zip(*(scene(seed) for seed in range(4)), strict=True)
    poses, landmarks = np.array(poses), np.array(landmarks)
    for method in (CAMERA.landmark_jacobian, CAMERA.pose_jacobian, CAMERA.to_cam, CAMERA.to_world):
        looped = [method(T, m) for T, m in zip(poses, landmarks, strict=True)]
        assert_allclose(method(poses, landmarks), looped, rtol=1e-12, atol=1e-9)


def test_second_order_is_half_the_trace_of_the_second_derivative_times_the_covariance():
    camera, rng = simulate.kitti_camera(), np.random.default_rng(4)
    for point in ([3.0, -1.0, 20.0], [-8.0, 0.5, 9.0], [0.2, 1.0, 60.0]):
        A = rng.normal(size=(3, 3)) * [[0.1], [0.1], [0.5]]
        C, step = A @ A.T, 1e-2
        expected = np.zeros(4)
        for i in range(3):
            for j in range(3):
                e, d = step * np.eye(3)[i], step * np.eye(3)[j]
                corners = camera.project(np.array(point) + [e + d, e - d, -e + d, -e - d])[0]
                expected += C[i, j] / 2 * (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * step**2)
        J = camera.projection_jacobian(np.array(point))[stereo.ROWS, :3]
        found = stereo.second_order(camera.project(point)[0], J @ C @ J.T)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-7)
