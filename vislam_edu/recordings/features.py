"""The course's dense array of tracks, (4, M, T), made into a `Drive`, which keeps only what was seen."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..drive import Drive, DriveError
from ..stereo import StereoCamera

_CHUNK = 1 << 20  # entries of the dense array looked at in one go
_NUMBER, _NAN = 1, 16  # what one of the four counts for; four of them fit into a byte


def drive_from_features(times: np.ndarray, twists: np.ndarray, features: np.ndarray, camera: StereoCamera,
                        **fields: Any) -> Drive:
    """A drive from the course's dense array.

    features : (4, M, T) px; an observation is missing when all its four numbers are NaN or all are -1;
    a landmark that comes back after a gap becomes another one.
    Other arguments as for `Drive`. The array is read in pieces, so little memory is needed beyond it.
    Raises DriveError also for an observation of which only some of the four numbers are missing.
    """
    features = np.asarray(features)
    if features.dtype.kind not in "fiu":
        raise DriveError(f"features: holds {features.dtype}, expected numbers")
    step = max(1, _CHUNK // max(1, np.size(times)))
    pieces = (plane[i:i + step].ravel() for plane in features for i in range(0, len(plane), step))
    return drive_from_pieces(times, twists, features.shape, pieces, camera, **fields)


def drive_from_pieces(times: np.ndarray, twists: np.ndarray, shape: tuple[int, ...], pieces: Iterable[np.ndarray],
                      camera: StereoCamera, **fields: Any) -> Drive:
    """As `drive_from_features`, from the array's shape and its numbers in C order, a piece at a time."""
    n_frames = np.size(times)
    if len(shape) != 3 or shape[0] != 4 or shape[2] != n_frames:
        raise DriveError(f"features: shape {shape}, expected (4, landmarks, {n_frames}) for {n_frames} frames")
    plane = shape[1] * n_frames
    count = np.zeros(plane, np.uint8)  # of each landmark and frame, over its four coordinates
    values: list[list[np.ndarray]] = [[np.empty(0)] for _ in range(4)]
    start = 0
    for piece in pieces:
        while len(piece):
            row, at = divmod(start, plane)
            part, piece = piece[:plane - at], piece[plane - at:]
            nan = np.isnan(part)
            number = ~nan & (part != -1)
            count[at:at + len(part)] += np.where(nan, np.uint8(_NAN), number)
            values[row].append(part[number].astype(float))
            start += len(part)
    partial = np.flatnonzero((count != 0) & (count != 4 * _NUMBER) & (count != 4 * _NAN))
    if partial.size:
        i, k = divmod(int(partial[0]), n_frames)
        raise DriveError(f"features: landmark {i}, frame {k}: only some of its four numbers are missing; all must be "
                         "-1 where nothing is seen")
    landmark, frame = np.divmod(np.flatnonzero(count == 4 * _NUMBER), n_frames)
    pixels = np.stack([np.concatenate(parts) for parts in values], axis=-1)
    for row in np.flatnonzero(~np.isfinite(pixels).all(axis=1))[:1]:
        raise DriveError(f"features: landmark {landmark[row]}, frame {frame[row]} is {pixels[row].tolist()}, "
                         "expected finite numbers")
    return _without_gaps(frame, landmark, pixels, shape[1], times=times, twists=twists, camera=camera, **fields)


def _without_gaps(frame: np.ndarray, landmark: np.ndarray, pixels: np.ndarray, n_landmarks: int,
                  **fields: Any) -> Drive:
    """The drive of observations by landmark and frame; where a landmark comes back, a new one begins, after all others.

    A `Drive`'s tracks have no gaps: the filter drops a landmark that is out of view.
    """
    same = np.diff(landmark, prepend=-1) == 0
    returns = np.cumsum(same & (np.diff(frame, prepend=0) > 1))
    before = returns[np.flatnonzero(~same)][np.cumsum(~same) - 1]  # returns of all landmarks up to this one's start
    landmark = np.where(returns > before, n_landmarks - 1 + returns, landmark)
    new = int(returns.max(initial=0))
    if new:
        said = f"tracks with gaps: {new} times a landmark comes back, each time as a new one"
        fields["history"] = (*fields.get("history", ()), said)
    order = np.lexsort((landmark, frame))
    return Drive(landmark=landmark[order], pixels=pixels[order], n_landmarks=n_landmarks + new,
                 frame_start=np.searchsorted(frame[order], np.arange(np.size(fields["times"]) + 1)), **fields)
