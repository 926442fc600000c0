"""Exercises of notebook 02: from pixels back to points, and how uncertain they are."""

import numpy as np

from ... import se3, stereo
from ...stereo import StereoCamera
from ..checks.exercise import exercise
from ..checks.inputs import BASELINE, K, random_calibration, random_camera, random_points_cam


def pixels_of_one_camera(rng):
    yield "principal point", (K.copy(), np.array([600.0, 180.0]))
    yield "upper left corner", (K.copy(), np.zeros(2))
    for _ in range(5):
        yield "random", (random_calibration(rng), rng.uniform(0, 400, size=2))


@exercise(chapter=2, cases=pixels_of_one_camera, shows=[stereo.bearing], hints=[
    "K takes a bearing to a pixel: K z = [u, v, 1]. You want the way back.",
    "np.linalg.solve(K, [u, v, 1])"])
def bearing(K, uv):
    """Bearing of a pixel: the direction to what it shows, scaled to depth one.

    K : (3, 3), px, calibration [[f_u, 0, c_u], [0, f_v, c_v], [0, 0, 1]]. uv : (2,), px.
    Returns (3,), in the camera frame, its third entry 1.
    """
    x = (uv[0] - K[0, 2]) / K[0, 0]
    y = (uv[1] - K[1, 2]) / K[1, 1]
    return np.array([x, y, 1.0])


bearing.slip("pixels used as bearings", """[u, v, 1] is a pixel, not a direction: it has to go through K^-1. The
    report's section 3.2.1 makes this slip.""", ("[x, y, 1.0]", "[uv[0], uv[1], 1.0]"))
bearing.slip("K instead of its inverse", "K takes bearings to pixels. Here it is the other way: K^-1.",
    ("np.array([x, y, 1.0])", "K @ [uv[0], uv[1], 1.0]"))
bearing.slip("focal length forgotten", """Subtracting the principal point gives pixels from the centre; dividing by f_u
    and f_v turns them into a direction.""", (" / K[0, 0]", ""), (" / K[1, 1]", ""))
bearing.slip("scaled to length one", """A bearing here has depth one (third entry 1), so that depth times bearing is the
    point. Leave out the normalisation.""",
    ("np.array([x, y, 1.0])", "np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])"))
bearing.slip("one focal length for both axes", "u goes with f_u = K[0, 0], v with f_v = K[1, 1].",
    ("K[1, 1]", "K[0, 0]"))


def two_views(rng):
    for label, R, p in [("rectified pair", np.eye(3), np.array([BASELINE, 0.0, 0.0])),
                        *(("random", se3.so3_exp(0.2 * rng.normal(size=3)),
                           np.array([1.0, 0.3, 0.0]) + 0.2 * rng.normal(size=3)) for _ in range(6))]:
        point, K = random_points_cam(rng, 1)[0], random_calibration(rng)
        seen = [K @ q / q[2] for q in (point, R.T @ (point - p))]
        yield label, (K, seen[0][:2], seen[1][:2], R, p)


@exercise(chapter=2, cases=two_views, shows=[stereo.triangulate_bearings, stereo.bearing], hints=[
    "Turn both pixels into bearings first. The point is l1 z1 in camera 1 and l2 z2 in camera 2.",
    "l1 R^T z1 - R^T p = l2 z2. Its third row gives l2; put that into the others: l1 a = b with "
    "a = R^T z1 - (R^T z1)_3 z2 and b = R^T p - (R^T p)_3 z2, so l1 = a.b / a.a."])
def triangulate_bearings(K, uv1, uv2, R, p):
    """Point that two cameras see; the pixels are exact.

    K : (3, 3), px, of both cameras. uv1, uv2 : (2,), px, in camera 1 and camera 2. R, p : (3, 3) and (3,) m,
    the pose of camera 2 in camera 1. Returns (3,), m, in the frame of camera 1. You may use `stereo.bearing`.
    """
    z1 = stereo.bearing(K, uv1)
    z2 = stereo.bearing(K, uv2)
    a = R.T @ z1
    b = R.T @ p
    a = a - a[2] * z2
    b = b - b[2] * z2
    depth = (a @ b) / (a @ a)
    return depth * z1


@triangulate_bearings.otherwise
def _(K, uv1, uv2, R, p):
    z1 = stereo.bearing(K, uv1)
    z2 = stereo.bearing(K, uv2)
    A = np.column_stack([z1, -R @ z2])
    depths = np.linalg.inv(A.T @ A) @ A.T @ p
    return depths[0] * z1


triangulate_bearings.slip("pixels used as bearings", """The equations hold for bearings K^-1 [u, v, 1], not for [u, v,
    1] itself. The report's section 3.2.1 makes this slip.""", ("stereo.bearing(K, uv1)", "np.append(uv1, 1.0)"),
    ("stereo.bearing(K, uv2)", "np.append(uv2, 1.0)"))
triangulate_bearings.slip("R in place of its transpose", """R and p are the pose of camera 2 in camera 1. Into camera 2
    go R^T (m - p): the transpose.""", ("R.T @ z1", "R @ z1"), ("R.T @ p", "R @ p"))
triangulate_bearings.slip("baseline of the wrong sign", """p points from camera 1 to camera 2. With the other sign the
    point comes out behind the cameras.""", ("R.T @ p", "-R.T @ p"))
triangulate_bearings.slip("expressed in camera 2", """This is the point in the frame of camera 2. Its depth along the
    first bearing, times that bearing, tells it in camera 1.""", ("depth * z1", "R.T @ (depth * z1 - p)"))
triangulate_bearings.slip("first depth on the second bearing", """l1 is the depth along z1. Times z2 it is no point that
    anyone sees.""", ("* z1", "* z2"))
triangulate_bearings.slip("depth taken for the distance", """The depth multiplies the bearing z1, whose third entry is
    1, not the unit vector along it.""", ("return depth * z1", "return depth * z1 / np.linalg.norm(z1)"))


def stereo_pixels(rng):
    for _ in range(2):
        camera = random_camera(rng)
        yield "random", (camera.K.copy(), camera.baseline, camera.project(random_points_cam(rng, 4))[0])
    for _ in range(4):
        camera = random_camera(rng)
        pixels = camera.project(random_points_cam(rng, 6))[0]
        pixels[[1, 3, 4], 2] = pixels[[1, 3, 4], 0] - [0.0, 0.2, -3.0]
        yield "a zero and a negative disparity", (camera.K.copy(), camera.baseline, pixels)


def _good_points_only(results):
    points, ok = results
    return [np.where(ok[:, None] != 0, points, 0.0), ok]


@exercise(chapter=2, cases=stereo_pixels, shows=[StereoCamera.triangulate, stereo.bearing],
          outputs=("points", "ok"), canonical=_good_points_only, hints=[
    "The disparity is d = u_left - u_right. Similar triangles give the depth; the depth times the bearing the point.",
    "depth = f_u baseline / d where d > 0, which is also the mask; np.where(ok, d, 1) keeps the division quiet."])
def triangulate(K, baseline, pixels):
    """Points of rectified stereo measurements, and which of them are points at all.

    K : (3, 3), px. baseline : m. pixels : (n, 4), [u_left, v_left, u_right, v_right], px, v_left = v_right.
    Returns points (n, 3), m, in the left camera, and ok (n,), False where the disparity is zero or negative;
    what points holds there does not matter.
    """
    u_left, v_left, u_right, _v_right = pixels.T
    d = u_left - u_right
    ok = d > 0
    z = K[0, 0] * baseline / d
    x = z * (u_left - K[0, 2]) / K[0, 0]
    y = z * (v_left - K[1, 2]) / K[1, 1]
    return np.column_stack([x, y, z]), ok


triangulate.slip("disparity at or below zero triangulated", """Noise can bring the disparity of a far point to zero or
    below. Its depth would be infinite or behind the camera: ok must be False there.""",
    ("d > 0", "np.full(len(d), True)"))
triangulate.slip("zero disparity let through", "A disparity of exactly zero is infinitely far: d > 0, not d >= 0.",
    ("d > 0", "d >= 0"))
triangulate.slip("negative disparity let through", """Where u_right lies to the right of u_left the point comes out
    behind the camera: d > 0, not d != 0.""", ("d > 0", "d != 0"))
triangulate.slip("absolute disparity", """A negative disparity is a wrong measurement; its absolute value makes it look
    like a good one.""", ("u_left - u_right", "np.abs(u_left - u_right)"))
triangulate.slip("disparity of the wrong sign", """Seen from the right camera everything moves left: d = u_left -
    u_right.""", ("u_left - u_right", "u_right - u_left"))
triangulate.slip("pixels used as bearings", "Depth times [u, v, 1] is no point: use the bearing K^-1 [u, v, 1].",
    ("(u_left - K[0, 2]) / K[0, 0]", "u_left"), ("(v_left - K[1, 2]) / K[1, 1]", "v_left"))
triangulate.slip("baseline forgotten", "f_u / d has no unit; times the baseline it is a depth in metres.",
    ("K[0, 0] * baseline / d", "K[0, 0] / d"))
triangulate.slip("principal point forgotten", "u is counted from the corner of the image; the axis is at c_u, c_v.",
    ("(u_left - K[0, 2])", "u_left"), ("(v_left - K[1, 2])", "v_left"))
triangulate.slip("mask the other way round", "ok says which measurements are points: True where d > 0.",
    ("d > 0", "d <= 0"))
triangulate.slip("axes of the body", "The points are asked for in the left camera: x right, y down, z forward.",
    ("[x, y, z]", "[z, -x, -y]"))


def points_and_sigma(rng):
    yield "10 m ahead", (K.copy(), BASELINE, np.array([0.0, 0.0, 10.0]), 1.0)
    for _ in range(5):
        yield "random", (random_calibration(rng), rng.uniform(0.3, 0.8), random_points_cam(rng, 1)[0],
                         rng.uniform(0.4, 3.0))


@exercise(chapter=2, cases=points_and_sigma, hints=[
    "Four measurements of equal noise, three unknowns: least squares. H: the derivative of the pixels by x, y, z.",
    "(H^T V^-1 H)^-1 with V = sigma_px^2 I; H is the first three columns of K_s dpi/dq."],
    shows=[StereoCamera.triangulation_covariance, StereoCamera.projection_jacobian, stereo.dpi_dq])
def triangulation_covariance(K, baseline, point, sigma_px):
    """Covariance of a point triangulated from one stereo measurement, to first order.

    K : (3, 3), px. baseline : m. point : (3,), m, in the left camera. sigma_px : px, of each of the four numbers
    [u_left, v_left, u_right, v_right]. Returns (3, 3), m^2, in the left camera: (H^T V^-1 H)^-1.
    """
    x, y, z = point
    f_u, f_v = K[0, 0], K[1, 1]
    H = np.array([[f_u / z, 0, -f_u * x / z**2],
                  [0, f_v / z, -f_v * y / z**2],
                  [f_u / z, 0, -f_u * (x - baseline) / z**2],
                  [0, f_v / z, -f_v * y / z**2]])
    return sigma_px**2 * np.linalg.inv(H.T @ H)


triangulation_covariance.slip("sigma not squared", "V holds variances: sigma_px squared.", ("sigma_px**2", "sigma_px"))
triangulation_covariance.slip("information, not covariance", "H^T V^-1 H is the information matrix; invert it.",
    ("sigma_px**2 * np.linalg.inv(H.T @ H)", "H.T @ H / sigma_px**2"))
triangulation_covariance.slip("depth variance only", """d z / d disparity gives the variance along the axis alone; x and
    y move with the depth, and carry noise of their own.""",
    ("sigma_px**2 * np.linalg.inv(H.T @ H)", "np.diag([0, 0, 2 * (sigma_px * z**2 / (f_u * baseline))**2])"))
triangulation_covariance.slip("v_right left out", """All four numbers carry noise. With two measurements of v, y is
    known better than with one.""", ("H.T @ H", "H[:3].T @ H[:3]"))
triangulation_covariance.slip("propagated through H", """H V H^T takes a covariance of a point to pixels. The way back
    is (H^T V^-1 H)^-1.""", ("np.linalg.inv(H.T @ H)", "H.T @ H"))
triangulation_covariance.slip("third column divided once", "d (x / z) / d z is -x / z^2: the depth enters squared.",
    ("-f_u * x / z**2", "-f_u * x / z"), ("[0, f_v / z, -f_v * y / z**2],\n", "[0, f_v / z, -f_v * y / z],\n"),
    ("(x - baseline) / z**2", "(x - baseline) / z"), ("-f_v * y / z**2]])", "-f_v * y / z]])"))
