"""Changes of the arguments and of the results of a right answer.

Each comes with words that finish the sentence "your result is what one gets ...".
"""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from ... import se3
from ...stereo import StereoCamera

Change = tuple[str, Callable]

# --- arguments --------------------------------------------------------------------------------------------

def argument_changes(names: list[str], arguments: tuple) -> Iterator[tuple[str, Callable]]:
    """(words, function of all arguments that gives all arguments), for arguments that look like these."""
    for i, (name, value) in enumerate(zip(names, arguments)):
        for words, change in _changes_of(name, value):
            yield words.format(f"`{name}`"), _only(i, change)
        for j in range(i):
            if _alike(value, arguments[j]):
                yield f"with `{names[j]}` and `{name}` exchanged", _replaced({i: j, j: i})
                yield f"with `{names[j]}` used in place of `{name}`", _replaced({i: j})
                yield f"with `{name}` used in place of `{names[j]}`", _replaced({j: i})


def _only(i, change):
    return lambda arguments: (*arguments[:i], change(arguments[i]), *arguments[i + 1:])


def _replaced(by):
    return lambda arguments: tuple(arguments[by.get(k, k)] for k in range(len(arguments)))


def _alike(a, b) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape
    return (isinstance(a, float) and isinstance(b, float)) or type(a) is type(b) is int


def _changes_of(name, value) -> list[Change]:
    if isinstance(value, StereoCamera):
        return _CAMERA
    if isinstance(value, bool | int | np.integer):
        return _INTEGER
    if isinstance(value, float):
        return _NUMBER
    if not isinstance(value, np.ndarray):
        return []
    if value.dtype == bool:
        return _MASK
    if value.dtype.kind == "i":
        return _IDS
    if name == "K":
        return _CALIBRATION
    if value.shape == (4, 4) and np.array_equal(value[3], [0, 0, 0, 1]):
        return _POSE
    changes = list(_ARRAY)
    if value.ndim == 1:
        changes += _VECTOR + (_TWIST if value.shape == (6,) else [])
    if value.ndim == 2 and value.shape[0] == value.shape[1]:
        changes += _SQUARE + (_COVARIANCE if len(value) >= 6 else [])
    if value.ndim > 1 and value.shape[-1] == 6:
        changes += _TWIST
    return changes


def _set(value, index, new):
    value = value.copy()
    value[index] = new
    return value


def _camera(camera, **changed):
    return StereoCamera(**{f.name: getattr(camera, f.name) for f in dataclasses.fields(camera) if f.init} | changed)


def _blocks(P, n):
    P = P.copy()
    P[:n, n:], P[n:, :n] = 0.0, 0.0
    return P


_CAMERA: list[Change] = [
    ("with the extrinsics `cam_T_imu` left out", lambda c: _camera(c, cam_T_imu=np.eye(4))),
    ("with the extrinsics `cam_T_imu` inverted", lambda c: _camera(c, cam_T_imu=se3.inverse(c.cam_T_imu))),
    ("with the translation of `cam_T_imu` left out",
     lambda c: _camera(c, cam_T_imu=_set(c.cam_T_imu, np.s_[:3, 3], 0))),
]
_INTEGER: list[Change] = [
    ("with {0} + 1 in place of {0}", lambda x: x + 1), ("with {0} - 1 in place of {0}", lambda x: x - 1),
    ("with 1 in place of {}", lambda x: 1), ("with 2 in place of {}", lambda x: 2),
]
_NUMBER: list[Change] = [
    ("with {} forgotten (taken as 1)", lambda x: 1.0), ("with {} squared once more", lambda x: x**2),
    ("with the square root of {}", lambda x: x**0.5), ("with 1 / {0} in place of {0}", lambda x: 1 / x),
    ("with the sign of {} reversed", lambda x: -x), ("with zero in place of {}", lambda x: 0.0),
    ("with twice {}", lambda x: 2 * x), ("with half of {}", lambda x: x / 2),
    ("with {} converted from degrees to radians", np.radians), ("with 1 - {0} in place of {0}", lambda x: 1 - x),
    ("with 2 * {0} - 1 in place of {0}", lambda x: 2 * x - 1),
]
_MASK: list[Change] = [("with {} ignored (all True)", np.ones_like), ("with {} turned round", np.logical_not)]
_IDS: list[Change] = [
    ("with {} ignored (0, 1, 2, ... in its place)", lambda x: np.arange(len(x))), ("with {} sorted", np.sort)]
_CALIBRATION: list[Change] = [
    ("with `K` transposed", np.transpose), ("with `K` inverted", np.linalg.inv),
    ("with the principal point forgotten", lambda K: np.diag(np.diag(K))),
    ("with f_u for both axes", lambda K: _set(K, (1, 1), K[0, 0])),
    ("with f_v for both axes", lambda K: _set(K, (0, 0), K[1, 1])),
    ("with c_u and c_v exchanged", lambda K: _set(_set(K, (0, 2), K[1, 2]), (1, 2), K[0, 2])),
    ("with the focal lengths forgotten", lambda K: _set(_set(K, (0, 0), 1.0), (1, 1), 1.0)),
    ("with the principal point added in place of subtracted", lambda K: _set(K, np.s_[:2, 2], -K[:2, 2])),
]
_POSE: list[Change] = [
    ("with {} inverted", se3.inverse),
    ("with the rotation of {} transposed", lambda T: _set(T, np.s_[:3, :3], T[:3, :3].T)),
    ("with the translation of {} left out", lambda T: _set(T, np.s_[:3, 3], 0.0)),
    ("with the rotation of {} left out", lambda T: _set(T, np.s_[:3, :3], np.eye(3))),
    ("with the sign of the translation of {} reversed", lambda T: _set(T, np.s_[:3, 3], -T[:3, 3])),
    ("with {} left out (the identity in its place)", lambda T: np.eye(4)),
]
_ARRAY: list[Change] = [
    ("with the sign of {} reversed", np.negative), ("with {} left out (zero in its place)", np.zeros_like),
    ("with twice {}", lambda x: 2 * x), ("with {} reversed", lambda x: x[::-1]),
    ("with the first of {} used for all", lambda x: np.broadcast_to(x[:1], x.shape).copy() if len(x) else x),
    ("with 1 in place of every {}", np.ones_like),
    ("with the square root of {}", np.sqrt), ("with {} squared", np.square),
]
_VECTOR: list[Change] = [
    ("with {} divided by its length", lambda x: x / np.linalg.norm(x)),
    ("with {} converted from degrees to radians", np.radians),
    ("with the first and the last of {} exchanged", lambda x: x[::-1]),
    ("with the last two of {} exchanged", lambda x: np.r_[x[:-2], x[-1], x[-2]]),
    ("with the first two of {} exchanged", lambda x: np.r_[x[1], x[0], x[2:]]),
]
_TWIST: list[Change] = [
    ("with the two halves of {} exchanged, as if it were [omega, v]", lambda x: np.roll(x, 3, axis=-1)),
    ("with the first half of {} left out", lambda x: x * [0, 0, 0, 1, 1, 1]),
    ("with the second half of {} left out", lambda x: x * [1, 1, 1, 0, 0, 0]),
    ("with the sign of the first half of {} reversed", lambda x: x * [-1, -1, -1, 1, 1, 1]),
    ("with the sign of the second half of {} reversed", lambda x: x * [1, 1, 1, -1, -1, -1]),
]
_SQUARE: list[Change] = [
    ("with {} transposed", np.transpose), ("with {} inverted", np.linalg.inv),
    ("with only the diagonal of {}", lambda x: np.diag(np.diag(x))),
    ("with the identity in place of {}", lambda x: np.eye(len(x))),
]
_COVARIANCE: list[Change] = [
    ("with the first three and the others of {} taken as independent", lambda P: _blocks(P, 3)),
    ("with the last six and the others of {} taken as independent", lambda P: _blocks(P, len(P) - 6)),
]

# --- results ----------------------------------------------------------------------------------------------

def result_changes(value: np.ndarray) -> Iterator[Change]:
    """(words, function of one result), for a result of this shape."""
    yield "with the opposite sign", np.negative
    yield "with zeros in place of the result", np.zeros_like
    yield "with the absolute value taken", np.abs
    yield "with the square root taken", np.sqrt
    yield "with the square taken", np.square
    yield "with 1 divided by each entry", lambda x: 1 / x
    yield "with twice the result", lambda x: 2 * x
    yield "with half of the result", lambda x: x / 2
    if value.ndim:
        yield "with only the first row returned", lambda x: x[:1]
        yield "with the first row left out", lambda x: x[1:]
        yield "with the last row left out", lambda x: x[:-1]
        yield "with the rows in reverse order", lambda x: x[::-1]
        yield "with the sum over the rows", lambda x: x.sum(axis=0)
        yield "with the mean over the rows", lambda x: x.mean(axis=0)
    if value.ndim == 1:
        yield "with the length of the vector", np.linalg.norm
        yield "with the vector divided by its length", lambda x: x / np.linalg.norm(x)
        yield "with the last entry left out", lambda x: x[:-1]
        yield "divided by the number of entries", lambda x: x / len(x)
        yield "with entries in another order (sorted)", np.sort
    if value.ndim >= 2:
        yield "with the result transposed", lambda x: np.swapaxes(x, -1, -2)
    if value.ndim == 2:
        for n in (3, 6):
            yield f"with the last {n} rows moved to the front", lambda x, n=n: np.roll(x, n, axis=0)
            yield f"with the first {n} rows moved to the end", lambda x, n=n: np.roll(x, -n, axis=0)
            yield f"with the last {n} columns moved to the front", lambda x, n=n: np.roll(x, n, axis=1)
    if value.ndim >= 2 and value.shape[-1] == value.shape[-2]:
        n = value.shape[-1]
        yield "with the inverse of the result", np.linalg.inv
        yield "with only the diagonal kept", lambda x: x * np.eye(x.shape[-1])
        yield "with the diagonal left out", lambda x: x * (1 - np.eye(x.shape[-1]))
        yield "with only the upper triangle filled", np.triu
        yield "with only the lower triangle filled", np.tril
        yield "with the lower triangle copied from the upper one without its sign", \
            lambda x: np.triu(x) + np.triu(x, 1).T
        yield "with the identity added", lambda x: x + np.eye(x.shape[-1])
        yield "with the identity subtracted", lambda x: x - np.eye(x.shape[-1])
        yield "with a one in the last corner", lambda x: _set(x, (-1, -1), 1.0)
        yield "with a zero in the last corner", lambda x: _set(x, (-1, -1), 0.0)
        if n == 4:
            yield "with the rotation block transposed", lambda x: _set(x, np.s_[..., :3, :3],
                                                                     np.swapaxes(x[..., :3, :3], -1, -2))
            yield "with the pose inverted", np.linalg.inv
            yield "with the translation left out", lambda x: _set(x, np.s_[..., :3, 3], 0.0)
