"""The course's dense array of tracks, (4, M, T), made into a `Drive`, which keeps only what was seen."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..drive import Drive, DriveError
from ..stereo import StereoCamera

_CHUNK = 1 << 20  # entries of the dense array looked at in one go: 32 MB


def drive_from_features(times: np.ndarray, twists: np.ndarray, features: np.ndarray, camera: StereoCamera,
                        **fields: Any) -> Drive:
    """A drive from the course's dense array.

    features : (4, M, T) px; an observation is missing when all its four numbers are NaN or all are -1;
    a landmark that comes back after a gap becomes another one.
    Other arguments as for `Drive`. The array is read in pieces, so little memory is needed beyond it.
    Raises DriveError also for an observation of which only some of the four numbers are missing.
    """
    features = np.asarray(features)
    n_frames = np.size(times)
    if features.ndim != 3 or features.shape[0] != 4 or features.shape[2] != n_frames:
        raise DriveError(f"features: shape {features.shape}, expected (4, landmarks, {n_frames}) "
                         f"for {n_frames} frames")
    if features.dtype.kind not in "fiu":
        raise DriveError(f"features: holds {features.dtype}, expected numbers")
    frame, landmark, pixels = _sparse(features)
    return _drive(times, twists, camera, frame, landmark, pixels, features.shape[1], fields)


def drive_from_pieces(times: np.ndarray, twists: np.ndarray, features: tuple[tuple[int, ...], Iterator[np.ndarray]],
                      camera: StereoCamera, **fields: Any) -> Drive | None:
    """As `drive_from_features`, from the array's shape and its numbers in C order, a piece at a time.

    None where something is wrong with the array (`drive_from_features` says what).
    """
    shape, pieces = features
    n_frames = np.size(times)
    if len(shape) != 3 or shape[0] != 4 or shape[2] != n_frames:
        return None
    plane = shape[1] * n_frames
    seen: list[list[np.ndarray]] = [[] for _ in range(4)]  # of each pixel coordinate: where it is a number, and which
    values: list[list[np.ndarray]] = [[] for _ in range(4)]
    absent = [np.zeros(plane // 8 + 1, np.uint8) for _ in range(4)]  # bits: where it is NaN
    start = 0
    for piece in pieces:
        while len(piece):
            row, at = divmod(start, plane)
            part, piece = piece[:plane - at], piece[plane - at:]
            nan = np.isnan(part)
            where = np.flatnonzero(~nan & (part != -1))
            seen[row].append(at + where)
            values[row].append(part[where].astype(float))
            np.bitwise_xor.at(absent[row], (at + np.flatnonzero(nan)) // 8, 1 << ((at + np.flatnonzero(nan)) % 8))
            start += len(part)
    index = [np.concatenate([np.empty(0, int), *parts]) for parts in seen]
    if not all(np.array_equal(index[0], other) for other in index) or any((absent[0] != a).any() for a in absent):
        return None
    pixels = np.stack([np.concatenate([np.empty(0), *parts]) for parts in values], axis=-1)
    if not np.isfinite(pixels).all():
        return None
    landmark, frame = np.divmod(index[0], n_frames)
    return _drive(times, twists, camera, frame, landmark, pixels, shape[1], fields)


def _drive(times: np.ndarray, twists: np.ndarray, camera: StereoCamera, frame: np.ndarray, landmark: np.ndarray,
           pixels: np.ndarray, n_landmarks: int, fields: dict[str, Any]) -> Drive:
    """The drive of observations in any order; where a landmark comes back, a new one begins, numbered after all others.

    A `Drive`'s tracks have no gaps: the filter drops a landmark that is out of view.
    """
    order = np.lexsort((frame, landmark))
    frame, landmark, pixels = frame[order], landmark[order], pixels[order]
    same = np.diff(landmark, prepend=-1) == 0
    returns = np.cumsum(same & (np.diff(frame, prepend=0) > 1))
    before = returns[np.flatnonzero(~same)][np.cumsum(~same) - 1]  # returns of all landmarks up to this one's start
    landmark = np.where(returns > before, n_landmarks - 1 + returns, landmark)
    new = int(returns.max(initial=0))
    if new:
        said = f"tracks with gaps: {new} times a landmark comes back, each time as a new one"
        fields = fields | {"history": (*fields.get("history", ()), said)}
    order = np.lexsort((landmark, frame))
    return Drive(times=times, twists=twists, camera=camera, landmark=landmark[order], pixels=pixels[order],
                 frame_start=np.searchsorted(frame[order], np.arange(np.size(times) + 1)),
                 n_landmarks=n_landmarks + new, **fields)


def _sparse(features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame (N,), landmark (N,) and pixels (N, 4) of all observations."""
    _, n_landmarks, n_frames = features.shape
    step = max(1, _CHUNK // max(1, n_frames))
    found = [(np.empty(0, int), np.empty(0, int), np.empty((0, 4)))]
    for start in range(0, n_landmarks, step):
        part = features[:, start:start + step]
        absent, unset = np.isnan(part), part == -1
        seen = ~(absent.all(axis=0) | unset.all(axis=0))
        partial = seen & (absent | unset).any(axis=0)
        if partial.any():
            i, k = np.argwhere(partial)[0]
            raise DriveError(f"features: landmark {start + i}, frame {k} is {part[:, i, k].tolist()}: "
                             f"only some of the four are missing; all must be -1 where nothing is seen")
        i, k = np.nonzero(seen)
        pixels = part[:, i, k].T.astype(float)
        if not np.isfinite(pixels).all():
            row = np.argwhere(~np.isfinite(pixels))[0, 0]
            raise DriveError(f"features: landmark {start + i[row]}, frame {k[row]} is "
                             f"{pixels[row].tolist()}, expected finite numbers")
        found.append((k, start + i, pixels))
    frame, landmark, pixels = (np.concatenate(parts) for parts in zip(*found))
    return frame, landmark, pixels
