"""The history of a filter as a list of snapshots: what the explorer shows, before it is packed for the browser.

A frame of a filter gives two snapshots, its belief before and after the update, and a third where landmarks are born.
A batch estimate gives one per iteration, a loop closure one per pair that is fused.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import kalman, metrics, se3
from ..belief import Belief, Innovation, Step
from ..drive import Drive
from ..error_state import ErrorState, fitting, right_pose_covariance, to_right, world_landmark_covariance
from ..stereo import FOUR_FROM_THREE

NOBODY = np.empty(0, int)
STAGES = ("predicted", "updated", "born")
MOTION_ROWS = ["v x", "v y", "v z", "ω x", "ω y", "ω z", "bias x", "bias y", "bias z"]
POSE_STAYS, MAP_STAYS = "the pose stays as it was", "no landmark ellipse changes"
POSE_ERRORS = [("forward", 0, 1.0, "m"), ("left", 1, 1.0, "m"), ("heading", 5, 180 / np.pi, "°")]


@dataclass(frozen=True, eq=False)
class PathBelief:
    """An estimate of a whole path and a map, as a batch estimate has after each iteration.

    path : (P, 4, 4), world_T_imu. ids : (n,), landmarks : (n, 3) m, landmark_covariance : (n, 3, 3) m^2, world.
    path_covariance : (P, 6, 6) of each pose as a right perturbation, m and rad, or None.
    covariance : (3n+6, 3n+6), order [landmarks, last pose], or None where the joint covariance is not computed.
    """

    path: np.ndarray
    ids: np.ndarray
    landmarks: np.ndarray
    landmark_covariance: np.ndarray
    path_covariance: np.ndarray | None = None
    covariance: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One state of an estimate, everything in world coordinates.

    label : where it stands in the history. caption : what led to it, in words, without the label.
    time : s, or its number. stage : its place in `STAGES`. frame : of the drive.
    ids : (n,). landmarks : (n, 3) m. landmark_covariance : (n, 3, 3) m^2, of the positions in the world.
    world_T_imu : (4, 4) or None. pose_covariance : (6, 6) as a right perturbation, or None.
    covariance : (3n+t, 3n+t) in the filter's own coordinates, or None. true_world_T_imu : (4, 4) or None.
    sight : the measurements, or None. projected : (m, 2) px, where the posterior puts them in the left image.
    pulls : (m, 2) m, what each adds to the correction of the position, along the predicted body axes [forward, left];
    zero where the gate kept it out. born, retired : ids.
    triangulated : (b, 3, 3) m^2, covariance that the landmarks born here would have if the pose were known exactly.
    path : (P, 4, 4) and path_covariance : (P, 6, 6), or None where the path is that of the snapshots before.
    """

    ids: np.ndarray
    landmarks: np.ndarray
    landmark_covariance: np.ndarray
    label: str = ""
    time: float = 0.0
    world_T_imu: np.ndarray | None = None
    pose_covariance: np.ndarray | None = None
    covariance: np.ndarray | None = None
    true_world_T_imu: np.ndarray | None = None
    sight: Innovation | None = None
    projected: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    pulls: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    born: np.ndarray = field(default_factory=lambda: NOBODY)
    retired: np.ndarray = field(default_factory=lambda: NOBODY)
    triangulated: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 3)))
    path: np.ndarray | None = None
    path_covariance: np.ndarray | None = None
    caption: str = ""
    stage: int = 1
    frame: int = 0

    @property
    def updated(self) -> bool:
        """Whether it is a posterior."""
        return self.stage > 0


@dataclass(frozen=True, eq=False)
class Series:
    """A number through the snapshots (n,), and the band in which it should lie: low and high (n,). NaN: no value.

    unit : or the value that an honest filter has in the mean. log : whether it is drawn on a logarithmic scale.
    stair : whether predictions are drawn as well as updates.
    """

    name: str
    unit: str
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    log: bool = False
    stair: bool = False


@dataclass(frozen=True, eq=False)
class History:
    """One run: its snapshots, and what is shown of it through time.

    name : of the run. colour : its key in `style.COLOURS`. unit : what one snapshot is ("half-step", "iteration").
    axis : what `Snapshot.time` counts. rows : names of the rows of the covariance, those of one landmark first.
    """

    name: str
    colour: str
    unit: str
    axis: str
    rows: tuple[list[str], list[str]]
    snapshots: tuple[Snapshot, ...]
    series: tuple[Series, ...]

    def __getitem__(self, name: str) -> Series:
        """The series of this name. Raises KeyError with the names that there are."""
        for one in self.series:
            if one.name == name:
                return one
        raise KeyError(f"{name!r} is not among {[one.name for one in self.series]}")

    def at(self, frame: int, stage: int = len(STAGES) - 1) -> int:
        """Number of the last snapshot up to this frame and stage."""
        return sum((s.frame, s.stage) <= (frame, stage) for s in self.snapshots) - 1

    @property
    def covariances(self) -> list[np.ndarray]:
        """The joint covariance of each snapshot; [] where one has none."""
        found = [s.covariance for s in self.snapshots if s.covariance is not None]
        return found if len(found) == len(self.snapshots) else []


def all_ids(histories: Sequence[History]) -> np.ndarray:
    """(n,) ids of all landmarks that some snapshot holds or its cameras saw, ascending."""
    shots = [s for one in histories for s in one.snapshots]
    return np.unique(np.concatenate([s.ids for s in shots] + [s.sight.ids for s in shots if s.sight]))


def from_steps(name: str, steps: Iterable[Step], drive: Drive, error_state: ErrorState | None = None, *,
               world_T_imu: np.ndarray | None = None, births: Collection[int] = ()) -> History:
    """The history of a filter: of each step its prior, its posterior, and that again with the landmarks born last.

    steps : `Step`s whose beliefs are a joint `Belief`, a `MapBelief` or a `PoseBelief`.
    drive : the Drive they were run on; its true landmarks are the known map of a filter that estimates a pose only.
    error_state : that of a joint filter, by default `error_state.fitting`.
    world_T_imu : (T, 4, 4), the poses that were given to a filter which estimates a map only.
    births : frames that get a snapshot of the births even where this filter has none there, as another filter has.
    Raises ValueError for an empty history.
    """
    steps = tuple(steps)
    if not steps:
        raise ValueError(f"{name or 'history'}: an explorer needs at least one step")
    error_state = error_state or fitting(steps[0].posterior)
    snapshots: list[Snapshot] = []
    beliefs: list[Any] = []
    nis, numbers = [np.nan], [np.nan]
    for step in steps:
        truth = drive.true_world_T_imu[step.k] if drive.has_truth else None
        pose = None if world_T_imu is None else world_T_imu[step.k]
        new, after = born_last(step), of_belief(step.posterior, error_state, pose)
        seen, (value, count) = look(step, after, drive, error_state, pose), frame_nis(step, drive, error_state, pose)
        half_steps = [(step.prior, of_belief(step.prior, error_state, pose), np.setdiff1d(step.born, new)),
                      (step.posterior, without(after, new), NOBODY), (step.posterior, after, new)]
        for stage, (belief, now, born) in enumerate(half_steps[:3 if len(new) or step.k in births else 2]):
            now = replace(now, **seen, time=float(step.time), stage=stage, frame=step.k, born=born,
                          label=f"frame {step.k}, {step.time:.1f} s, {STAGES[stage]}",
                          retired=NOBODY if stage else step.retired, true_world_T_imu=truth)
            if len(born) and hasattr(belief, "points"):
                now = replace(now, triangulated=given_the_pose(belief, error_state)[np.searchsorted(now.ids, born)])
            snapshots.append(replace(now, caption=describe(snapshots[-1] if snapshots else None, now, pose is None)))
            beliefs.append(belief)
            nis.append(value)
            numbers.append(count)
    # Until the update of a frame, the NIS of the frame before stands.
    honest = Series("NIS / landmark", "4 is honest", 4 * np.divide(nis, numbers)[:-1], *4 * nis_band(numbers[:-1]))
    series = [*pose_series(snapshots), honest]
    if truth is not None and snapshots[0].pose_covariance is not None:
        series.insert(-1, nees_series(beliefs, snapshots, error_state))
    return History(name, error_state.role, "half-step", "time (s)", row_names(snapshots, error_state),
                   tuple(snapshots), tuple(series))


def from_beliefs(labels: Sequence[str], beliefs: Sequence[Any], drive: Drive, *, name: str, unit: str,
                 error_state: ErrorState | None = None, frames: Sequence[int] | None = None,
                 captions: Sequence[str] = (), series: Mapping[str, Sequence[float]] | None = None) -> History:
    """A history of single beliefs, one snapshot each; arguments as in `Explorer.from_beliefs`."""
    if not len(beliefs) or len(beliefs) != len(labels):
        raise ValueError(f"{len(labels)} labels for {len(beliefs)} beliefs: give one each, and at least one")
    error_state = error_state or fitting(beliefs[0])
    frames = [drive.n_frames - 1] * len(beliefs) if frames is None else frames
    snapshots: list[Snapshot] = []
    for i, (label, belief, k) in enumerate(zip(labels, beliefs, frames)):
        truth = drive.true_world_T_imu[k] if drive.has_truth else None
        now = replace(of_belief(belief, error_state), label=label, time=float(i), true_world_T_imu=truth)
        before = snapshots[-1] if snapshots else None
        if before is not None:
            now = replace(now, born=np.setdiff1d(now.ids, before.ids), retired=np.setdiff1d(before.ids, now.ids))
        snapshots.append(replace(now, caption=captions[i] if captions else describe(before, now, True)))
    nothing = np.full(len(beliefs), np.nan)
    given = [Series(key, "", np.asarray(values, float), nothing, nothing,
                    log=bool(np.nanmax(values) > 100 * np.nanmin(values) > 0))
             for key, values in (series or {}).items()]
    return History(name, "slam", unit, unit, row_names(snapshots, error_state), tuple(snapshots),
                   (*given, *pose_series(snapshots)))


def of_belief(belief, error_state, pose=None) -> Snapshot:
    """A belief of any of the filters as a snapshot without its place in the history. pose : (4, 4), given, or None."""
    if isinstance(belief, PathBelief):
        last = None if belief.path_covariance is None else belief.path_covariance[-1]
        return Snapshot(belief.ids, belief.landmarks, belief.landmark_covariance, world_T_imu=belief.path[-1],
                        pose_covariance=last, covariance=belief.covariance, path=belief.path,
                        path_covariance=belief.path_covariance)
    if hasattr(belief, "seen"):
        ids = np.flatnonzero(belief.seen)
        return Snapshot(ids, belief.landmarks[ids], belief.covariance[ids], world_T_imu=pose)
    if not hasattr(belief, "ids"):
        return Snapshot(NOBODY, np.empty((0, 3)), np.empty((0, 3, 3)), world_T_imu=belief.world_T_imu,
                        pose_covariance=belief.covariance, covariance=belief.covariance)
    return Snapshot(belief.ids, belief.landmarks, world_landmark_covariance(belief, error_state),
                    world_T_imu=belief.world_T_imu, covariance=belief.covariance,
                    pose_covariance=right_pose_covariance(belief, error_state))


def born_last(step: Step) -> np.ndarray:
    """Ids of the landmarks that were born after the step's update: a prior that holds them was born with them."""
    known = np.flatnonzero(step.prior.seen) if hasattr(step.prior, "seen") else getattr(step.prior, "ids", NOBODY)
    return np.setdiff1d(step.born, known)


def without(now: Snapshot, ids: np.ndarray) -> Snapshot:
    """The snapshot before these were born, exactly: a birth adds rows, and changes none that are there."""
    stay, P = ~np.isin(now.ids, ids), now.covariance
    if P is not None:
        rows = np.append(np.repeat(stay, 3), np.ones(len(P) - 3 * len(stay), bool))
        P = P[np.ix_(rows, rows)]
    return replace(now, ids=now.ids[stay], landmarks=now.landmarks[stay], covariance=P,
                   landmark_covariance=now.landmark_covariance[stay])


def given_the_pose(belief: Belief, error_state: ErrorState) -> np.ndarray:
    """(n, 3, 3) m^2: covariance of each landmark's position in the world if the pose were known exactly.

    For a landmark that was just born this is its triangulation alone; the rest of its covariance is the pose's share.
    """
    P, pose, n = belief.covariance, belief.pose, 3 * len(belief.ids)
    known = np.zeros_like(P)
    known[:n, :n] = P[:n, :n] - P[:n, pose] @ np.linalg.pinv(P[pose, pose], hermitian=True) @ P[pose, :n]
    return world_landmark_covariance(replace(belief, covariance=known), error_state)


def jacobian(belief, innovation, drive, error_state, pose):
    """H (n, 4, d) of an innovation's measurements by the error of the belief, for any of the filters' beliefs."""
    camera, ids = drive.camera, innovation.ids
    n, each = len(ids), np.arange(len(innovation.ids))
    if hasattr(belief, "seen"):
        H = np.zeros((n, 4, n, 3))
        H[each, :, each] = camera.landmark_jacobian(pose, belief.landmarks[ids])
        return H.reshape(n, 4, 3 * n)
    if not hasattr(belief, "ids"):
        return camera.pose_jacobian(belief.world_T_imu, drive.true_landmarks[ids])
    rows = np.searchsorted(belief.ids, ids)
    _, H_landmark, H_pose = error_state.measure(camera, belief.world_T_imu, belief.points[rows])
    d = 3 * len(belief.ids)
    H = np.zeros((n, 4, len(belief.covariance)))
    H[:, :, :d].reshape(n, 4, -1, 3)[each, :, rows] = H_landmark[:, FOUR_FROM_THREE]
    H[:, :, d:d + 6] = H_pose[:, FOUR_FROM_THREE]
    return H


def joint(step, drive, error_state, rows, pose=None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Some measurements of a step's frame together, rows (n,) bool: they share the errors of the prior.

    pose : (4, 4), where it was given to the filter. Returns the prior covariance P (d, d), H (m, d), S (m, m) px^2 =
    H P H^T + V, and the residual (m,) px; V is what the step's own S of each measurement has beside H P H^T.
    """
    seen, n, m = step.innovation, len(step.innovation.ids), 4 * int(rows.sum())
    H, P, each = jacobian(step.prior, seen, drive, error_state, pose), step.prior.covariance, np.arange(n)
    if hasattr(step.prior, "seen"):
        P = np.zeros((n, 3, n, 3))
        P[each, :, each] = step.prior.covariance[seen.ids]
        P = P.reshape(3 * n, 3 * n)
    S = (H.reshape(4 * n, -1) @ P @ H.reshape(4 * n, -1).T).reshape(n, 4, n, 4)
    S[each, :, each] = seen.covariance
    return P, H[rows].reshape(m, -1), S[rows][:, :, rows].reshape(m, m), seen.residual[rows].ravel()


def frame_nis(step: Step, drive: Drive, error_state: ErrorState, pose=None) -> tuple[float, float]:
    """NIS of a step's whole frame, and how many numbers it sums: four a landmark in front of the camera.

    error_state : of a joint filter. pose : (4, 4), where it was given to the filter. Returns NaNs for no landmark.
    """
    rows = np.isfinite(step.innovation.nis)
    if not rows.any():
        return np.nan, np.nan
    _, _, S, residual = joint(step, drive, error_state, rows, pose)
    return float(kalman.nis(residual, S)), len(residual)


def pulls(step: Step, drive: Drive, error_state: ErrorState) -> np.ndarray:
    """(n, 6): what each measurement adds to the correction of the pose, K_j r_j, as a right perturbation, m and rad.

    Zero where the gate kept it out. To first order their sum is the correction of the frame.
    """
    prior, good = step.prior, step.innovation.accepted
    contribution = np.zeros((len(good), 6))
    if good.any():
        P, H, S, residual = joint(step, drive, error_state, good)
        K = P @ np.linalg.solve(S, H).T
        of_pose = slice(3 * len(prior.ids), 3 * len(prior.ids) + 6) if hasattr(prior, "ids") else slice(0, 6)
        # K's columns in blocks of four, one block for each measurement
        each = np.einsum("anr,nr->na", K[of_pose].reshape(6, -1, 4), residual.reshape(-1, 4))
        contribution[good] = each @ to_right(error_state, prior.world_T_imu).T
    return contribution


def look(step, after, drive, error_state, pose) -> dict[str, Any]:
    """What the cameras saw in this step's frame, as fields of a snapshot. after : `of_belief` of its posterior."""
    ids = step.innovation.ids
    given = len(after.ids) < len(ids)  # the filter holds no landmark
    points = drive.true_landmarks[ids] if given else after.landmarks[np.searchsorted(after.ids, ids)]
    pull = np.zeros((len(ids), 2)) if pose is not None else pulls(step, drive, error_state)[:, :2]
    projected = drive.camera.observe(after.world_T_imu, points)[0][:, :2]
    return {"sight": step.innovation, "projected": projected, "pulls": pull}


def pose_series(snapshots) -> list[Series]:
    """Errors of the pose as a right perturbation with their ± 3 sigma (NaN without truth), then sigma alone."""
    if any(s.pose_covariance is None for s in snapshots):
        return []
    sigma = np.sqrt([np.diag(s.pose_covariance) for s in snapshots])
    error = np.array([np.full(6, np.nan) if s.true_world_T_imu is None else
                      se3.log(se3.inverse(s.world_T_imu) @ s.true_world_T_imu) for s in snapshots])
    errors = [Series(f"{name} error", unit, scale * error[:, axis], *np.outer([-3, 3], scale * sigma[:, axis]))
              for name, axis, scale, unit in POSE_ERRORS]
    nothing = np.full(len(sigma), np.nan)
    return errors + [Series(f"{name} σ", unit, scale * sigma[:, axis], nothing, nothing, stair=True)
                     for name, axis, scale, unit in POSE_ERRORS]


def nees_series(beliefs, snapshots, error_state) -> Series:
    """NEES of the pose in the filter's own error, with the 95 % band of six degrees of freedom."""
    truth = np.array([s.true_world_T_imu for s in snapshots])
    claimed = [b.pose_covariance if hasattr(b, "ids") else b.covariance for b in beliefs]
    nees = metrics.pose_nees(error_state, truth, np.array([b.world_T_imu for b in beliefs]), np.array(claimed)).pose
    low, high = metrics.chi2_band(6, probability=0.95)
    return Series("NEES of the pose", "6 is honest", nees, np.full(len(nees), low), np.full(len(nees), high), log=True)


def nis_band(n_numbers):
    """NIS / degrees of freedom that 95 % of honest frames show, (2, ...), for frames of so many numbers."""
    n_numbers = np.asarray(n_numbers)
    return np.array([kalman.chi_square_quantile(p, n_numbers) / n_numbers for p in (0.025, 0.975)])


def row_names(snapshots, error_state) -> tuple[list[str], list[str]]:
    """Names of the three rows of a landmark, and of the rows behind the landmarks; [] without a covariance."""
    sizes = [len(s.covariance) - 3 * len(s.ids) for s in snapshots if s.covariance is not None]
    if not sizes:
        return ["x", "y", "z"], []
    return list(error_state.landmark_rows), [*error_state.pose_rows, *MOTION_ROWS[:sizes[0] - 6]]


def describe(before: Snapshot | None, now: Snapshot, estimates_pose: bool) -> str:
    """What led from one snapshot to the next, in words and numbers."""
    if STAGES[now.stage] == "born":
        return f"new: {listed(now.born)}; nothing else changes" if len(now.born) else "nothing changes, no birth here"
    if not (estimates_pose or now.updated or len(now.retired) or len(now.born)):
        return "nothing changes, because the poses are given and landmarks stand still"
    words = [_pose_words(before, now)] if now.pose_covariance is not None else []
    seen = now.sight if now.updated else None
    if seen is not None and len(seen.ids):
        out = seen.ids[~seen.accepted]
        what = "the pose" if not len(now.ids) else "the map and the pose" if estimates_pose else "the map"
        words.insert(0, f"{int(seen.accepted.sum())} of {len(seen.ids)} measurements correct {what}")
        words += [f"the gate keeps out {listed(out)}"] if len(out) else []
    if before is not None and len(now.ids):
        words.append(_map_words(before, now))
    if seen is not None and not len(seen.ids) and {"", POSE_STAYS, MAP_STAYS}.issuperset(words):
        return "nothing changes, because no landmark of the state is measured"
    words += [f"new: {listed(now.born)}"] if len(now.born) else []
    words += [f"left the state: {listed(now.retired)}"] if len(now.retired) else []
    return "; ".join(filter(None, words)) or "nothing is known yet"


def _pose_words(before, now) -> str:
    sigmas = [np.sqrt(np.diag(s.pose_covariance)[[0, 1, 5]]) for s in (before, now) if s is not None]
    shown = []
    for axis, (name, _, _, unit) in enumerate(POSE_ERRORS):
        scale, unit = (180 / np.pi, "°") if unit == "°" else (100, " cm")
        shown.append(f"{name} " + " → ".join(f"{scale * s[axis]:.2g}" for s in sigmas) + unit)
    if before is not None and np.allclose(sigmas[0], sigmas[1], rtol=1e-9):
        return POSE_STAYS
    moved = "" if before is None else " shrinks," if sigmas[1].prod() < sigmas[0].prod() else " grows,"
    return f"pose σ{moved} " + ", ".join(shown)


def _map_words(before, now) -> str:
    """Which landmark gained most, by the largest ratio of its longest axis."""
    common, old, new = np.intersect1d(before.ids, now.ids, return_indices=True)
    if len(common) == 0:
        return ""
    longest = [principal_sigmas(s.landmark_covariance[rows])[:, 0] for s, rows in ((before, old), (now, new))]
    shrink = longest[1] / longest[0]
    best = int(np.argmin(shrink))
    if abs(shrink[best] - 1) < 1e-3:
        return MAP_STAYS if abs(shrink.max() - 1) < 1e-3 else "landmark ellipses grow"
    return f"landmark {common[best]} gains most, σ {longest[0][best]:.2g} → {longest[1][best]:.2g} m"


def principal_sigmas(covariance: np.ndarray) -> np.ndarray:
    """(..., 3) standard deviations along the principal axes, largest first. covariance : (..., 3, 3)."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))[..., ::-1]


def listed(ids) -> str:
    """Numbers with commas."""
    return ", ".join(map(str, ids))
