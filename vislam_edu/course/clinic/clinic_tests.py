"""The tests that the clinic offers: what a patient is put through, and what is read from it.

A test is a function of a `Build` and a seed that returns its readings. Each tells a seed's healthy patient from a sick
one by bands that were measured on healthy patients: `python -m vislam_edu.course.clinic.clinic_tests` writes them to
`clinic_bands.json`, beside this file.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ... import kalman, metrics, se3, simulate, stereo, window_slam
from ...audit import visual_odometry
from ...belief import Belief
from ...drive import Drive
from ...error_state import RightPerturbation
from ...noise import Noise
from ...studies.runs import Run, attempt, record
from .patients import Build

# What the sensors of every drive here have. The start is known to 3 mm and 1 mrad: with a larger initial uncertainty
# even a right filter of this error state is overconfident after a few frames (chapter 07), and its readings say little.
NOISE = Noise(initial_pose_covariance=0.01 * Noise().initial_pose_covariance)
BANDS = Path(__file__).with_name("clinic_bands.json")
HEALTHY_SEEDS = 60  # of the stored bands: seeds 0 to 59; patients draw from elsewhere
WIDTH = 5.0  # standard deviations of healthy readings on either side of their mean
FLOOR = 0.03  # on a logarithmic scale (ln): readings without scatter agree to a few per cent on every machine
SMALLEST, LARGEST = 1e-6, 1e6  # readings are clipped: beyond, they depend on the machine's rounding
HEADING = "heading sigma, times that at the start"  # a reading of two tests

Readings = dict[str, float]


@dataclass(frozen=True, eq=False)
class Test:
    """A test to order. price : budget it costs. run : (Build, seed) -> readings, all positive, compared by logarithm.

    bench : whether it tests one piece alone. clears : pieces that are right if all readings are in their bands.
    """

    name: str
    text: str
    price: int
    run: Callable[[Build, int], Readings]
    bench: bool = False
    clears: tuple[str, ...] = ()


# --- driving a patient ----------------------------------------------------------------------------------------

def street(seed: int, **options: Any) -> Drive:
    """60 frames along a street and around its first corner, about 15 landmarks in view; or with other options."""
    return simulate.street_loop(seed, **{"frames": 60, "visible": 15, "life": (9, 100)} | options)


base_drive = lru_cache(32)(street)


@lru_cache(32)
def standing_drive(seed: int) -> Drive:
    """60 frames on one spot: 15 landmarks, IMU and pixels as noisy as ever."""
    frames = 60
    camera, rng = simulate.kitti_camera(), np.random.default_rng((seed, 7))
    depth = rng.uniform(6, 25, 15)
    points = np.stack([depth * rng.uniform(-0.6, 0.6, 15), rng.uniform(-1, 1.5, 15), depth], axis=-1)
    still = Drive(times=0.1 * np.arange(frames), twists=np.zeros((frames, 6)), camera=camera,
                  frame_start=15 * np.arange(frames + 1), landmark=np.tile(np.arange(15), frames),
                  pixels=np.tile(camera.project(points)[0], (frames, 1)), n_landmarks=15, name="standing still",
                  truth_world_T_cam=np.tile(camera.imu_T_cam, (frames, 1, 1)),
                  truth_landmarks=se3.transform(camera.imu_T_cam, points))
    return simulate.add_noise(still, seed)


def steps(build: Build, drive: Drive, seed: int, gate: float = 1, world_T_start: np.ndarray | None = None):
    """A patient's steps over a drive, from a pose that is off the truth by a draw from the claimed covariance."""
    recording = build.recording(drive)
    recording = recording.replace(camera=build.camera(recording.camera))
    noise = build.noise(NOISE)
    error = np.random.default_rng((seed, 100)).multivariate_normal(np.zeros(6), NOISE.initial_pose_covariance)
    start = (np.eye(4) if world_T_start is None else world_T_start) @ se3.exp(-error)
    return window_slam.run(recording, noise, build.error_state(recording.camera), motion_model=build.motion_model,
                           process_frame=build.process_frame, gate=gate, world_T_imu=start)


def driven(build: Build, drive: Drive, seed: int, world_T_start: np.ndarray | None = None) -> Run:
    """Run a patient; one whose numbers cease to be finite, or its covariance positive, is stopped there."""
    with np.errstate(all="ignore"):
        return attempt(steps(build, drive, seed, world_T_start=world_T_start))


def numbers_of(run: Run, drive: Drive, world_T_start: np.ndarray | None = None) -> Readings:
    """RMSE of the position, m, mean NIS (4 is honest) and mean NEES of the pose (6)."""
    if run.problem:
        return {"RMSE": LARGEST, "NIS": LARGEST, "NEES": LARGEST}
    true: Any = drive.true_world_T_imu  # every drive here has truth
    true = true if world_T_start is None else world_T_start @ true
    nees = run.nees(true).mean()
    return {"RMSE": np.sqrt(np.mean(run.errors(true)**2)), "NIS": run.mean_nis,
            "NEES": nees if nees < np.inf else LARGEST}


def numbers(build: Build, seed: int) -> Readings:
    return numbers_of(driven(build, base_drive(seed), seed), base_drive(seed))


def gate_share(build: Build, seed: int) -> Readings:
    return {"kept out, %": 100 * (1 - record(steps(build, base_drive(seed), seed, gate=0.99)).used) + 0.5}


def elsewhere(build: Build, seed: int, world_T_start: np.ndarray) -> Readings:
    """The same drive from another start: no filter may notice where the world's origin lies."""
    drive, here = base_drive(seed), numbers(build, seed)
    there = numbers_of(driven(build, drive, seed, world_T_start=world_T_start), drive, world_T_start)
    return {f"{name}, times that at 0": there[name] / here[name] for name in ("RMSE", "NIS", "NEES")}


# Other drives for the three numbers: what a perfect sensor leaves is the fault of the other, or of the filter.
OTHER_DRIVES: dict[str, tuple[str, Callable[[int], Drive]]] = {
    "perfect IMU": ("whose IMU has no noise", lambda seed: street(seed, sigma_v=0.0, sigma_omega=0.0)),
    "perfect camera": ("whose pixels have no noise", lambda seed: street(seed, sigma_px=0.0)),
    "straight": ("without a corner", lambda seed: street(seed, loop_length=4000.0)),
    "half the rate": ("of which every other frame is missing", lambda seed: street(seed, frames=120).subsample(2)),
}


def on_another_drive(make: Callable[[int], Drive]) -> Callable[[Build, int], Readings]:
    """The three numbers on one of `OTHER_DRIVES`."""
    make = lru_cache(8)(make)
    return lambda build, seed: numbers_of(driven(build, make(seed), seed), make(seed))


def over_seeds(build: Build, seed: int) -> Readings:
    """Mean NEES of four drives: a single one says little."""
    drives = [street(4 * seed + i + 10_000) for i in range(4)]
    return {"NEES": float(np.mean([numbers_of(driven(build, drive, seed), drive)["NEES"] for drive in drives]))}


# What the next ones raise for a patient that is stopped, or that measures nothing, `read` turns into readings.

def by_block(build: Build, seed: int) -> Readings:
    """NEES of rotation and position apart (3 each), and the heading's sigma at the end over that at the start."""
    drive = base_drive(seed)
    run = record(steps(build, drive, seed))
    P = run.covariance
    nees = metrics.pose_nees(RightPerturbation(), drive.true_world_T_imu, run.world_T_imu, P)
    return {"NEES of the rotation": nees.rotation.mean(), "NEES of the position": nees.position.mean(),
            HEADING: np.sqrt(P[-1, 5, 5] / P[0, 5, 5])}


def residuals(build: Build, seed: int) -> Readings:
    """2 px and the mean of the residuals in each row, and how a landmark's residual goes with its last one."""
    run = record(steps(build, base_drive(seed), seed))
    finite = np.isfinite(run.nis)
    residual = run.residual[finite]
    places = zip(run.frame[finite].tolist(), run.ids[finite].tolist())
    u = dict(zip(places, residual[:, 0]))
    pairs = [(u[k - 1, i], now) for (k, i), now in u.items() if (k - 1, i) in u]
    if len(pairs) < 3:
        raise ValueError("there is next to no landmark that was measured twice")
    mean = np.abs(residual.mean(axis=0)) + 2
    return {"2 px + mean of u left": mean[0], "2 px + mean of v": mean[[1, 3]].mean(),
            "2 px + mean of u right": mean[2],
            "1 + correlation with the frame before": 1 + np.corrcoef(np.transpose(pairs))[0, 1]}


def standing(build: Build, seed: int) -> Readings:
    drive = standing_drive(seed)
    run = record(steps(build, drive, seed))
    sigma, found = np.sqrt(run.covariance[[0, -1], 5, 5]), numbers_of(run, drive)
    return {"position error, m": found["RMSE"], HEADING: sigma[1] / sigma[0], "NIS": found["NIS"],
            "NEES": found["NEES"]}


def first_update(build: Build, seed: int) -> Readings:
    """How far a landmark's first update, and its later ones, fall from what was expected."""
    run = record(steps(build, base_drive(seed), seed))
    first = np.zeros(len(run.ids), bool)
    first[np.unique(run.ids, return_index=True)[1]] = True
    by_age = {"NIS of the first update": run.nis[first], "NIS of later updates": run.nis[~first]}
    if not all(np.isfinite(nis).any() for nis in by_age.values()):
        raise ValueError("no landmark in front of the camera was measured")
    return {name: metrics.mean_nis(nis) for name, nis in by_age.items()}


# --- benches: one piece alone ---------------------------------------------------------------------------------

def _bench(build: Build, seed: int, n: int):
    """A random pose, n landmarks in view, the patient's settings, a random generator."""
    rng = np.random.default_rng((seed, 200))
    camera = simulate.kitti_camera()
    T = se3.pose(se3.so3_exp(np.array([0.1, -0.1, 1.0]) + 0.1 * rng.normal(size=3)), rng.normal(size=3))
    depth = rng.uniform(5, 12, n)
    points = np.stack([depth * rng.uniform(-0.6, 0.6, n), depth * rng.uniform(-0.2, 0.2, n), depth], axis=-1)
    mine = build.camera(camera)
    settings = window_slam.UpdateSettings(mine, build.noise(NOISE), build.error_state(mine), np.inf, 1.0)
    return rng, camera, T, camera.to_world(T, points), settings


def jacobian_bench(build: Build, seed: int) -> Readings:
    """H against central differences, each block relative to its largest entry."""
    n = 6
    _, camera, T, landmarks, settings = _bench(build, seed, n)
    points = camera.to_cam(T, landmarks)
    J = settings.camera.measurement_jacobian(points)[:, stereo.ROWS]
    H_landmark, H_pose = settings.error_state.jacobians(T, landmarks, J)

    def h(delta):
        pose, moved = RightPerturbation().retract(T, landmarks, delta)
        return camera.observe(pose, moved)[0][:, stereo.ROWS].ravel()

    right = kalman.central_difference(h, 3 * n + 6).reshape(n, 3, 3 * n + 6)
    by_landmark = np.array([right[i, :, 3 * i:3 * i + 3] for i in range(n)])

    def apart(mine, should):
        return max(float(np.abs(mine - should).max() / np.abs(should).max()), 1e-4)

    return {"landmark": apart(H_landmark, by_landmark), "position": apart(H_pose[..., :3], right[..., -6:-3]),
            "rotation": apart(H_pose[..., 3:], right[..., -3:])}


SAMPLES = 4000


def _two_frames(seed: int) -> Drive:
    """Two frames whose IMU sample is known; the second sample is another one."""
    drive = base_drive(seed).slice(0, 2)
    return drive.replace(twists=np.array([[10.0, 0.3, -0.2, 0.1, -0.2, 0.5], [9.0, 0.0, 0.1, 0.0, 0.1, 0.8]]))


def predict_bench(build: Build, seed: int) -> Readings:
    """One prediction against samples: where the pose goes, how W grows, what becomes of the cross terms."""
    rng, _, T, landmarks, settings = _bench(build, seed, 2)
    drive = _two_frames(seed)
    tau, twist = drive.taus[0], drive.twists[0]
    model = build.motion_model(drive, settings.noise, settings.error_state)
    should = T @ se3.exp(tau * twist)

    def predicted(P):
        return model.predict(Belief(T.copy(), landmarks.copy(), np.arange(2), P), 0)

    certain = predicted(1e-12 * np.eye(12))
    off = se3.log(se3.inverse(should) @ certain.world_T_imu)
    sigmas = np.repeat([0.2, 0.1, 0.05], [6, 3, 3])
    A = np.linalg.qr(rng.normal(size=(12, 12)))[0] * np.sqrt(np.linspace(0.2, 2, 12))
    P = sigmas[:, None] * (A @ A.T) * sigmas
    errors = rng.multivariate_normal(np.zeros(12), P, SAMPLES)
    noise = rng.normal(size=(SAMPLES, 6)) * np.repeat([NOISE.sigma_v, NOISE.sigma_omega], 3)
    moved = T @ se3.exp(errors[:, 6:]) @ se3.exp(tau * (twist + noise))
    after = np.hstack([errors[:, :6], se3.log(se3.inverse(should) @ moved)])
    W = np.var(tau * noise, axis=0)  # the certain pose moves by these errors, but for J_r
    return {"pose off, m": np.linalg.norm(off[:3]) + 0.01, "pose off, rad": np.linalg.norm(off[3:]) + 0.001,
            "sigma of W in position, times right": np.sqrt(np.trace(certain.pose_covariance[:3, :3]) / W[:3].sum()),
            "sigma of W in rotation, times right": np.sqrt(np.trace(certain.pose_covariance[3:, 3:]) / W[3:].sum()),
            "correlations off": _correlations_apart(predicted(P).covariance, np.cov(after.T))}


def _correlations_apart(mine, sampled) -> float:
    """The largest difference of two covariances, in units of the sampled standard deviations."""
    scale = np.sqrt(np.diag(sampled))
    return float(np.abs((mine - sampled) / scale / scale[:, None]).max())


def birth_bench(build: Build, seed: int) -> Readings:
    """New landmarks against samples: where they are, how uncertain, how correlated with the pose and each other."""
    n = 3
    rng, camera, T, landmarks, settings = _bench(build, seed, n)
    pixels = camera.observe(T, landmarks)[0]
    P = np.diag(np.repeat([0.1, 0.03], 3)**2)
    _, born, _ = build.process_frame(Belief(T.copy(), np.empty((0, 3)), np.empty(0, int), P), np.arange(n), pixels,
                                     settings)
    errors = rng.multivariate_normal(np.zeros(6), P, SAMPLES)
    poses = T @ se3.exp(errors)
    seen = pixels[:, None] + NOISE.sigma_px * rng.normal(size=(n, SAMPLES, 4))
    points = camera.triangulate(seen.reshape(-1, 4))[0].reshape(n, SAMPLES, 3)
    samples = np.array([camera.to_world(poses, each) for each in points])
    sampled = np.cov(np.hstack([*samples, errors]).T)
    alone = sum(np.trace(np.cov(camera.to_world(T, each).T)) for each in points)
    P = born.covariance
    own = P[:-6, :-6] - P[:-6, -6:] @ np.linalg.solve(P[-6:, -6:], P[-6:, :-6])  # were the pose known
    off = np.linalg.norm(born.landmarks - landmarks, axis=-1).max() if len(born.ids) == n else LARGEST
    return {"position off, m": off + 0.01, "correlations off": _correlations_apart(P, sampled),
            "own variance, times right": float(np.trace(own) / alone)}


def update_bench(build: Build, seed: int) -> Readings:
    """One update of four landmarks against the Kalman filter's formulas with the right H."""
    n = 4
    rng, camera, T, landmarks, settings = _bench(build, seed, n)
    A = rng.normal(size=(3 * n + 6, 3 * n + 6)) / (3 * n + 6)**0.5
    sigmas = np.repeat([0.1, 0.05, 0.01], [3 * n, 3, 3])
    P = sigmas[:, None] * (A @ A.T + 0.1 * np.eye(len(A))) * sigmas
    true = RightPerturbation().retract(T, landmarks, rng.multivariate_normal(np.zeros(len(P)), P))
    pixels = camera.observe(*true)[0] + NOISE.sigma_px * rng.normal(size=(n, 4))
    prior = Belief(T.copy(), landmarks.copy(), np.arange(n), P)
    _, mine, _ = build.process_frame(prior, np.arange(n), pixels, settings)
    right_settings = window_slam.UpdateSettings(camera, NOISE, RightPerturbation(), np.inf, 1.0)
    right = window_slam.correlated(Belief(T, landmarks, np.arange(n), P), np.arange(n), pixels, right_settings)[1]
    scale = np.sqrt(np.diag(right.covariance))
    pose = RightPerturbation().pose_difference(right.world_T_imu, mine.world_T_imu)
    moved = (mine.landmarks - right.landmarks).ravel()
    return {"pose off, sigmas": float(np.abs(pose / scale[-6:]).max()) + 1e-3,
            "landmarks off, sigmas": float(np.abs(moved / scale[:-6]).max()) + 1e-3,
            "covariance off": _correlations_apart(mine.covariance, right.covariance) + 1e-3}


# --- a recording against its cameras --------------------------------------------------------------------------

LATE = 3  # samples; one sample's delay is too small for the noise of this gyro


@lru_cache(32)
def long_drive(seed: int) -> Drive:
    """120 frames with about 40 landmarks in view."""
    return simulate.street_loop(seed, frames=120, visible=40)


def recording(build: Build, seed: int) -> Readings:
    """The IMU against visual odometry, and the tracks against each other. No filter is run."""
    drive = build.recording(long_drive(seed))
    motions = visual_odometry.estimate(drive)
    cam_T_imu = drive.camera.cam_T_imu
    seen = se3.log(drive.camera.imu_T_cam @ motions.motion @ cam_T_imu) / drive.taus[:, None]
    ok = motions.ok
    measured, seen = drive.step_twists[ok], seen[ok]
    off = measured - seen
    turn, turned = measured[:, 5], seen[:, 5]
    rows = drive.pixels[:, 1] - drive.pixels[:, 3]
    copied = (drive.pixels[motions.before] == drive.pixels[motions.after]).all(axis=1).mean()
    bias = np.abs(np.median(off[:, 3:], axis=0)).max()
    in_time, late = (np.std(off_by) for off_by in (turn - turned, turn[LATE:] - turned[:-LATE]))
    return {"gyro bias, rad/s": bias + 0.02, "gyro noise, rad/s": float(np.std(off[:, 3:])),
            "speed, times that of the cameras": float(np.sum(measured[:, 0] * seen[:, 0]) / np.sum(seen[:, 0]**2)),
            f"gyro noise, times that if it were {LATE} late": float(in_time / late),
            "wrong pairs, %": 100 * float(1 - motions.inlier.mean()) + 1, "copied pixels, %": 100 * copied + 1,
            "row offset, px": abs(float(np.median(rows))) + 0.2}


_FILTER_JACOBIANS = ("camera Jacobian", "landmark Jacobian", "pose Jacobian")
TESTS = {test.name: test for test in (
    Test("numbers", "RMSE, NIS and NEES of one drive", 0, numbers),
    Test("gate share", "how many measurements a gate of 99 % keeps out", 0, gate_share),
    Test("H", "H against central differences", 2, jacobian_bench, True, _FILTER_JACOBIANS),
    Test("predict", "one prediction against samples", 2, predict_bench, True,
         ("predicted pose", "predicted covariance")),
    Test("birth", "new landmarks against samples", 2, birth_bench, True, ("triangulation", "new landmarks")),
    Test("recording", "the recording against its own cameras", 2, recording, False, ("IMU", "tracks", "extrinsics")),
    Test("standing still", "60 frames on one spot", 1, standing),
    Test("first update", "the first update of each landmark", 1, first_update),
    Test("90 degrees", "the same drive in a world turned by 90 degrees", 1,
         partial(elsewhere, world_T_start=se3.pose(se3.so3_exp(np.array([0, 0, np.pi / 2])), np.zeros(3)))),
    Test("1 km", "the same drive with the world's origin 1 km behind", 1,
         partial(elsewhere, world_T_start=se3.pose(np.eye(3), np.array([1000.0, 0, 0])))),
    *(Test(name, f"the three numbers of a drive {text}", 1, on_another_drive(make))
      for name, (text, make) in OTHER_DRIVES.items()),
    Test("by block", "NEES of rotation and position apart, and the heading's sigma", 1, by_block),
    Test("residuals", "residuals: mean by row, and from frame to frame", 1, residuals),
    Test("over seeds", "NEES over four drives", 2, over_seeds),
    Test("update", "one update against the formulas", 2, update_bench, True,
         (*_FILTER_JACOBIANS, "correction", "covariance after the update")),
)}
# Pieces that no single test clears: the first shows the sigmas of the IMU, the second that of the pixels.
CLEARED_TOGETHER = {"noise values": ("predict", "birth")}
TAUGHT = ("numbers", "H", "predict", "birth", "gate share", "recording", "standing still", "first update", "90 degrees")


# --- what healthy patients read -------------------------------------------------------------------------------

def read(name: str, build: Build, seed: int) -> Readings:
    """The readings of a test, clipped to [SMALLEST, LARGEST]; what could not be computed reads LARGEST."""
    with np.errstate(all="ignore"):
        try:
            found = TESTS[name].run(build, seed)
        except (np.linalg.LinAlgError, ValueError):
            found = dict.fromkeys(bands()[name], LARGEST)
    return {key: float(np.clip(np.nan_to_num(value, nan=LARGEST), SMALLEST, LARGEST)) for key, value in found.items()}


@dataclass(frozen=True)
class Band:
    """Healthy readings: mean and standard deviation of their logarithm, over `runs` seeds."""

    mean: float
    sigma: float
    runs: int

    @property
    def limits(self) -> tuple[float, float]:
        """(low, high), in the reading's own unit."""
        half = max(WIDTH * self.sigma, FLOOR)
        return float(np.exp(self.mean - half)), float(np.exp(self.mean + half))

    def holds(self, reading: float) -> bool:
        """Whether a reading is in the band."""
        low, high = self.limits
        return low <= reading <= high


def measure_bands(seeds=range(HEALTHY_SEEDS), tests=tuple(TESTS)) -> dict[str, dict[str, Band]]:
    """Run healthy patients through the tests. Returns a Band for each reading of each test."""
    found = {}
    for name in tests:
        values = [read(name, Build(), seed) for seed in seeds]
        logs = {key: np.log([one[key] for one in values]) for key in values[0]}
        found[name] = {key: Band(float(log.mean()), float(log.std(ddof=1)), len(log)) for key, log in logs.items()}
    return found


@cache
def bands() -> dict[str, dict[str, Band]]:
    """The stored bands."""
    content = json.loads(BANDS.read_text(encoding="utf-8"))
    return {name: {key: Band(*band) for key, band in readings.items()} for name, readings in content.items()}


def outside(name: str, readings: Readings) -> list[str]:
    """The readings of a test that are not in their bands."""
    return [key for key, value in readings.items() if not bands()[name][key].holds(value)]


def write_bands() -> None:
    """Measure the bands and store them, to six digits."""
    content = {name: {key: [float(f"{band.mean:.6g}"), float(f"{band.sigma:.6g}"), band.runs]
                      for key, band in readings.items()} for name, readings in measure_bands().items()}
    BANDS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_bands()
