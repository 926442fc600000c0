"""Histories as one block of bytes and a header that says what stands where; the explorer and the browser unpack it.

Numbers are float32, ids int32. A covariance travels as standard deviations and the upper triangle of its correlation
in int16, 1 being 32767: half of what the matrix would take in float32, and exact to 2e-5 of the product of two sigmas.
"""

import json
from dataclasses import replace
from typing import Any

import numpy as np

from .. import se3
from ..plots import style
from ..simulate import IMAGE_SIZE
from .history import History, Snapshot, all_ids, principal_sigmas

LIMIT = 1_000_000  # bytes of one explorer, header and data
ONE = 32767  # int16 of a correlation of 1
LAYOUT = {  # of each array: its type, and the numbers of one of its rows; explorer.js has the same table
    "time": ("f4", ["time"]),
    "first": ("i4", ["row"]),  # of the landmarks of each snapshot in the next four
    "ids": ("i4", ["id"]),
    "landmark": ("f4", ["x", "y", "z"]),
    "block": ("f4", ["xx", "xy", "yy"]),  # covariance of the position in the world
    "axes": ("f4", ["longest", "middle", "shortest"]),  # sigma
    "triangulated": ("f4", ["xx", "xy", "yy"]),  # of the landmarks in the order of their births, for a known pose
    "pose": ("f4", ["x", "y", "z", "heading"]),
    "inset": ("f4", [  # the pose magnified: covariance and sigma of the heading, now and before; place, now and true
        "xx", "xy", "yy", "heading sigma", "before xx", "before xy", "before yy", "before heading sigma",
        "x", "y", "heading", "true x", "true y", "true heading"]),
    "sigma": ("f4", ["sigma"]),  # of each row of the joint covariance
    "correlation": ("i2", ["correlation"]),
    "sight": ("i4", ["first", "end"]),  # rows of the next two that belong to a snapshot
    "sight_ids": ("i4", ["id"]),
    "sights": ("f4", ["u", "v", "predicted u", "predicted v", "projected u", "projected v", "S uu", "S uv", "S vv",
                      "nis", "accepted", "pull forward", "pull left"]),
    "path_first": ("i4", ["row"]),  # of the path of each snapshot in the next two
    "path": ("f4", ["x", "y"]),
    "path_block": ("f4", ["xx", "xy", "yy"]),
    "truth": ("f4", ["x", "y"]),
    "series": ("f4", ["value"]),
}


class Block:
    """Arrays one after the other, each at a multiple of four bytes."""

    def __init__(self):
        self.parts: list[bytes] = []
        self.size = 0

    def put(self, name, array) -> list:
        """Append an array of `LAYOUT`; returns [dtype, first byte, number of entries] for the header."""
        dtype, row = LAYOUT[name]
        flat = np.reshape(array, (-1, len(row))).astype(np.dtype(dtype).newbyteorder("<")).ravel()
        content = flat.tobytes()
        at = [dtype, self.size, len(flat)]
        self.parts.append(content + bytes(-len(content) % 4))
        self.size += len(self.parts[-1])
        return at

    @property
    def data(self) -> bytes:
        """All of it."""
        return b"".join(self.parts)


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
    ids = all_ids(histories)
    header = {
        "n": lengths[0], "unit": histories[0].unit, "axis": histories[0].axis, "start": start, "landmark": landmark,
        "quantity": quantity, "show": show, "ids": ids.tolist(), "image": image_size(histories),
        "labels": [s.label for s in histories[0].snapshots],
        "stage": [s.stage for s in histories[0].snapshots],
        "truth": truth(block, drive, ids), "colours": style.both_themes(),
        "runs": [run(block, history) for history in histories]}
    size = block.size + len(json.dumps(header))
    if size > LIMIT:
        raise ValueError(f"{size / 1e6:.1f} MB for {lengths[0]} {histories[0].unit}s, an explorer takes "
                         f"{LIMIT / 1e6:g} MB: give fewer steps (a slice of them), or a shorter drive")
    return header, block.data


def truth(block, drive, ids) -> dict[str, Any]:
    """True landmarks (the known map in odometry) and path; absent without truth."""
    found = {}
    if drive.has_true_landmarks:
        found["landmark"] = block.put("truth", drive.true_landmarks[ids, :2])
    if drive.has_truth:
        found["path"] = block.put("truth", drive.true_world_T_imu[:, :2, 3])
    return found


def image_size(histories) -> list[int]:
    """Width and height of the left image, px: the simulated camera's, or larger where a pixel lies outside."""
    pixels = [s.sight.measured[:, :2] for h in histories for s in h.snapshots if s.sight]
    largest = np.max(np.concatenate([*pixels, [IMAGE_SIZE]]), axis=0)
    return [int(np.ceil(edge)) for edge in largest]


def run(block: Block, history: History) -> dict[str, Any]:
    """One history in the header; its arrays go into the block."""
    snapshots = history.snapshots
    packed = {
        "name": history.name, "role": history.colour, "rows": history.rows, "captions": [s.caption for s in snapshots],
        "born": [s.born.tolist() for s in snapshots], "retired": [s.retired.tolist() for s in snapshots],
        "series": [{"name": s.name, "unit": s.unit, "log": s.log, "stair": s.stair,
                    **{key: block.put("series", getattr(s, key)) for key in ("values", "low", "high")}}
                   for s in history.series]}
    covariances = np.concatenate([s.landmark_covariance for s in snapshots])
    arrays: dict[str, Any] = {
        "time": [s.time for s in snapshots],
        "first": np.cumsum([0] + [len(s.ids) for s in snapshots]),
        "ids": np.concatenate([s.ids for s in snapshots]),
        "landmark": np.concatenate([s.landmarks for s in snapshots]),
        "block": covariances[:, [0, 0, 1], [0, 1, 1]],
        "axes": principal_sigmas(covariances),
        "triangulated": np.concatenate([s.triangulated for s in snapshots])[:, [0, 0, 1], [0, 1, 1]],
        "pose": [ground_pose(s.world_T_imu) for s in snapshots],
        "inset": [inset(snapshots, i) for i in range(len(snapshots))],
        **sights(snapshots), **paths(snapshots)}
    if history.covariances:
        arrays["sigma"], arrays["correlation"] = map(np.concatenate, zip(*map(split, history.covariances)))
    return packed | {name: block.put(name, array) for name, array in arrays.items()}


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
    """The pose of snapshot i magnified, along the body axes of the snapshot that it came from (see `LAYOUT`).

    "Before" is the snapshot that it came from, at the origin; all in m and rad, NaN for what is not known.
    """
    now = snapshots[i]
    came_from = now if i == 0 else snapshots[i - 1]
    if not now.updated:  # a prediction is compared with the belief it came from, brought to where the car is now
        came_from = replace(came_from, world_T_imu=now.world_T_imu)
    if now.world_T_imu is None or came_from.world_T_imu is None:
        return [np.nan] * 14
    origin_T_world = se3.inverse(came_from.world_T_imu)
    spreads = []
    for snapshot in (now, came_from):
        R = (origin_T_world @ snapshot.world_T_imu)[:3, :3]
        own = np.full((6, 6), np.nan) if snapshot.pose_covariance is None else snapshot.pose_covariance
        P = R @ own[:3, :3] @ R.T
        spreads.append([P[0, 0], P[0, 1], P[1, 1], np.sqrt(own[5, 5])])
    places = [[np.nan] * 3 if T is None else np.array(ground_pose(origin_T_world @ T))[[0, 1, 3]]
              for T in (now.world_T_imu, now.true_world_T_imu)]
    return [*spreads[0], *spreads[1], *places[0], *places[1]]


def sights(snapshots: tuple[Snapshot, ...]) -> dict[str, Any]:
    """The measurements: both snapshots of a frame point to the same rows."""
    ids, numbers, at, rows, end = [], [], {}, [], 0
    for shot in snapshots:
        s = shot.sight
        if s is not None and id(s) not in at:
            at[id(s)] = (end, end := end + len(s.ids))
            ids.append(s.ids)
            numbers.append(np.column_stack([s.measured[:, :2], s.predicted[:, :2], shot.projected,
                                            s.covariance[:, [0, 0, 1], [0, 1, 1]], s.nis, s.accepted, shot.pulls]))
        rows.append(at.get(id(s), (0, 0)))
    return {"sight": rows, "sight_ids": np.concatenate(ids), "sights": np.concatenate(numbers)} if ids else {}


def paths(snapshots: tuple[Snapshot, ...]) -> dict[str, Any]:
    """Paths that belong to single snapshots: x, y (m) and covariance of x, y (m^2) in the world."""
    lines = [s.path for s in snapshots if s.path is not None]
    spreads = [s.path_covariance for s in snapshots if s.path_covariance is not None]
    if len(lines) < len(snapshots):
        return {}
    places = np.concatenate(lines)
    packed = {"path_first": np.cumsum([0] + [len(line) for line in lines]), "path": places[:, :2, 3]}
    if len(spreads) == len(snapshots):
        R = places[:, :3, :3]
        P = R @ np.concatenate(spreads)[:, :3, :3] @ np.swapaxes(R, -1, -2)
        packed["path_block"] = P[:, [0, 0, 1], [0, 1, 1]]
    return packed
