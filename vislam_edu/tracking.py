"""From images to tracks: corners, pyramidal Lucas-Kanade, the stereo match, births and ends of tracks.

    for frame in tracking.track(pairs, rig):
        frame.ids, frame.pixels

Points are pixels (x, y) = (u, v), column first; the centre of the image's first pixel is (0, 0). Images are grey,
(height, width), of any type of number. Points are followed in the images as they were taken: a distorted camera's
points are rectified (`lens`), its images never are.

Sources: Shi, Tomasi, Good features to track (1994); Lucas, Kanade, An iterative image registration technique (1981);
Bouguet, Pyramidal implementation of the Lucas Kanade feature tracker (2000).

>>> import numpy as np
>>> corners(np.pad(np.full((20, 30), 200.0), 20), 4).tolist()
[[21.0, 21.0], [48.0, 21.0], [21.0, 38.0], [48.0, 38.0]]
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from .lens import Rig

Levels = tuple[np.ndarray, ...]
Found = tuple[np.ndarray, np.ndarray]  # points (n, 2) px of another image, and ok (n,) bool
Flow = Callable[..., Found]

HALF = 7  # px: a patch has 2 HALF + 1 = 15 rows and columns, on every level of the pyramid
_BLUR = np.array([1, 4, 6, 4, 1], np.float32) / 16  # takes away what half as many pixels could not show
_ITERATIONS, _AFFINE_ITERATIONS, _SMALL_STEP = 15, 4, 0.01  # the last in px
_FLAT = 3.0  # grey values squared per px^2, the smaller eigenvalue of the mean structure tensor: too flat to follow
_MEET = 0.2  # px: forth and back must end this near to the start
_ALIKE = 0.9  # correlation of the two patches, at least
_GREY_PER_SHEAR = (5.0 / 0.1)**2  # a noise of 5 grey values over a prior of 0.1
_COARSE = 2  # level of the pyramid on which a new point's disparity is searched


def pyramid(image: np.ndarray | Levels, levels: int = 6) -> Levels:
    """The image, then each level half the size of the one before: pixel x of a level is pixel 2 x of the one before.

    image : (h, w), or a pyramid, which comes back as it is. Returns `levels` arrays of float32, fewer for small images.
    """
    if isinstance(image, tuple):
        return image
    grey = [np.asarray(image, np.float32)]
    while len(grey) < levels and min(grey[-1].shape) > HALF:
        rows = ndimage.correlate1d(grey[-1], _BLUR, axis=0, mode="nearest")[::2]
        grey.append(np.ascontiguousarray(ndimage.correlate1d(rows, _BLUR, axis=1, mode="nearest")[:, ::2]))
    return tuple(grey)


def structure_tensor(image: np.ndarray, size: int = 5) -> np.ndarray:
    """Mean over a square of the outer product of the gradient with itself: the information of the square's position.

    image : (h, w). size : rows and columns of the square. Returns (h, w, 2, 2), in (grey values / px)^2.
    """
    gv, gu = np.gradient(np.asarray(image, np.float32))
    uu, uv, vv = (ndimage.uniform_filter(product, size, mode="nearest") for product in (gu * gu, gu * gv, gv * gv))
    return np.stack([uu, uv, uv, vv], axis=-1).reshape(*uu.shape, 2, 2)


def smaller_eigenvalue(tensor: np.ndarray) -> np.ndarray:
    """Of symmetric matrices (..., 2, 2): (...), the information in the direction that is known worst."""
    half_difference = (tensor[..., 0, 0] - tensor[..., 1, 1]) / 2
    return tensor[..., 0, 0] - half_difference - np.hypot(half_difference, tensor[..., 0, 1])


def corners(image: np.ndarray | Levels, n: int, distance: int = 10, quality: float = 0.01,
            taken: ArrayLike = ()) -> np.ndarray:
    """The n best corners (Shi-Tomasi): where the smaller eigenvalue of the structure tensor is largest.

    distance : px, none is nearer to another one, or to a point of taken (m, 2). quality : smallest eigenvalue that is
    used, as a share of the image's largest. Returns (n, 2) px, best first, or fewer where there are not so many.
    """
    score = smaller_eigenvalue(structure_tensor(pyramid(image)[0]))
    score[:HALF], score[-HALF:], score[:, :HALF], score[:, -HALF:] = 0, 0, 0, 0
    best = (score == ndimage.maximum_filter(score, 2 * distance + 1)) & (score > max(quality * score.max(), _FLAT))
    points = np.argwhere(best)[np.argsort(-score[best], kind="stable"), ::-1].astype(float)
    apart = np.abs(points[:, None] - np.reshape(taken, (-1, 2))).max(axis=-1, initial=0) > distance
    return points[apart.all(axis=1)][:n]


def patches(image: np.ndarray, points: np.ndarray, half: int) -> np.ndarray:
    """Squares (..., 2 half + 1, 2 half + 1) around points (..., 2) px, interpolated bilinearly; edges are repeated."""
    whole = np.floor(points)
    fraction = (points - whole).astype(np.float32)[..., None, None]
    along = whole.astype(int)[..., None] + np.arange(-half, half + 2)
    u, v = along[..., 0, :].clip(0, image.shape[1] - 1), along[..., 1, :].clip(0, image.shape[0] - 1)
    grey = image.ravel()[v[..., :, None] * image.shape[1] + u[..., None, :]]
    du, dv = fraction[..., 0, :, :], fraction[..., 1, :, :]
    rows = grey[..., :-1, :] + dv * (grey[..., 1:, :] - grey[..., :-1, :])
    return rows[..., :-1] + du * (rows[..., 1:] - rows[..., :-1])


def inside(image: np.ndarray, points: np.ndarray, margin: int) -> np.ndarray:
    """(...) bool: which points (..., 2) are so far inside the image that a patch of that half size is. NaN: False."""
    return np.all((points >= margin) & (points < np.array(image.shape[::-1]) - margin - 1), axis=-1)


def lucas_kanade(image: np.ndarray, other: np.ndarray, points: np.ndarray, start: np.ndarray,
                 margin: int = HALF) -> Found:
    """Gauss-Newton on the grey values of one level: points of `image` found in `other`, from `start` on.

    Minimises sum (other(x + d) - image(p + d))^2 over x, d the pixels of the patch. The gradient g is the image's own,
    so A = sum g g^T is made once: x += A^-1 sum g (image - other). points, start, found : (n, 2) px; ok : (n,).
    """
    found = np.array(start, float)
    ok = inside(image, points, margin) & inside(other, found, margin)
    template, g = _template(image, np.where(ok[:, None], points, 0))
    g = g - g.mean(axis=(1, 2), keepdims=True)  # a constant added to all grey values then changes nothing
    A = np.einsum("nijp,nijq->npq", g, g)
    ok &= smaller_eigenvalue(A) > _FLAT * (2 * HALF + 1)**2
    A_inverse = np.linalg.inv(np.where(ok[:, None, None], A, np.eye(2)))
    active = np.flatnonzero(ok)
    for _ in range(_ITERATIONS):
        residual = template[active] - patches(other, found[active], HALF)
        step = np.einsum("npq,nq->np", A_inverse[active], np.einsum("nijp,nij->np", g[active], residual))
        found[active] += step
        ok[active] = inside(other, found[active], margin)
        active = active[ok[active] & (np.abs(step).max(axis=-1) > _SMALL_STEP)]
    return found, ok


def affine(image: np.ndarray, other: np.ndarray, points: np.ndarray, start: np.ndarray) -> Found:
    """`lucas_kanade` for patches that may also grow, turn and shear: other(x + M d) is compared with image(p + d).

    A patch that grows pulls the translation towards the side with more texture, the same way in each frame: a track
    would drift. Six numbers a patch, x and M; a prior holds M within 0.1 of the identity where texture says little.
    points, start : (n, 2) px, right to about a pixel. Returns (found (n, 2), ok (n,)): whether the patches are alike.
    Source: Shi, Tomasi, section 4; Baker, Matthews, Lucas-Kanade 20 years on (2004).
    """
    d = np.arange(-HALF, HALF + 1.0)
    basis = np.stack(np.broadcast_arrays(1.0, d, d[:, None]), axis=-1)  # 1, du, dv of each pixel
    template, g = _template(image, points)
    J = (g[..., :, None] * basis[..., None, :].astype(np.float32)).reshape(len(points), (2 * HALF + 1)**2, 6)
    J -= J.mean(axis=1, keepdims=True)
    A = J.mT @ J + np.diag(np.tile([0.0, _GREY_PER_SHEAR, _GREY_PER_SHEAR], 2))
    warp = np.where([True, False, False], start[:, :, None], level := np.eye(2, 3, 1))  # M = I
    prior = _GREY_PER_SHEAR * np.array([0.0, 1.0, 1.0])
    for _ in range(_AFFINE_ITERATIONS):
        seen = ndimage.map_coordinates(other, np.einsum("nap,ijp->anij", warp, basis)[::-1], order=1, mode="nearest")
        pull = np.einsum("nmk,nm->nk", J, (template - seen).reshape(J.shape[:2]))
        warp = warp + np.linalg.solve(A, (pull - (prior * (warp - level)).reshape(-1, 6))[..., None]).reshape(-1, 2, 3)
    a, b = (patch - patch.mean(axis=(1, 2), keepdims=True) for patch in (template, seen))
    alike = np.einsum("nij,nij->n", a, b) > _ALIKE * np.sqrt((a * a).sum(axis=(1, 2)) * (b * b).sum(axis=(1, 2)))
    return warp[:, :, 0], alike & (np.hypot(*(warp[:, :, 0] - start).T) < 1.0)


def _template(image: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches around points, (n, s, s), and their gradients, (n, s, s, 2)."""
    wide = patches(image, points, HALF + 1)
    g = np.stack([wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2], wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]], axis=-1) / 2
    return wide[:, 1:-1, 1:-1], g


def _one_way(levels: Levels, other: Levels, points: np.ndarray, guess: np.ndarray) -> Found:
    """From the coarsest level to the image: each level's result, times two, is the next one's start."""
    found, ok = np.array(guess, float), np.zeros(len(points), bool)
    for level in reversed(range(len(levels))):
        result, ok = lucas_kanade(levels[level], other[level], points / 2**level, found / 2**level,
                                  0 if level else HALF)
        found = np.where(ok[:, None], result * 2**level, found)  # what a coarse level loses a finer one may find
    found[ok], ok[ok] = affine(levels[0], other[0], points[ok], found[ok])
    return found, ok & inside(other[0], found, HALF)


def flow(image: np.ndarray | Levels, other: np.ndarray | Levels, points: ArrayLike,
         guess: ArrayLike | None = None) -> Found:
    """Where points of one image are in another one: pyramidal Lucas-Kanade, checked by going back.

    image, other : (h, w), or their `pyramid`. points : (n, 2) px. guess : (n, 2) px, where in `other` to begin, by
    default at the points. Returns (found (n, 2) px, ok (n,)). ok is False where a patch leaves an image or has too
    little texture, where the two patches differ, and where the way back from `found` ends 0.2 px away or more.
    """
    levels, other_levels, points = pyramid(image), pyramid(other), np.reshape(np.asarray(points, float), (-1, 2))
    start = points if guess is None else np.reshape(np.asarray(guess, float), (-1, 2))
    found, ok = _one_way(levels, other_levels, points, start)
    back, ok_back = _one_way(other_levels, levels, found, points + found - start)
    return found, ok & ok_back & (np.hypot(*(back - points).T) < _MEET)


@dataclass(frozen=True, eq=False)
class Frame:
    """What a pair shows: ids ascending, points px as taken and rectified; n_landmarks ids were given so far."""
    ids: np.ndarray  # (n,)
    left: np.ndarray  # (n, 2)
    right: np.ndarray  # (n, 2)
    pixels: np.ndarray  # (n, 4)
    n_landmarks: int


def search(left: Levels, right: Levels, points: np.ndarray, rig: Rig, nearest: float) -> np.ndarray:
    """Where in the right image points (n, 2) of the left one are, to a few pixels: the best along the epipolar line.

    On a coarse level, patches less their mean are compared at all disparities from 0 to that of `nearest` m.
    """
    K, level, half = rig.camera.K, min(_COARSE, len(left) - 1), HALF // 2 + 1
    disparities = np.arange(0.0, K[0, 0] * rig.camera.baseline / nearest, 2**level)[:, None]
    candidates = rig.right.unrectify(rig.left.rectify(points, K)[:, None] - disparities * [1.0, 0.0], K)
    possible = inside(right[level], candidates / 2**level, half)
    differences = patches(right[level], np.where(possible[..., None], candidates / 2**level, half), half)
    differences -= patches(left[level], points / 2**level, half)[:, None]
    cost = np.where(possible, differences.var(axis=(-2, -1)), np.inf)
    return candidates[np.arange(len(points)), cost.argmin(axis=1)]


def track(pairs: Iterable[tuple[np.ndarray, np.ndarray]], rig: Rig, *, visible: int = 150, distance: int = 15,
          rows_agree: float = 1.0, nearest: float = 2.0, flow: Flow = flow, after: Frame | None = None
          ) -> Iterator[Frame]:
    """Turns pairs of images into tracks: yields one `Frame` per pair, in which ids that stay are the same landmark.

    A track ends for good where `flow` loses it, from one left image to the next or from left to right, where rectified
    rows differ by more than rows_agree px, and where the disparity is not that of a depth beyond `nearest` m. Where a
    fifth of the tracks is missing, new ones begin, up to `visible`, at least `distance` px from all others.
    flow : this file's, or a faster one of the same arguments. after : a Frame of an earlier run, to go on from; the
    first of the pairs is then its own, and is not yielded again.
    """
    before, last = None, after
    for pair in pairs:
        left, right = (pyramid(image) for image in pair)
        if before is not None or last is None:
            ids, points, guess, n = np.empty(0, int), np.empty((0, 2)), np.empty((0, 2)), 0
            if last is not None:
                points, ok = flow(before, left, last.left)
                ids, guess, points = last.ids[ok], (points + last.right - last.left)[ok], points[ok]
                n = last.n_landmarks
            if (missing := visible - len(ids)) > visible // 5:
                new = corners(left, missing, distance, taken=points)
                ids, points = np.concatenate([ids, n + np.arange(len(new))]), np.concatenate([points, new])
                guess = np.concatenate([guess, search(left, right, new, rig, nearest)])
            in_right, ok = flow(left, right, points, guess)
            pixels = rig.measurements(points, in_right)
            disparity = pixels[:, 0] - pixels[:, 2]
            ok &= (np.abs(pixels[:, 1] - pixels[:, 3]) <= rows_agree) & (disparity > 0)
            ok &= disparity < rig.camera.K[0, 0] * rig.camera.baseline / nearest
            old, born = ids[ok & (ids < n)], int((ok & (ids >= n)).sum())  # a corner without a match gets no number
            last = Frame(np.concatenate([old, n + np.arange(born)]), points[ok], in_right[ok], pixels[ok], n + born)
            yield last
        before = left


def as_fields(frames: Iterable[Frame]) -> dict[str, Any]:
    """The frames of `track` as those fields of a `Drive` that tracks make."""
    ids, pixels, n_landmarks = zip(*((frame.ids, frame.pixels, frame.n_landmarks) for frame in frames))
    return {"frame_start": np.cumsum([0, *map(len, ids)]), "landmark": np.concatenate(ids),
            "pixels": np.concatenate(pixels), "n_landmarks": n_landmarks[-1]}
