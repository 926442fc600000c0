"""SO(3) and SE(3): from twists to poses and back, and how both react to a small change.

A twist is `[v, omega]` (translation first), shape (..., 6); a pose is (..., 4, 4). Names without prefix belong to
SE(3), names that start with `so3_` to SO(3). Everything broadcasts over leading axes, so one function serves one pose
and a whole trajectory. Functions of the rotation angle are exact at angle zero, near it, and near pi.

This is not a pose class, and nothing here projects a matrix back onto the group: what goes in as a rotation
must be one.

Sources: report section 3.3.1; Barfoot, State Estimation for Robotics, chapter 7 (which names the same operators).

>>> import numpy as np
>>> from vislam_edu import se3
>>> T = se3.exp(np.array([1.0, 0, 0, 0, 0, np.pi / 2]))
>>> np.allclose(se3.log(T), [1, 0, 0, 0, 0, np.pi / 2])
True
"""

from collections.abc import Iterable
from itertools import accumulate
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

# --- Functions of the rotation angle ---

_SERIES_BELOW = 4.0  # rad^2, squared angle: at 2 rad series and closed forms agree to 1e-15
_ORDERS = np.arange(15)
_SERIES = np.array(  # power series in t^2, one row per order and one column per function a ... e
    [[(-1) ** n * top / factorial(2 * n + i) for i, top in enumerate((1, 1, 1, n + 1, n + 1), start=1)]
     for n in range(len(_ORDERS))]
)


def _angle_functions(phi: np.ndarray) -> tuple[np.ndarray, ...]:
    """The five functions of the angle t = |phi| that every closed form below is made of, and t squared.

    a = sin t / t,  b = (1 - cos t) / t^2,  c = (t - sin t) / t^3,
    d = (b - a/2) / t^2,  e = (3c - b) / (2 t^2)

    The closed forms of c, d and e subtract nearly equal numbers at small angles (e loses five powers of t),
    so below 2 rad all five come from their power series in t^2.
    """
    t2 = np.sum(phi * phi, axis=-1)
    small = t2 < _SERIES_BELOW
    five = np.minimum(t2, _SERIES_BELOW)[..., None] ** _ORDERS @ _SERIES
    if not small.all():  # a filter's angles are all small, and it calls this several times a frame
        u2 = np.maximum(t2, _SERIES_BELOW)
        u = np.sqrt(u2)
        a = np.sin(u) / u
        b = 2.0 * np.sin(0.5 * u) ** 2 / u2
        c = (1.0 - a) / u2
        closed = np.stack([a, b, c, (b - 0.5 * a) / u2, (3.0 * c - b) / (2.0 * u2)], axis=-1)
        five = np.where(small[..., None], five, closed)
    a, b, c, d, e = (five[..., i, None, None] for i in range(5))
    return a, b, c, d, e, t2[..., None, None]


def checked(value: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    """`value` as an array of floats with last axes `shape`, or a ValueError that names the shape it got."""
    value = np.asarray(value, dtype=float)
    if value.shape[-len(shape):] != shape:
        wanted = ", ".join(map(str, shape))
        raise ValueError(f"{name} must have shape (..., {wanted}), got {value.shape}")
    return value


# --- SO(3) ---

def so3_hat(omega: ArrayLike) -> np.ndarray:
    """Skew-symmetric matrix: `so3_hat(a) @ b == cross(a, b)`. omega (..., 3); returns (..., 3, 3)."""
    omega = checked(omega, (3,), "omega")
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    matrix = np.zeros(omega.shape + (3,))
    matrix[..., 0, 1], matrix[..., 0, 2] = -z, y
    matrix[..., 1, 0], matrix[..., 1, 2] = z, -x
    matrix[..., 2, 0], matrix[..., 2, 1] = -y, x
    return matrix


def so3_vee(matrix: ArrayLike) -> np.ndarray:
    """Inverse of `so3_hat`: the vector of a skew-symmetric matrix (..., 3, 3); returns (..., 3)."""
    matrix = checked(matrix, (3, 3), "matrix")
    return np.stack([matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0]], axis=-1)


def so3_exp(phi: ArrayLike) -> np.ndarray:
    """Rotation matrix of a rotation vector: Rodrigues' formula. phi (..., 3), rad; returns (..., 3, 3)."""
    phi = checked(phi, (3,), "phi")
    a, b, *_ = _angle_functions(phi)
    S = so3_hat(phi)
    return np.eye(3) + a * S + b * (S @ S)


@np.errstate(all="ignore")  # of numbers that no rotation has
def is_rotation(R: np.ndarray, tolerance: float) -> np.ndarray:
    """(...,) bool: whether R R^T is the identity to within `tolerance` and det R positive. R (..., 3, 3)."""
    handed = np.vecdot(R[..., 0], np.cross(R[..., 1], R[..., 2])) > 0
    return handed & (np.abs(R @ R.mT - np.eye(3)).max(axis=(-2, -1)) < tolerance)


def so3_log(R: ArrayLike) -> np.ndarray:
    """Rotation vector of a rotation matrix, angle in [0, pi]. R (..., 3, 3); returns (..., 3), rad.

    Goes through the unit quaternion q = [w, x, y, z]: the trace and the skew part alone lose half of the digits near
    pi. 4 q q^T is linear in R; any of its rows is q times a number, and the row of the largest diagonal entry is the
    one that divides by nothing small. At exactly pi both signs of the axis are right; one is returned.
    Raises ValueError for a matrix that is not a rotation: a reflection, or R^T R further than 1e-4 from the identity.
    Source: Shepperd, Quaternion from rotation matrix, 1978.
    """
    R = checked(R, (3, 3), "R")
    Rt = np.swapaxes(R, -1, -2)
    wrong = ~is_rotation(R, 1e-4) & np.isfinite(R).all(axis=(-2, -1))
    if wrong.any():
        where = f"R{[int(i) for i in np.argwhere(wrong)[0]]}" if R.ndim > 2 else "R"
        raise ValueError(f"{where} is not a rotation: R^T R must be the identity and det R = 1 (scaled? a reflection?)")
    trace = np.trace(R, axis1=-2, axis2=-1)
    qq = np.empty(R.shape[:-2] + (4, 4))
    qq[..., 0, 0] = 1.0 + trace
    qq[..., 0, 1:] = qq[..., 1:, 0] = so3_vee(R - Rt)
    qq[..., 1:, 1:] = R + Rt + (1.0 - trace)[..., None, None] * np.eye(3)
    largest = np.argmax(np.diagonal(qq, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(qq, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0.0, -q, q)  # q and -q are one rotation; w >= 0 is the one with angle <= pi
    w, xyz = q[..., :1], q[..., 1:]
    sine = np.linalg.norm(xyz, axis=-1, keepdims=True)  # of half the angle
    turned = sine > 0.0
    return xyz * np.where(turned, 2.0 * np.arctan2(sine, w) / np.where(turned, sine, 1.0), 2.0)


def so3_left_jacobian(phi: ArrayLike) -> np.ndarray:
    """Left Jacobian: `so3_exp(phi + d) ~ so3_exp(so3_left_jacobian(phi) @ d) @ so3_exp(phi)` for small d.

    phi (..., 3), rad; returns (..., 3, 3). Source: Barfoot, section 7.1.5.
    """
    phi = checked(phi, (3,), "phi")
    _, b, c, *_ = _angle_functions(phi)
    S = so3_hat(phi)
    return np.eye(3) + b * S + c * (S @ S)


def so3_left_jacobian_inverse(phi: ArrayLike) -> np.ndarray:
    """Inverse of `so3_left_jacobian`. phi (..., 3), rad; returns (..., 3, 3).

    The inverse does not exist at angles of 2 pi, 4 pi, ... (never met by what `so3_log` returns).
    """
    phi = checked(phi, (3,), "phi")
    _, b, _, d, *_ = _angle_functions(phi)
    S = so3_hat(phi)
    return np.eye(3) - 0.5 * S + (d / b) * (S @ S)


def so3_right_jacobian(phi: ArrayLike) -> np.ndarray:
    """Right Jacobian: `so3_exp(phi + d) ~ so3_exp(phi) @ so3_exp(so3_right_jacobian(phi) @ d)` for small d.

    phi (..., 3), rad; returns (..., 3, 3).
    """
    return so3_left_jacobian(-checked(phi, (3,), "phi"))


# --- SE(3) ---

def pose(R: ArrayLike, p: ArrayLike) -> np.ndarray:
    """The pose `[[R, p], [0, 1]]`. R (..., 3, 3), p (..., 3), m, which broadcast; returns (..., 4, 4)."""
    R, p = checked(R, (3, 3), "R"), checked(p, (3,), "p")
    T = np.zeros(np.broadcast_shapes(R.shape[:-2], p.shape[:-1]) + (4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1.0
    return T


def inverse(T: ArrayLike) -> np.ndarray:
    """Inverse pose `[[R^T, -R^T p], [0, 1]]`: `inverse(a_T_b) == b_T_a`. T and the result (..., 4, 4)."""
    T = checked(T, (4, 4), "T")
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(Rt, -np.matvec(Rt, T[..., :3, 3]))


def chain(start: np.ndarray, steps: Iterable[np.ndarray]) -> np.ndarray:
    """Poses (n+1, 4, 4) from `start` (4, 4) on, each the one before times the next of the steps (n, 4, 4).

    Rotations (3, 3) are joined alike.
    """
    return np.array([*accumulate(steps, np.matmul, initial=start)])


def transform(T: ArrayLike, points: ArrayLike) -> np.ndarray:
    """Points in another frame: `transform(a_T_b, points_b) == points_a`.

    T (..., 4, 4) and points (..., 3), m; their leading axes broadcast. Returns (..., 3), m.
    """
    T, points = checked(T, (4, 4), "T"), checked(points, (3,), "points")
    return np.matvec(T[..., :3, :3], points) + T[..., :3, 3]


def hat(xi: ArrayLike) -> np.ndarray:
    """Twist as a matrix of the Lie algebra: `[[omega^, v], [0, 0]]`. xi (..., 6); returns (..., 4, 4)."""
    xi = checked(xi, (6,), "xi")
    matrix = np.zeros(xi.shape[:-1] + (4, 4))
    matrix[..., :3, :3] = so3_hat(xi[..., 3:])
    matrix[..., :3, 3] = xi[..., :3]
    return matrix


def curly_hat(xi: ArrayLike) -> np.ndarray:
    """Adjoint of the Lie algebra: `hat(curly_hat(a) @ b) == hat(a) @ hat(b) - hat(b) @ hat(a)`.

    `[[omega^, v^], [0, omega^]]`. xi (..., 6); returns (..., 6, 6). Source: report section 3.3.1.
    """
    xi = checked(xi, (6,), "xi")
    matrix = np.zeros(xi.shape + (6,))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = so3_hat(xi[..., 3:])
    matrix[..., :3, 3:] = so3_hat(xi[..., :3])
    return matrix


def exp(xi: ArrayLike) -> np.ndarray:
    """Pose reached by following the constant twist xi for one unit of time.

    xi (..., 6), `[v, omega]` times that time: m and rad. Returns (..., 4, 4).
    The exponential series ends after the cube, because hat(xi)^4 = -t^2 hat(xi)^2 (t is the angle).
    """
    xi = checked(xi, (6,), "xi")
    _, b, c, *_ = _angle_functions(xi[..., 3:])
    X = hat(xi)
    XX = X @ X
    return np.eye(4) + X + b * XX + c * (XX @ X)


def log(T: ArrayLike) -> np.ndarray:
    """Twist whose `exp` is T, rotation angle in [0, pi]. T (..., 4, 4); returns (..., 6), m and rad.

    Raises ValueError for a matrix that is no pose, as `so3_log` does or for another last row than [0, 0, 0, 1].
    """
    T = checked(T, (4, 4), "T")
    if (np.abs(T[..., 3, :] - [0, 0, 0, 1]) > 1e-6).any():
        raise ValueError("the last row of a pose must be [0, 0, 0, 1]: is it transposed?")
    phi = so3_log(T[..., :3, :3])
    return np.concatenate([np.matvec(so3_left_jacobian_inverse(phi), T[..., :3, 3]), phi], axis=-1)


def adjoint(T: ArrayLike) -> np.ndarray:
    """Carries a twist into another frame: `T @ exp(xi) == exp(adjoint(T) @ xi) @ T`.

    `[[R, p^ R], [0, R]]`. T (..., 4, 4); returns (..., 6, 6).
    """
    T = checked(T, (4, 4), "T")
    R = T[..., :3, :3]
    matrix = np.zeros(T.shape[:-2] + (6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = R
    matrix[..., :3, 3:] = so3_hat(T[..., :3, 3]) @ R
    return matrix


def odot(point: ArrayLike) -> np.ndarray:
    """Circled-dot operator: `hat(xi) @ [point, 1] == odot(point) @ xi` for every twist.

    It turns "how does a point move when its frame is perturbed" into a matrix, which is what the pose
    Jacobian of any camera needs.

    point : (..., 3), metres, in the frame that xi perturbs.
    Returns (..., 4, 6), columns ordered [v, omega].
    Source: report section 3.3.1; Barfoot, State Estimation for Robotics, section 7.1.8.
    """
    point = checked(point, (3,), "point")
    matrix = np.zeros(point.shape[:-1] + (4, 6))
    matrix[..., :3, :3] = np.eye(3)
    matrix[..., :3, 3:] = -so3_hat(point)
    return matrix


def left_jacobian(xi: ArrayLike) -> np.ndarray:
    """Left Jacobian: `exp(xi + d) ~ exp(left_jacobian(xi) @ d) @ exp(xi)` for small d.

    xi (..., 6); returns (..., 6, 6). At zero rotation it is `[[I, v^/2], [0, I]]`, not I.
    The series sum_n X^n / (n+1)! with X = curly_hat(xi) ends with X^4, because X (X^2 + t^2 I)^2 = 0, t the
    rotation angle. Source: Barfoot, section 7.1.5; the off-diagonal block is Q of his equation 7.86b.
    """
    xi = checked(xi, (6,), "xi")
    _, b, c, d, e, t2 = _angle_functions(xi[..., 3:])
    X = curly_hat(xi)
    XX = X @ X
    one = np.eye(6)
    return one + b * X + c * XX + (d * X + e * XX) @ (XX + t2 * one)


def left_jacobian_inverse(xi: ArrayLike) -> np.ndarray:
    """Inverse of `left_jacobian`: `log(exp(d) @ exp(xi)) ~ xi + left_jacobian_inverse(xi) @ d` for small d.

    xi (..., 6); returns (..., 6, 6). Does not exist at rotation angles of 2 pi, 4 pi, ...
    """
    xi = checked(xi, (6,), "xi")
    J_inverse = so3_left_jacobian_inverse(xi[..., 3:])
    Q = left_jacobian(xi)[..., :3, 3:]
    matrix = np.zeros(xi.shape + (6,))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = J_inverse
    matrix[..., :3, 3:] = -J_inverse @ Q @ J_inverse
    return matrix


def right_jacobian(xi: ArrayLike) -> np.ndarray:
    """Right Jacobian: `exp(xi + d) ~ exp(xi) @ exp(right_jacobian(xi) @ d)` for small d.

    xi (..., 6); returns (..., 6, 6).
    """
    return left_jacobian(-checked(xi, (6,), "xi"))


def right_jacobian_inverse(xi: ArrayLike) -> np.ndarray:
    """Inverse of `right_jacobian`: `log(exp(xi) @ exp(d)) ~ xi + right_jacobian_inverse(xi) @ d` for small d.

    xi (..., 6); returns (..., 6, 6).
    """
    return left_jacobian_inverse(-checked(xi, (6,), "xi"))
