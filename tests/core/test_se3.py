"""SO(3) and SE(3) against their axioms, scipy, power series and central differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numerical import central_difference
from numpy.testing import assert_allclose
from scipy.linalg import expm, logm
from scipy.spatial.transform import RigidTransform

from vislam_edu import se3

EXACT = 1e-12

# Angles where a closed form or a logarithm is most likely to go wrong, on both sides of every branch.
ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 1e-4, 1e-2, 0.3, 1.0, 2.0 - 1e-9, 2.0 + 1e-9, 3.0]
ANGLES += [np.pi - 1e-6, np.pi - 1e-9]
AXES = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 1, 1], [-1, 2, 0.5], [1e-9, 1, -1]])
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)

BATCH_SHAPES = st.sampled_from([(), (1,), (3,), (2, 3), (0,)])


@st.composite
def twists(draw, shape=BATCH_SHAPES, max_angle=np.pi - 1e-6):
    """Twists (..., 6) with angles drawn near zero and near pi on purpose, and translations up to 30 m."""
    shape = draw(shape)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    special = draw(st.sampled_from([0.0, 1e-8, 1e-3, max_angle]) | st.floats(0.0, max_angle))
    angle = np.where(rng.random(shape) < 0.5, special, rng.uniform(0.0, max_angle, shape))
    axis = rng.normal(size=shape + (3,))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    return np.concatenate([rng.uniform(-30, 30, shape + (3,)), angle[..., None] * axis], axis=-1)


@st.composite
def several(draw, count):
    """The given number of twists of one batch shape."""
    shape = st.just(draw(BATCH_SHAPES))
    return [draw(twists(shape)) for _ in range(count)]


def special_twists():
    """(n, 6): every angle in ANGLES about every axis, all with a translation."""
    phi = (np.array(ANGLES)[:, None, None] * AXES).reshape(-1, 3)
    v = np.random.default_rng(1).normal(size=phi.shape) * 5.0
    return np.concatenate([v, phi], axis=-1)


def series(X):
    """sum_n X^n / (n+1)!, which every left Jacobian is."""
    total = term = np.eye(len(X))
    for n in range(1, 80):
        term = term @ X / n
        total = total + term / (n + 1)
    return total


# Hat and the group axioms


@given(twists())
def test_so3_vee_undoes_so3_hat(xi):
    assert np.array_equal(se3.so3_vee(se3.so3_hat(xi[..., 3:])), xi[..., 3:])


@given(several(2))
def test_so3_hat_is_the_cross_product(pair):
    a, b = pair[0][..., :3], pair[1][..., :3]
    assert_allclose(np.matvec(se3.so3_hat(a), b), np.cross(a, b), rtol=0, atol=1e-11)


@given(several(2))
def test_curly_hat_is_the_lie_bracket(pair):
    a, b = pair
    bracket = se3.hat(a) @ se3.hat(b) - se3.hat(b) @ se3.hat(a)
    assert_allclose(se3.hat(np.matvec(se3.curly_hat(a), b)), bracket, rtol=0, atol=1e-11)


@given(several(3))
def test_group_axioms(triple):
    A, B, C = (se3.exp(xi) for xi in triple)
    one = np.broadcast_to(np.eye(4), A.shape)
    assert_allclose((A @ B) @ C, A @ (B @ C), rtol=0, atol=EXACT * 100)
    assert_allclose(A @ se3.inverse(A), one, rtol=0, atol=EXACT * 30)
    assert_allclose(se3.inverse(A) @ A, one, rtol=0, atol=EXACT * 30)
    assert_allclose(se3.inverse(A @ B), se3.inverse(B) @ se3.inverse(A), rtol=0, atol=EXACT * 100)
    R = A[..., :3, :3]
    assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), rtol=0, atol=EXACT)
    assert_allclose(np.linalg.det(R), np.ones(R.shape[:-2]), rtol=0, atol=EXACT)
    assert np.array_equal(A[..., 3, :], one[..., 3, :])


@given(several(2))
def test_adjoint_is_a_homomorphism_and_carries_twists(pair):
    A, xi = se3.exp(pair[0]), pair[1]
    B = se3.exp(xi)
    Ad = se3.adjoint(A)
    assert_allclose(se3.adjoint(A @ B), Ad @ se3.adjoint(B), rtol=0, atol=1e-10)
    assert_allclose(A @ se3.hat(xi) @ se3.inverse(A), se3.hat(np.matvec(Ad, xi)), rtol=0, atol=1e-10)
    assert_allclose(A @ B @ se3.inverse(A), se3.exp(np.matvec(Ad, xi)), rtol=0, atol=1e-10)


@given(several(2))
def test_odot_and_transform_are_products_with_homogeneous_points(pair):
    xi, point = pair[0], pair[1][..., :3]
    homogeneous = np.concatenate([point, np.ones(point.shape[:-1] + (1,))], axis=-1)
    assert_allclose(np.matvec(se3.odot(point), xi), np.matvec(se3.hat(xi), homogeneous), rtol=0, atol=1e-11)
    T = se3.exp(xi)
    assert_allclose(se3.transform(T, point), np.matvec(T, homogeneous)[..., :3], rtol=0, atol=1e-11)


# Exp and log


@given(twists())
def test_log_undoes_exp(xi):
    """The logarithm's translation is as good as the angle: 30 m times the rounding of a rotation matrix."""
    assert_allclose(se3.log(se3.exp(xi)), xi, rtol=0, atol=EXACT)
    assert_allclose(se3.so3_log(se3.so3_exp(xi[..., 3:])), xi[..., 3:], rtol=0, atol=EXACT)


@given(twists(max_angle=10.0))
def test_exp_undoes_log_at_every_angle(xi):
    T = se3.exp(xi)
    back = se3.log(T)
    assert_allclose(se3.exp(back), T, rtol=0, atol=EXACT * 30)
    assert (np.linalg.norm(back[..., 3:], axis=-1) <= np.pi + 1e-15).all()


def test_log_at_exactly_half_a_turn():
    phi = np.pi * AXES
    back = se3.so3_log(se3.so3_exp(phi))
    assert_allclose(np.linalg.norm(back, axis=-1), np.pi, rtol=0, atol=EXACT)
    assert_allclose(se3.so3_exp(back), se3.so3_exp(phi), rtol=0, atol=EXACT)
    assert_allclose(np.abs(np.sum(back * phi, axis=-1)), np.pi**2, rtol=0, atol=EXACT * 10)


def test_log_of_exact_half_turns_written_by_hand():
    for axis in np.eye(3):
        half_turn = np.diag(2.0 * axis - 1.0)
        assert_allclose(np.abs(se3.so3_log(half_turn)), np.pi * axis, rtol=0, atol=EXACT)
    assert np.array_equal(se3.log(np.eye(4)), np.zeros(6))


@pytest.mark.parametrize("xi", special_twists())
def test_exp_and_log_against_scipy(xi):
    T = se3.exp(xi)
    assert_allclose(T, expm(se3.hat(xi)), rtol=0, atol=EXACT * 10)
    rigid = RigidTransform.from_exp_coords(np.concatenate([xi[3:], xi[:3]]))
    assert_allclose(T, rigid.as_matrix(), rtol=0, atol=EXACT)
    coordinates = rigid.as_exp_coords()
    assert_allclose(se3.log(T), np.concatenate([coordinates[3:], coordinates[:3]]), rtol=0, atol=EXACT)
    assert_allclose(se3.log(T), xi, rtol=0, atol=EXACT)
    assert_allclose(se3.so3_exp(xi[3:]), T[:3, :3], rtol=0, atol=EXACT)


@given(twists(st.just(()), max_angle=2.5))
def test_log_against_logm(xi):
    """logm, which is general, loses digits near pi; it is asked where it is exact."""
    T = se3.exp(xi)
    T[np.abs(T) < 1e-200] = 0.0  # logm overflows inside where an entry is below some 1e-291, and not zero
    assert_allclose(se3.hat(se3.log(T)), np.real(logm(T)), rtol=0, atol=1e-10)


def test_small_rotations_keep_their_relative_precision():
    """1e-8 rad must come back as 1e-8 rad, not as zero or as 1.05e-8."""
    for angle in (1e-8, 1e-12, 1e-100):
        assert_allclose(se3.so3_log(se3.so3_exp(angle * AXES)), angle * AXES, rtol=1e-15, atol=angle * 1e-15)


# Jacobians


@pytest.mark.parametrize("xi", special_twists())
def test_left_jacobian_is_its_series_and_adjoint_is_an_exponential(xi):
    X = se3.curly_hat(xi)
    assert_allclose(se3.left_jacobian(xi), series(X), rtol=0, atol=EXACT)
    assert_allclose(se3.so3_left_jacobian(xi[3:]), series(se3.so3_hat(xi[3:])), rtol=0, atol=EXACT)
    assert_allclose(se3.adjoint(se3.exp(xi)), expm(X), rtol=0, atol=EXACT * 10)


@pytest.mark.parametrize("xi", [xi for xi in special_twists() if np.linalg.norm(xi[3:]) > 0.1])
def test_left_jacobian_has_barfoots_block(xi):
    """The off-diagonal block as Barfoot prints it (7.86b); below 0.1 rad its terms cancel too many digits."""
    v, phi = se3.so3_hat(xi[:3]), se3.so3_hat(xi[3:])
    t = np.linalg.norm(xi[3:])
    Q = (v / 2
         + (t - np.sin(t)) / t**3 * (phi @ v + v @ phi + phi @ v @ phi)
         + (t**2 + 2 * np.cos(t) - 2) / (2 * t**4) * (phi @ phi @ v + v @ phi @ phi - 3 * phi @ v @ phi)
         + (2 * t - 3 * np.sin(t) + t * np.cos(t)) / (2 * t**5) * (phi @ v @ phi @ phi + phi @ phi @ v @ phi))
    assert_allclose(se3.left_jacobian(xi)[:3, 3:], Q, rtol=0, atol=1e-11)


def test_left_jacobian_at_zero_rotation_keeps_the_translation():
    xi = np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0])
    expected = np.eye(6)
    expected[:3, 3:] = 0.5 * se3.so3_hat(xi[:3])
    assert np.array_equal(se3.left_jacobian(xi), expected)
    expected[:3, 3:] *= -1.0
    assert np.array_equal(se3.left_jacobian_inverse(xi), expected)
    assert np.array_equal(se3.right_jacobian(xi), expected)


@pytest.mark.parametrize("xi", special_twists())
def test_jacobians_against_central_differences(xi):
    """The change of exp, measured in the Lie algebra, on either side."""
    T, R = se3.exp(xi), se3.so3_exp(xi[3:])
    left = central_difference(lambda d: se3.log(se3.exp(xi + d) @ se3.inverse(T)), 6)
    right = central_difference(lambda d: se3.log(se3.inverse(T) @ se3.exp(xi + d)), 6)
    so3_left = central_difference(lambda d: se3.so3_log(se3.so3_exp(xi[3:] + d) @ R.T), 3)
    so3_right = central_difference(lambda d: se3.so3_log(R.T @ se3.so3_exp(xi[3:] + d)), 3)
    for analytic, numerical in ((se3.left_jacobian(xi), left),
                                (se3.right_jacobian(xi), right),
                                (se3.so3_left_jacobian(xi[3:]), so3_left),
                                (se3.so3_right_jacobian(xi[3:]), so3_right)):
        assert_allclose(analytic, numerical, rtol=0, atol=1e-9 * max(1.0, np.abs(numerical).max()))


@pytest.mark.parametrize("xi", [xi for xi in special_twists() if np.linalg.norm(xi[3:]) <= 3.0])
def test_inverse_jacobians_against_central_differences(xi):
    """log jumps at pi, so this stays below; above, `test_inverse_jacobians_invert` holds them."""
    T, R = se3.exp(xi), se3.so3_exp(xi[3:])
    left = central_difference(lambda d: se3.log(se3.exp(d) @ T), 6)
    right = central_difference(lambda d: se3.log(T @ se3.exp(d)), 6)
    so3_left = central_difference(lambda d: se3.so3_log(se3.so3_exp(d) @ R), 3)
    for analytic, numerical in ((se3.left_jacobian_inverse(xi), left),
                                (se3.right_jacobian_inverse(xi), right),
                                (se3.so3_left_jacobian_inverse(xi[3:]), so3_left)):
        assert_allclose(analytic, numerical, rtol=0, atol=1e-9 * max(1.0, np.abs(numerical).max()))


@given(twists())
def test_inverse_jacobians_invert(xi):
    phi = xi[..., 3:]
    for J, J_inverse in ((se3.left_jacobian(xi), se3.left_jacobian_inverse(xi)),
                         (se3.right_jacobian(xi), se3.right_jacobian_inverse(xi)),
                         (se3.so3_left_jacobian(phi), se3.so3_left_jacobian_inverse(phi))):
        assert_allclose(J @ J_inverse, np.broadcast_to(np.eye(J.shape[-1]), J.shape), rtol=0, atol=EXACT * 10)


@given(twists())
def test_jacobians_of_the_two_sides(xi):
    """J_r(xi) = J_l(-xi), and J_l = Ad J_r: a change on the right reaches the left through the Adjoint."""
    assert np.array_equal(se3.right_jacobian(xi), se3.left_jacobian(-xi))
    carried = se3.adjoint(se3.exp(xi)) @ se3.right_jacobian(xi)
    assert_allclose(se3.left_jacobian(xi), carried, rtol=0, atol=EXACT * 100)
    moved = np.matvec(se3.so3_left_jacobian(xi[..., 3:]), xi[..., :3])
    assert_allclose(se3.exp(xi)[..., :3, 3], moved, rtol=0, atol=EXACT * 30)


# Shapes

OF_A_VECTOR = [(se3.so3_hat, 3), (se3.so3_exp, 3), (se3.so3_left_jacobian, 3), (se3.so3_left_jacobian_inverse, 3),
               (se3.so3_right_jacobian, 3), (se3.odot, 3), (se3.hat, 6),
               (se3.curly_hat, 6), (se3.exp, 6), (se3.left_jacobian, 6), (se3.left_jacobian_inverse, 6),
               (se3.right_jacobian, 6), (se3.right_jacobian_inverse, 6)]
OF_A_MATRIX = [(se3.so3_vee, 3), (se3.so3_log, 3), (se3.log, 4), (se3.inverse, 4), (se3.adjoint, 4)]


def name(value):
    return getattr(value, "__name__", None)


@pytest.mark.parametrize(("function", "size"), OF_A_VECTOR, ids=name)
def test_a_batch_of_vectors_is_a_loop(function, size):
    batch = special_twists()[:, -size:].reshape(len(ANGLES), len(AXES), size)
    looped = np.array([[function(x) for x in row] for row in batch])
    assert_allclose(function(batch), looped, rtol=0, atol=1e-14)
    assert function(batch[:0]).shape == (0,) + looped.shape[1:]


@pytest.mark.parametrize(("function", "size"), OF_A_MATRIX, ids=name)
def test_a_batch_of_matrices_is_a_loop(function, size):
    batch = se3.exp(special_twists())[:, :size, :size].reshape(len(ANGLES), len(AXES), size, size)
    looped = np.array([[function(x) for x in row] for row in batch])
    assert_allclose(function(batch), looped, rtol=0, atol=1e-14)
    assert function(batch[:0]).shape == (0,) + looped.shape[1:]


def test_transform_and_pose_broadcast_leading_axes():
    T = se3.exp(special_twists()[:4])
    points = np.random.default_rng(2).normal(size=(7, 3))
    looped = np.array([[se3.transform(t, point) for point in points] for t in T])
    assert_allclose(se3.transform(T[:, None], points), looped, rtol=0, atol=1e-14)
    assert_allclose(se3.transform(T[0], points), looped[0], rtol=0, atol=1e-14)
    poses = se3.pose(np.eye(3), points)
    assert poses.shape == (7, 4, 4)
    assert_allclose(se3.transform(poses, np.zeros(3)), points, rtol=0, atol=0)


@pytest.mark.parametrize(("function", "size"), OF_A_VECTOR, ids=name)
def test_wrong_vector_shapes_are_named(function, size):
    for shape in ((), (size - 1,), (2, size + 1)):
        with pytest.raises(ValueError, match=rf"\(\.\.\., {size}\), got \({str(shape)[1:-1]}\)"):
            function(np.zeros(shape))


@pytest.mark.parametrize(("function", "size"), OF_A_MATRIX, ids=name)
def test_wrong_matrix_shapes_are_named(function, size):
    for shape in ((), (size,), (size, size + 1), (2, size - 1, size)):
        with pytest.raises(ValueError, match=rf"\(\.\.\., {size}, {size}\), got \({str(shape)[1:-1]}\)"):
            function(np.zeros(shape))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-8, 1.0, np.pi, 2 * np.pi, 1e3])
def test_no_warning_and_no_nan_at_any_angle(angle):
    xi = np.array([1.0, 2.0, 3.0, 0.0, angle, 0.0])
    for function in (se3.exp, se3.left_jacobian, se3.right_jacobian):
        assert np.isfinite(function(xi)).all()
    assert np.isfinite(se3.log(se3.exp(xi))).all()


ARGUMENTS = {"so3_hat": "omega", "so3_vee": "matrix", "so3_exp": "phi", "so3_log": "R", "so3_left_jacobian": "phi",
             "so3_left_jacobian_inverse": "phi", "so3_right_jacobian": "phi",
             "inverse": "T", "hat": "xi", "curly_hat": "xi", "exp": "xi", "log": "T", "adjoint": "T",
             "odot": "point", "left_jacobian": "xi", "left_jacobian_inverse": "xi", "right_jacobian": "xi",
             "right_jacobian_inverse": "xi"}


@pytest.mark.parametrize(("name", "argument"), ARGUMENTS.items())
def test_a_wrong_shape_is_refused_by_the_name_of_the_argument(name, argument):
    with pytest.raises(ValueError, match=rf"^{argument}\b"):
        getattr(se3, name)(np.zeros(5))


def test_a_chain_joins_steps_one_after_the_other():
    start, steps = se3.exp([1.0, 2, 3, 0.3, -0.2, 0.1]), se3.exp(np.arange(18.0).reshape(3, 6) / 10)
    path = se3.chain(start, steps)
    assert path.shape == (4, 4, 4)
    assert np.allclose(path[0], start)
    assert np.allclose(path[-1], start @ steps[0] @ steps[1] @ steps[2])
    assert np.allclose(se3.inverse(path[:-1]) @ path[1:], steps)


@pytest.mark.parametrize(("T", "words"), [
    (np.diag([1.0, 1, -1, 1]), "R is not a rotation"), (np.diag([2.0, 2, 2, 1]), "R is not a rotation"),
    (se3.pose(np.eye(3), [1.0, 2, 3]).T, "transposed"),
    (np.array([np.eye(4), np.diag([1.0, -1, 1, 1])]), r"R\[1\] is not a rotation")])
def test_the_logarithm_of_what_is_no_pose_is_refused(T, words):
    with pytest.raises(ValueError, match=words):
        se3.log(T)
