"""Exercises of notebook 15: the structure tensor, a step of Lucas-Kanade, the row check, rectifying a point."""

import numpy as np

from ... import lens, tracking
from ..checks.exercise import exercise
from ..checks.inputs import random_calibration


def _gradients(rng):
    for size in (3, 5, 9):
        yield "random", (rng.normal(0, 10, (size, size)), rng.normal(0, 4, (size, size)))


@exercise(chapter=15, cases=_gradients, shows=[tracking.structure_tensor, tracking.smaller_eigenvalue],
          outputs=["A", "smaller"], hints=[
    "Each pixel adds the outer product of its gradient (g_u, g_v) with itself.",
    "The smaller eigenvalue is np.linalg.eigvalsh(A)[0]."])
def patch_information(g_u, g_v):
    """The structure tensor of a patch, summed over its pixels, and its smaller eigenvalue.

    g_u, g_v : (s, s), grey values per px, the gradient along the row and along the column.
    Returns A (2, 2) and a number.
    """
    uu, uv, vv = np.sum(g_u * g_u), np.sum(g_u * g_v), np.sum(g_v * g_v)
    A = np.array([[uu, uv], [uv, vv]])
    return A, np.linalg.eigvalsh(A)[0]


patch_information.slip("outer product of the sums", """Gradients of both signs cancel in the sum, and the outer product
    of one vector has rank one: its smaller eigenvalue is 0 for every patch. Multiply first, then sum.""",
    ("np.array([[uu, uv], [uv, vv]])", "np.outer([np.sum(g_u), np.sum(g_v)], [np.sum(g_u), np.sum(g_v)])"))
patch_information.slip("larger eigenvalue", """The larger eigenvalue says how well the better direction is known; an
    edge has a large one too. A corner needs both, so the smaller one counts.""", ("(A)[0]", "(A)[1]"))
patch_information.slip("mean instead of sum", """Each pixel adds information: 49 pixels know more than one. Sum, do not
    average.""", ("np.array([[uu, uv], [uv, vv]])", "np.array([[uu, uv], [uv, vv]]) / g_u.size"))
patch_information.slip("determinant", """The determinant is the product of both eigenvalues: an edge of high contrast
    has a large one too. Return the smaller eigenvalue.""", ("np.linalg.eigvalsh(A)[0]", "np.linalg.det(A)"))
patch_information.slip("trace", """The trace is the sum of both eigenvalues: an edge has a large one too. Return the
    smaller eigenvalue.""", ("np.linalg.eigvalsh(A)[0]", "np.trace(A)"))


def _patches(rng):
    for size in (5, 7, 11):
        g_u, g_v = rng.normal(0, 10, (2, size, size))
        template = rng.uniform(0, 255, (size, size))
        yield "random", (template, template - 0.3 * g_u + 0.6 * g_v + rng.normal(0, 2, (size, size)), g_u, g_v)


@exercise(chapter=15, cases=_patches, shows=[tracking.lucas_kanade], hints=[
    "Least squares: g step = template - seen, one equation for each pixel.",
    "A step = b with A = sum g g^T and b = sum g (template - seen)."])
def lucas_kanade_step(template, seen, g_u, g_v):
    """One step of Gauss-Newton: where to look next in the other image.

    template : (s, s), the patch. seen : (s, s), the other image at the present guess.
    g_u, g_v : (s, s), the gradient of the template. Returns (2,) px, to be added to the guess (u, v).
    """
    g = np.column_stack([g_u.ravel(), g_v.ravel()])
    A = g.T @ g
    b = g.T @ (template - seen).ravel()
    return np.linalg.solve(A, b)


lucas_kanade_step.slip("sign", """The step goes the wrong way, and the residual grows. The other image must become the
    template: seen + g step = template.""", ("template - seen", "seen - template"))
lucas_kanade_step.slip("u and v swapped", "A point is (u, v): first along the row, with g_u, then down, with g_v.",
    ("[g_u.ravel(), g_v.ravel()]", "[g_v.ravel(), g_u.ravel()]"))
lucas_kanade_step.slip("gradient without the inverse", """sum g (template - seen) says which way is downhill, not how
    far: divide by the information, A step = b.""", ("np.linalg.solve(A, b)", "b"))


def _matches(rng):
    for n, tolerance in ((6, 1.0), (20, 0.5), (50, 2.0)):
        left = rng.uniform(0, 300, (n, 2))
        disparity = rng.choice([-3.0, 0.0, 0.5, 8.0, 40.0], n)
        rows = tolerance * rng.choice([-4.0, -1.1, -0.9, 0.2, 0.9, 1.7], n)
        yield "random", (np.column_stack([left, left[:, 0] - disparity, left[:, 1] - rows]), tolerance)


@exercise(chapter=15, cases=_matches, shows=[tracking.track], hints=[
    "pixels[:, 1] and pixels[:, 3] are the rows, pixels[:, 0] - pixels[:, 2] the disparity.",
    "A difference of rows has a sign: take its absolute value."])
def row_check(pixels, tolerance):
    """Which stereo matches may be right: rows that agree to `tolerance` px, and a positive disparity.

    pixels : (n, 4), u_left, v_left, u_right, v_right, px, rectified. Returns (n,) bool.
    """
    u_left, v_left, u_right, v_right = pixels.T
    return (np.abs(v_left - v_right) <= tolerance) & (u_left > u_right)


row_check.slip("difference of rows without its sign", """A right row far below the left one passes: the difference is
    then a large negative number. Compare its absolute value.""", ("np.abs(v_left - v_right)", "v_left - v_right"))
row_check.slip("disparity not looked at", """A point in front of both cameras is farther left in the right image: u_left
    > u_right. A match with a negative disparity lies behind the cameras.""", (" & (u_left > u_right)", ""))
row_check.slip("columns compared", "Rows are v: entries 1 and 3. The columns differ by the disparity, and should.",
    ("v_left - v_right", "u_left - u_right"))
row_check.slip("squares compared", "tolerance is in px: the square of a difference belongs to its square.",
    ("np.abs(v_left - v_right)", "(v_left - v_right)**2"))
row_check.slip("one condition is enough", "Both must hold: the rows agree *and* the disparity is positive.", ("&", "|"))


def _turned(rng):
    for _ in range(3):
        K, K_new = random_calibration(rng), random_calibration(rng)
        a, b, c = rng.uniform(-0.05, 0.05, 3)
        R = np.linalg.qr(np.eye(3) + np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]))[0]
        yield "random", (rng.uniform(0, 480, 2), K, R * np.sign(np.diag(R)), K_new)


@exercise(chapter=15, cases=_turned, shows=[lens.Lens.rectify], hints=[
    "Pixel to ray with K^-1, turn the ray, ray to pixel with K_new.",
    "The turned ray's third number is not 1: divide by it."])
def rectify_point(uv, K, rectified_R_cam, K_new):
    """Where a turned camera without distortion would have seen a pixel.

    uv : (2,) px, of the camera with K (3, 3). rectified_R_cam : (3, 3), turns its rays into those of the rectified
    camera, whose matrix is K_new (3, 3). Returns (2,) px.
    """
    ray = np.linalg.inv(K) @ np.append(uv, 1.0)
    q = K_new @ rectified_R_cam @ ray
    return q[:2] / q[2]


rectify_point.slip("turned the other way", "rectified_R_cam maps rays of the camera; its transpose maps them back.",
    ("rectified_R_cam @ ray", "rectified_R_cam.T @ ray"))
rectify_point.slip("no division by the third number", """A ray is known up to its length: after the turn its third
    number is no longer 1, and a pixel is what remains after dividing by it.""", ("q[:2] / q[2]", "q[:2]"))
rectify_point.slip("one K for both cameras", "K takes the old pixel to a ray, K_new the turned ray to the new pixel.",
    ("K_new @", "K @"))
