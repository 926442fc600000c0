"""Histories as one block of bytes and a header that says what stands where; the explorer and the browser unpack it.

Numbers are float32, ids int32. A covariance travels as standard deviations and the upper triangle of its correlation
in int16, 1 being 32767: half of what the matrix would take in float32, and exact to 2e-5 of the product of two sigmas.
"""

import json
from typing import Any

import numpy as np

from .. import se3
from ..plots import style
from ..simulate import IMAGE_SIZE
from .history import History, Snapshot, principal_sigmas

LIMIT = 1_000_000  # bytes of one explorer, header and data
ONE = 32767  # int16 of a correlation of 1


class Block:
    """Arrays one after the other, each at a multiple of four bytes."""

    def __init__(self):
        self.parts: list[bytes] = []
        self.size = 0

    def put(self, array, dtype) -> list:
        """Append an array; returns [dtype, first byte, number of entries] for the header."""
        flat = np.ascontiguousarray(array, dtype=np.dtype(dtype).newbyteorder("<")).ravel()
        content = flat.tobytes()
        at = [dtype, self.size, len(flat)]
        self.parts.append(content + bytes(-len(content) % 4))
        self.size += len(self.parts[-1])
        return at

    @property
    def data(self) -> bytes:
        """All of it."""
        return b"".join(self.parts)


def get(data: bytes, at: list) -> np.ndarray:
    """The array (n,) that `Block.put` left at `at`."""
    dtype, offset, n = at
    return np.frombuffer(data, np.dtype(dtype).newbyteorder("<"), n, offset)


def pack(histories: list[History], drive, start: int, landmark: int, show: int,
         quantity: str | None = None) -> tuple[dict[str, Any], bytes]:
    """The header (to be sent as JSON) and the data of an explorer.

    histories : one or two, of the same length. drive : for the truth. start : the snapshot to begin with.
    landmark : the chosen one, -1 for none. show : which history, or 2 for both side by side. quantity : the series
    that is drawn at first, by default the first one.
    Raises KeyError for a quantity that is not a series, and ValueError when the lengths differ or the result is larger
    than `LIMIT`.
    """
    lengths = [len(history.snapshots) for history in histories]
    if len(set(lengths)) > 1:
        raise ValueError(f"{histories[1].name}: {lengths[1]} {histories[1].unit}s, expected {lengths[0]} as in "
                         f"{histories[0].name}")
    if quantity is None:
        quantity = next((one.name for one in histories[0].series), "")
    else:
        histories[0][quantity]
    block = Block()
    ids = np.unique(np.concatenate([s.ids for h in histories for s in h.snapshots]
                                   + [s.sight.ids for h in histories for s in h.snapshots if s.sight]))
    header = {
        "n": lengths[0], "unit": histories[0].unit, "axis": histories[0].axis, "start": start, "landmark": landmark,
        "quantity": quantity, "show": show, "ids": ids.tolist(), "image": image_size(histories),
        "labels": [s.label for s in histories[0].snapshots],
        "updated": [int(s.updated) for s in histories[0].snapshots],
        "truth": truth(block, drive, ids, histories[0]), "colours": style.both_themes(),
        "runs": [run(block, history) for history in histories],
    }
    size = block.size + len(json.dumps(header))
    if size > LIMIT:
        raise ValueError(f"{size / 1e6:.1f} MB for {lengths[0]} {histories[0].unit}s, an explorer takes "
                         f"{LIMIT / 1e6:g} MB: give fewer steps (a slice of them), or a shorter drive")
    return header, block.data


def truth(block, drive, ids, history) -> dict[str, Any]:
    """True landmarks (the known map in odometry) and path, as far as the history goes; absent without truth."""
    found = {}
    if drive.has_true_landmarks:
        found["landmark"] = block.put(drive.true_landmarks[ids, :2], "f4")
    if drive.has_truth:
        found["path"] = block.put(drive.true_world_T_imu[:, :2, 3], "f4")
    return found


def image_size(histories) -> list[int]:
    """Width and height of the left image, px: the simulated camera's, or larger where a pixel lies outside."""
    pixels = [s.sight.measured for h in histories for s in h.snapshots if s.sight]
    largest = np.max(np.concatenate([*pixels, [IMAGE_SIZE]]), axis=0)
    return [int(np.ceil(edge)) for edge in largest]


def run(block: Block, history: History) -> dict[str, Any]:
    """One history in the header; its arrays go into the block."""
    snapshots = history.snapshots
    covariances = np.concatenate([s.landmark_covariance for s in snapshots])
    packed = {
        "name": history.name, "role": history.colour, "rows": history.rows, "captions": [s.caption for s in snapshots],
        "born": [s.born.tolist() for s in snapshots], "retired": [s.retired.tolist() for s in snapshots],
        "time": block.put([s.time for s in snapshots], "f4"),
        "first": block.put(np.cumsum([0] + [len(s.ids) for s in snapshots]), "i4"),
        "ids": block.put(np.concatenate([s.ids for s in snapshots]), "i4"),
        "landmark": block.put(np.concatenate([s.landmarks for s in snapshots]), "f4"),
        "block": block.put(covariances[:, [0, 0, 1], [0, 1, 1]], "f4"),
        "axes": block.put(principal_sigmas(covariances), "f4"),
        "pose": block.put([ground_pose(s.world_T_imu) for s in snapshots], "f4"),
        "inset": block.put([inset(snapshots, i) for i in range(len(snapshots))], "f4"),
        "series": [{"name": s.name, "unit": s.unit, "log": s.log,
                    **{key: block.put(getattr(s, key), "f4") for key in ("values", "low", "high")}}
                   for s in history.series],
        **sights(block, snapshots), **paths(block, snapshots),
    }
    matrices = [s.covariance for s in snapshots if s.covariance is not None]
    if len(matrices) == len(snapshots):
        sigma, correlation = zip(*map(split, matrices))
        packed |= {"sigma": block.put(np.concatenate(sigma), "f4"),
                   "correlation": block.put(np.concatenate(correlation), "i2")}
    return packed


def split(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (d,), and the upper triangle of the correlation in int16, row by row.

    covariance : (d, d). A variance of zero (or below it, which a wrong filter may reach) has no correlations.
    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    correlation = covariance * inverse[:, None] * inverse
    return sigma, np.rint(ONE * np.clip(correlation[np.triu_indices(len(sigma))], -1, 1)).astype(np.int16)


def ground_pose(world_T_imu: np.ndarray | None) -> list[float]:
    """x, y, z in m and the heading in rad; NaN for None."""
    if world_T_imu is None:
        return [np.nan] * 4
    return [*world_T_imu[:3, 3], np.arctan2(world_T_imu[1, 0], world_T_imu[0, 0])]


def inset(snapshots: tuple[Snapshot, ...], i: int) -> list[float]:
    """The pose of snapshot i magnified: 14 numbers in m and rad along the body axes of the snapshot it came from.

    Its own covariance of [forward, left] as xx, xy, yy and its sigma of the heading, the same of the snapshot that it
    came from (at the origin), position and heading, true position and heading. NaN where there is none.
    """
    now = snapshots[i]
    came_from = now if i == 0 else snapshots[i - 1]
    if not now.updated:  # a prediction is compared with the belief it came from, brought to where the car is now
        came_from = replace_pose(came_from, now)
    if now.world_T_imu is None or came_from.world_T_imu is None:
        return [np.nan] * 14
    origin_T_world = se3.inverse(came_from.world_T_imu)
    spreads = []
    for snapshot in (now, came_from):
        if snapshot.pose_covariance is None:
            spreads.append([np.nan] * 4)
            continue
        R = (origin_T_world @ snapshot.world_T_imu)[:3, :3]
        P = R @ snapshot.pose_covariance[:3, :3] @ R.T
        spreads.append([P[0, 0], P[0, 1], P[1, 1], np.sqrt(snapshot.pose_covariance[5, 5])])
    places = [[np.nan] * 3 if T is None else np.array(ground_pose(origin_T_world @ T))[[0, 1, 3]]
              for T in (now.world_T_imu, now.true_world_T_imu)]
    return [*spreads[0], *spreads[1], *places[0], *places[1]]


def replace_pose(snapshot: Snapshot, other: Snapshot) -> Snapshot:
    """A snapshot's covariance at the pose of another."""
    return Snapshot(snapshot.label, snapshot.time, snapshot.updated, snapshot.ids, snapshot.landmarks,
                    snapshot.landmark_covariance, other.world_T_imu, snapshot.pose_covariance)


def sights(block: Block, snapshots: tuple[Snapshot, ...]) -> dict[str, Any]:
    """The measurements: both snapshots of a frame point to the same rows, as [first, end) in `sight`.

    A row of `sights` has 13 numbers: u, v measured, predicted and projected; S of uu, uv, vv; NIS; 1 where the gate
    accepted it; its pull forward and left.
    """
    rows: list[tuple[int, int]] = []
    ids, numbers, kept = [], [], {}
    end = 0
    for snapshot in snapshots:
        sight = snapshot.sight
        if sight is None:
            rows.append((0, 0))
            continue
        if id(sight) not in kept:
            S = sight.covariance
            kept[id(sight)] = (end, end := end + len(sight.ids))
            ids.append(sight.ids)
            numbers.append(np.column_stack([
                sight.measured, sight.predicted, sight.projected, S[:, 0, 0], S[:, 0, 1], S[:, 1, 1], sight.nis,
                sight.accepted, sight.pulls]))
        rows.append(kept[id(sight)])
    if not ids:
        return {}
    return {"sight": block.put(rows, "i4"), "sight_ids": block.put(np.concatenate(ids), "i4"),
            "sights": block.put(np.concatenate(numbers), "f4")}


def paths(block: Block, snapshots: tuple[Snapshot, ...]) -> dict[str, Any]:
    """Paths that belong to single snapshots: x, y (m) and covariance of x, y (m^2) in the world."""
    lines = [s.path for s in snapshots if s.path is not None]
    spreads = [s.path_covariance for s in snapshots if s.path_covariance is not None]
    if len(lines) < len(snapshots):
        return {}
    places = np.concatenate(lines)
    packed = {"path_first": block.put(np.cumsum([0] + [len(line) for line in lines]), "i4"),
              "path": block.put(places[:, :2, 3], "f4")}
    if len(spreads) == len(snapshots):
        R = places[:, :3, :3]
        P = R @ np.concatenate(spreads)[:, :3, :3] @ np.swapaxes(R, -1, -2)
        packed["path_block"] = block.put(P[:, [0, 0, 1], [0, 1, 1]], "f4")
    return packed
