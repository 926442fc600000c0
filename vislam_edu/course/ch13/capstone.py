"""The capstone: a student's whole filter, stage by stage, and judged on drives that nobody has seen.

    from vislam_edu.course.exercises import capstone

    capstone.compare("filter_predict", filter_predict)      the first number that is not the package's, framed
    capstone.score(filter_run, student=1234)                the table of the whole filter

`STAGES` are the exercises of chapter 13. The unseen drives are made from a seed that the student's number gives. A
filter that never ends, or whose state grows without end, is stopped.
"""

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np

from ... import ekf_slam, kalman, metrics, odometry, se3, simulate, window_slam
from ...belief import NO_INNOVATION, Belief, Innovation, Step
from ...drive import Drive
from ...error_state import ErrorState, RightPerturbation
from ...noise import Noise
from ...plots.text import on_a_page
from ...studies.runs import Run, record
from ..checks.comparing import number
from ..checks.exercise import EXERCISES, find
from ..checks.picture import matrices
from ..checks.right_parts import wrong_entries
from ..checks.running import Unreadable, copied, error_message, outcome_of, within
from ..checks.verdict import NOT_WRITTEN, RIGHT, WRONG, Verdict, judge
from .exercises import NOISE, apart, filter_run, renumbered

STAGES = ("filter_predict", "filter_update", "filter_birth", "filter_frame", "filter_run")
LIMIT = 60.0  # s, for one drive
MOST_LANDMARKS = 300  # in the state; about 15 to 60 are in view
ATE_ALLOWED, SIGMA_ALLOWED = 1.2, 1.5  # times those of the agreed filter
SHARE_ALLOWED = 0.02  # how much less than of the agreed filter's measurements may pass the gate


# --- drives -----------------------------------------------------------------------------------------------

def seed_of(student: int | str, number: int = 0) -> int:
    """The seed of a student's drive: the same on every machine, and no two students share it."""
    return int.from_bytes(hashlib.blake2s(f"capstone {student} {number}".encode()).digest()[:4])


def unseen(student: int | str, number: int = 0) -> Drive:
    """A drive with truth that the student's number gives: 100 frames, about 15 landmarks in view."""
    drive = simulate.street_loop(seed_of(student, number), frames=100, visible=15, life=(9, 100))
    return drive.replace(name=f"unseen {number + 1}")


def slalom(seed: int = 7, frames: int = 60, dark: int = 12) -> Drive:
    """A drive with truth on which the prediction counts: three landmarks in view, none in the last `dark` frames.

    Every fourth step the speed jumps between 2 and 12 m/s and the turn changes sides; the steps last 0.1 to 0.3 s.
    """
    rng = np.random.default_rng(seed)
    taus, legs = 0.2 * rng.uniform(0.5, 1.5, frames - 1), np.arange(frames - 1) // 4
    size = rng.uniform(0.7, 1.3, (2, frames))[:, legs]
    twists = np.zeros((frames - 1, 6))
    twists[:, 0], twists[:, 5] = np.where(legs % 2, 2, 12) * size[0], 0.8 * (-1.0)**legs * size[1]
    path = se3.chain(np.eye(4), se3.exp(taus[:, None] * twists))
    drive = simulate.along(path, np.append(0, np.cumsum(taus)), seed, visible=3, life=(3, 40), mean_life=15,
                           redetect_every=2, depth=(5, 30), name="slalom")
    end = drive.frame_start[frames - dark]
    lit = drive.replace(frame_start=np.minimum(drive.frame_start, end), landmark=drive.landmark[:end],
                        pixels=drive.pixels[:end])
    return simulate.add_noise(renumbered(lit.keep_landmarks(lit.first_seen >= 0)), seed)


def drives(student: int | str) -> list[Drive]:
    """What a filter is judged on: `first_steps`, the slalom, two unseen."""
    return [simulate.first_steps().replace(name="first_steps"), slalom(), unseen(student, 0), unseen(student, 1)]


# --- running a filter --------------------------------------------------------------------------------------

@dataclass(frozen=True, eq=False)
class Followed:
    """What a filter did on a drive. run : `Run`, or None where it raised or did not end. seconds : CPU time.

    problem : why it stopped, "" if it did not.
    """

    run: Run | None
    seconds: float
    problem: str = ""


def belief(state) -> Belief:
    """A state of `filter_run` as the package's belief, which the explorer draws."""
    T, landmarks, ids, P = state
    return Belief(np.array(T, float), np.array(landmarks, float).reshape(-1, 3), np.array(ids, int), np.array(P, float))


def steps(run: Callable, drive: Drive, noise: Noise = NOISE) -> Iterator[Step]:
    """A student's filter as `Step`s: `Explorer(capstone.steps(filter_run, drive), drive)`.

    run : as `filter_run`. What a frame expected is computed from the state before it, with the package's prediction.
    """
    before = Belief(np.eye(4), np.empty((0, 3)), np.empty(0, int), noise.initial_pose_covariance)
    for k, state in enumerate(run(drive, noise)):
        ids, pixels = drive.observed(k)
        if k:
            before = ekf_slam.predict(before, drive.step_twists[k - 1], drive.taus[k - 1], noise)
        prior = before
        known = np.isin(ids, prior.ids)
        after = belief(state)
        born, retired = np.setdiff1d(after.ids, before.ids), np.setdiff1d(before.ids, after.ids)
        yield Step(k, drive.times[k], prior, after, _expected(prior, ids[known], pixels[known], drive, noise), born,
                   retired)
        before = after


def _expected(prior, ids, pixels, drive, noise) -> Innovation:
    """The measurements of the known landmarks against what the prior expects of each."""
    if not len(ids):
        return NO_INNOVATION
    rows = np.array([np.flatnonzero(prior.ids == i)[0] for i in ids])
    T, n = prior.world_T_imu, len(prior.ids)
    seen = prior.landmarks[rows]
    predicted, in_front = drive.camera.observe(T, seen)
    H = ekf_slam.joint_jacobian(drive.camera.landmark_jacobian(T, seen), drive.camera.pose_jacobian(T, seen), rows, n)
    S = kalman.innovation_covariance(prior.covariance, H.reshape(-1, 4, 3 * n + 6), noise.pixel_covariance)
    nis = np.where(in_front, kalman.nis(pixels - predicted, S), np.inf)
    return Innovation(ids, pixels, predicted, S, nis, in_front & (nis <= kalman.gate_threshold(0.99)))


def follow(run: Callable, drive: Drive, noise: Noise = NOISE, limit: float = LIMIT) -> Followed:
    """Run a filter over a drive, for at most `limit` seconds and `MOST_LANDMARKS` landmarks. Raises nothing of its own.

    run : as `filter_run`. A stub gives the problem "not written yet".
    """
    runs: list[Run] = []
    problem, spent = "", 0.0

    def timed(drive, noise):
        nonlocal spent
        states = iter(run(drive, noise))
        while True:
            start = time.process_time()
            state = next(states, None)
            spent += time.process_time() - start
            if state is None:
                return
            if len(state[2]) > MOST_LANDMARKS:
                raise Unreadable(f"more than {MOST_LANDMARKS} landmarks in the state: those out of sight have to "
                                 "leave it")
            yield state

    def work():
        nonlocal problem
        try:
            with np.errstate(all="ignore"):
                came = record(steps(timed, drive, noise))
            states = len(came.world_T_imu)
            if not states:
                raise NotImplementedError
            if states != drive.n_frames:
                raise Unreadable(f"{states} states for {drive.n_frames} frames")
            if not np.isfinite(came.covariance).all():
                raise Unreadable("a pose or its covariance is not a finite number")
            runs.append(came)
        except NotImplementedError:
            problem = NOT_WRITTEN
        except (Exception, SystemExit) as error:
            problem = error_message(error)

    if within(work, limit):
        return Followed(None, spent, f"no end after {limit:g} s")
    return Followed(runs[0] if runs else None, spent, problem)


# --- the score --------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Figures:
    """One estimate on one drive: ATE, m; mean NEES of the pose; share of the measurements in the 99 % gate; CPU s.

    sigma : m, what it claims of the last position: root of the trace of the covariance.
    """

    ate: float
    nees: float
    in_gate: float
    seconds: float
    sigma: float


@dataclass(frozen=True)
class Judged:
    """The student's filter on one drive. problem : "" if it came through.

    agreed : the filter that the stages describe, of the package's pieces. package : the package's own, which adds the
    second-order predicted mean, one of the extensions. dead_reckoning : the IMU alone.
    """

    drive: str
    mine: Figures
    agreed: Figures
    package: Figures
    dead_reckoning: Figures
    problem: str = ""

    @property
    def all(self) -> tuple[Figures, Figures, Figures, Figures]:
        """The student's, the agreed filter's, the package's and dead reckoning's."""
        return self.mine, self.agreed, self.package, self.dead_reckoning

    @property
    def faults(self) -> list[str]:
        """What is worse than in the agreed filter."""
        if self.problem:
            return [self.problem]
        low, high = nees_band()
        mine, right = self.mine, self.agreed
        return [text for text, wrong in [
            ("ATE too large", not mine.ate <= ATE_ALLOWED * right.ate),
            ("NEES out of band", not low <= mine.nees <= max(high, ATE_ALLOWED * right.nees)),
            ("gate share", mine.in_gate < right.in_gate - SHARE_ALLOWED),
            ("sigma too large", mine.sigma > SIGMA_ALLOWED * right.sigma),
        ] if wrong]


def _short(nees) -> str:
    return f"{nees:.1f}" if nees < 1000 else "> 1000"


def nees_band() -> tuple[float, float]:
    """The band of the mean NEES over one drive: that of one number, which is the safe side for a mean over frames."""
    return metrics.chi2_band(6, 1)


def _figures(drive, poses, covariance, in_gate=np.nan, seconds=np.nan, error_state=None) -> Figures:
    true = drive.true_world_T_imu
    try:
        nees = float(metrics.pose_nees(error_state or RightPerturbation(), true, poses, covariance).pose.mean())
    except np.linalg.LinAlgError:  # not positive definite
        nees = np.inf
    sigma = np.nan if error_state else float(np.sqrt(np.trace(covariance[-1, :3, :3])))
    return Figures(metrics.ate(true, poses), nees, in_gate, seconds, sigma)


agreed_run: Callable = filter_run.reference  # the filter that the stages describe


def package_run(drive: Drive, noise: Noise) -> Iterator[tuple]:
    """The package's own filter in the form of `filter_run`, over the landmarks in view and without a gate."""
    for step in window_slam.run(drive, noise, gate=1):
        after = step.posterior
        yield after.world_T_imu, after.landmarks, after.ids, after.covariance


_NOTHING = Figures(np.nan, np.nan, np.nan, np.nan, np.nan)


def judged(run: Callable, drive: Drive, limit: float = LIMIT, error_state: ErrorState | None = None) -> Judged:
    """A filter on a drive beside the others. error_state : of the student's covariance, the right perturbation if None.

    The share in the gate and sigma are those of the right perturbation, and are left out for another error.
    """
    def of(followed, error_state=None):
        run = followed.run
        share = run.used if error_state is None else np.nan
        return _figures(drive, run.world_T_imu, run.covariance, share, followed.seconds, error_state)

    mine = follow(run, drive, limit=limit)
    if mine.problem == NOT_WRITTEN:
        return Judged(drive.name, _NOTHING, _NOTHING, _NOTHING, _NOTHING, NOT_WRITTEN)
    dead = odometry.dead_reckon(drive, NOISE)
    return Judged(drive.name, _NOTHING if mine.problem else of(mine, error_state),
                  of(follow(agreed_run, drive)), of(follow(package_run, drive)),
                  _figures(drive, dead.world_T_imu, dead.covariance), mine.problem)


@dataclass(frozen=True)
class Score:
    """The whole filter: `drives`, a `Judged` for each. student : the number that gave the unseen drives.

    verdict : of the check of `filter_run`; None where nothing ran, or where the covariance is of another error.
    """

    student: int | str
    drives: tuple[Judged, ...]
    verdict: Verdict | None = None

    @property
    def status(self) -> str:
        """RIGHT where no drive is worse than with the agreed filter, else WRONG, or NOT_WRITTEN."""
        if any(one.problem == NOT_WRITTEN for one in self.drives):
            return NOT_WRITTEN
        return WRONG if any(one.faults for one in self.drives) else RIGHT

    @property
    def text(self) -> str:
        """The table, one row a drive; CPU times are left out: they differ from run to run."""
        if self.status == NOT_WRITTEN:
            return "filter_run: not written yet"
        low, high = nees_band()
        two = f"{'yours':>7}{'agreed':>7}"
        four = f"{two}{'package':>8}{'IMU':>6}"
        lines = [on_a_page(self.verdict.text), ""] if self.verdict else []
        lines += [f"{'':12}{'ATE (m)':>28}{'NEES (6 is honest)':>28}{'% in the gate':>14}{'sigma (m)':>14}",
                  f"{'':12}{four}{four}{two}{two}"]
        for one in self.drives:
            ates, nees = ([f"{text:>{width}}" for text, width in zip(texts, (7, 7, 8, 6))] for texts in (
                [f"{figures.ate:.2f}" for figures in one.all], [_short(figures.nees) for figures in one.all]))
            lines.append("".join([
                f"{one.drive:12}", *ates, *nees, *(f"{100 * figures.in_gate:7.1f}" for figures in one.all[:2]),
                *(f"{figures.sigma:7.3f}" for figures in one.all[:2])]))
        fine = "no measurable harm" if self.verdict and not self.verdict.right else "like the agreed filter, or better"
        lines += [f"{one.drive}: {'; '.join(one.faults) or fine}" for one in self.drives]
        if self.status == RIGHT and self.verdict and not self.verdict.right:
            lines.append("It is not the agreed filter, and it does no measurable harm on these drives.")
        lines.append(f"on one drive, at least 99 % of honest filters have a NEES in [{low:.1f}, {high:.1f}]")
        return "\n".join(lines)

    @property
    def figures(self) -> dict:
        """What JSON and CSV files hold."""
        rows = [{"student": str(self.student), "drive": one.drive, "problem": "; ".join(one.faults)}
                | {f"{who}_{name}": value if np.isfinite(value) else None
                   for who in ("mine", "agreed", "package", "dead_reckoning")
                   for name, value in asdict(getattr(one, who)).items()} for one in self.drives]
        return {"student": str(self.student), "status": self.status, "drives": rows}


def scored(run: Callable, student: int | str = 0, limit: float = LIMIT, error_state: ErrorState | None = None) -> Score:
    """Judge a filter. limit : s a drive.

    student : the number that gives the unseen drives. error_state : of the filter's covariance, see `judged`.
    """
    found = []
    for drive in drives(student):
        found.append(judged(run, drive, limit, error_state))
        if found[-1].problem == NOT_WRITTEN or found[-1].problem.startswith("no end"):
            break
    compared = error_state is None and found[-1].problem != NOT_WRITTEN
    return Score(student, tuple(found), judge(filter_run, run) if compared else None)


def score(run: Callable, student: int | str = 0, limit: float = LIMIT, error_state: ErrorState | None = None) -> Score:
    """Judge a filter, as `scored` does, and print the table."""
    result = scored(run, student, limit, error_state)
    print(result.text)
    return result


# --- the stages -------------------------------------------------------------------------------------------

def first_wrong_stage(pieces: dict[str, Callable]) -> Verdict | None:
    """The verdict on the first stage that is not right, in the order of `STAGES`; None if all are.

    pieces : the student's functions by the names of the stages.
    """
    verdicts = (judge(EXERCISES[name], pieces[name]) for name in STAGES)
    return next((verdict for verdict in verdicts if not verdict.right), None)


@dataclass(frozen=True, eq=False)
class Parting:
    """Where two results part first. where : in words. mine, package : the matrices there. entry : (row, column).

    look : of a whole filter, in which stage to look.
    """

    where: str
    mine: np.ndarray
    package: np.ndarray
    entry: tuple[int, int]
    look: str = ""


def first_parting(name: str, function: Callable) -> Parting | str:
    """The first input, and in it the first entry, in which a stage is not the package's; else a text that says why not.

    "First" is in the order of the results and of the rows; of a whole filter see `apart`.
    """
    exercise = find(name)
    for label, arguments in exercise.inputs():
        outcome = outcome_of(exercise, function, arguments)
        if outcome.blank:
            return f"{name}: not written yet"
        if outcome.values is None:
            return f"{name}, {label}:\n{error_message(outcome.error)}"
        expected = exercise.expected(*map(copied, arguments))
        if exercise is filter_run:
            if found := apart(arguments, outcome.values, expected):
                if not found.entry:
                    return f"{name}, {label}: {found.where}. {found.look}"
                row, column = (0, *found.entry)[-2:]
                return Parting(f"{label}: {found.part} of frame {found.frame}", np.atleast_2d(found.mine),
                               np.atleast_2d(found.right), (row, column), found.look)
            continue
        for output, mine, package in zip(exercise.outputs, outcome.values, expected):
            mine, package = np.asarray(mine, float), np.asarray(package, float)
            if mine.shape != package.shape:
                return f"{name}, {label}: {output} has shape {mine.shape}, the package's {package.shape}"
            if (wrong := wrong_entries(mine, package, exercise.tolerance)).any():
                row, column = (0, 0, *np.argwhere(wrong)[0].tolist())[-2:]
                return Parting(f"{label}: {output}", np.atleast_2d(mine), np.atleast_2d(package), (row, column))
    return f"{name}: every number is the package's"


def compare(name: str, function: Callable):
    """A figure of the first matrix in which a stage is not the package's, its first wrong entry framed.

    Prints why and returns None where nothing can be compared.
    """
    found = first_parting(name, function)
    if isinstance(found, str):
        print(on_a_page(found))
        return None
    i, j = found.entry
    print(on_a_page(f"{name}, {found.where}, entry [{i}, {j}]: {number(found.mine[i, j])}, "
                    f"the package has {number(found.package[i, j])}. {found.look}".rstrip()))
    return matrices(found.mine, found.package, "package", [found.entry],
                    f"{name}: the first entry that differs, [{i}, {j}], is framed")
