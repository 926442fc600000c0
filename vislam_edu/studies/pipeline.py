"""The report's whole pipeline over one recording: dead reckoning, a map on it, and the joint filter.

    result = pipeline.run_pipeline(drive, Noise())
    report_figures.slam_landmarks(result)

A thousand `Step`s of the joint filter hold two covariances each, about a gigabyte. So the filter is
listened to as it goes, and of each landmark only its last estimate is kept.
"""

import time
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from .. import batch, inertial, kalman, mapping, motion, odometry, window_slam
from ..drive import Drive
from ..error_state import RightPerturbation, world_landmark_covariance
from ..mapping import MapBelief
from ..noise import Noise
from ..odometry import Trajectory
from . import calibration, run_warnings
from .runs import Run, record, truth_beside


@dataclass(frozen=True, eq=False)
class Mapped:
    """What the landmark EKF said of poses that it had to believe: its map after the last frame.

    measurements : how many were compared with a prediction. contradicting : how many of them a 99 % gate would have
    kept out. The report has none, and on dead-reckoned poses it would leave one measurement in ten.
    """

    map: MapBelief
    measurements: int
    contradicting: int


@dataclass(frozen=True, eq=False)
class Slam:
    """What the joint filter said.

    trajectory : after each frame's update, its covariance that of a right perturbation whatever the error state. map :
    each landmark as it was when it left the state, or at the end, its covariance in the world frame (m^2). run : each
    measurement beside its prediction, before `metre`. seconds : what the filter took. method : key of the series'
    colours and labels. metre : by what its lengths have been multiplied at the end, see `scale`.
    """

    trajectory: Trajectory
    map: MapBelief
    run: Run
    seconds: float
    method: str
    metre: float = 1.0

    @property
    def measurements(self) -> int:
        """How many were compared with a prediction."""
        return len(self.run.nis)

    @property
    def rejected_share(self) -> float:
        """Of the measurements, those that the gate kept out; 0 where there were none."""
        return float(np.mean(~self.run.accepted)) if self.measurements else 0.0


@dataclass(frozen=True, eq=False)
class Result:
    """Everything that the report's figures show of one recording.

    initial : MapBelief, each landmark triangulated at first sight from the dead-reckoned pose.
    mapped : the landmark EKF on dead-reckoned poses, initialised as the report does. slam : the joint
    filter. calibration : (T, 6, 6) of right perturbations, what errors of the calibration add to the covariance of its
    path (`calibration.covariance`), or None where nobody asked.
    """

    drive: Drive
    noise: Noise
    dead_reckoning: Trajectory
    initial: MapBelief
    mapped: Mapped
    slam: Slam
    gate: float = 0.99
    calibration: np.ndarray | None = None

    @property
    def warnings(self) -> list[str]:
        """What speaks against the joint filter's result, see `run_warnings.of_filter`."""
        true = truth_beside(self.drive, self.slam.trajectory.world_T_imu)
        return run_warnings.of_filter(self.drive, self.slam, self.dead_reckoning, self.gate, true, self.calibration)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What the batch estimate said. seconds : of the clock, what it took."""

    solution: batch.Solution
    seconds: float

    @cached_property
    def claims(self) -> tuple[np.ndarray, np.ndarray]:
        """At most 40 frames (n,), spread over the drive, and the covariance (n, 6, 6) of their poses.

        Each costs a solution of the whole system.
        """
        frames = np.unique(np.linspace(0, self.solution.problem.drive.n_frames - 1, 40).round().astype(int))
        return frames, self.solution.pose_covariance(frames)


def run_batch(problem, world_T_imu) -> Smoothed:
    """The batch estimate, from the filter's poses (T, 4, 4) on. problem : `batch.Problem`."""
    begin = time.perf_counter()
    solution = batch.solve(problem, batch.start(problem, world_T_imu),
                           still=STILL if problem.loss is batch.cauchy else 0.0)
    return Smoothed(solution, time.perf_counter() - begin)


def no_progress(frames, **_):
    """No progress bar: the default of `run_pipeline`."""
    return frames


STILL = 0.05  # m: what no pose of a real drive moves in the batch's last iteration
TRACK_SIGMA_PX = 1.0  # px. From frame to frame tracks scatter by 0.2 px, but over their life they slip.


def noise_of_real_drive(measured) -> Noise:
    """The noise to filter a real drive with: its IMU's as measured, and 1 px for tracks that slip as they age.

    measured : `measured_noise.MeasuredNoise`.
    """
    return replace(measured.noise, sigma_px=TRACK_SIGMA_PX)


def batch_of_real_drive(drive, noise, scale_sigma=0.0) -> batch.Problem:
    """The batch problem of a real car: its twist changes slowly, its gyro has a bias, some tracks are wrong.

    drive : Drive, cured. noise : Noise of the IMU as measured. scale_sigma : 0 where the speed's scale is known.
    """
    imu_sigma = np.array([0.02, 0.02, 0.02, scale_sigma])  # rad/s, gyro bias; the scale's has no unit
    return batch.Problem(drive, noise, walk_sigma=(0.1, 0.015), imu_sigma=imu_sigma, loss=batch.cauchy)


def joint(drive, noise, error_state, *, metre=None, method="slam", progress=no_progress, **options) -> Slam:
    """The joint filter over a drive, in the metre asked for.

    metre : None, the filter's, which is the cameras', or `scale.of_the_imu`. method : key of `style.COLOURS` that it
    is drawn with. progress : as for `run_pipeline`. options : further ones of `window_slam.run`.
    """
    steps = window_slam.run(drive, noise, error_state, **options)
    frames = progress(steps, total=drive.n_frames, desc="SLAM", unit="frame")
    slam = collect_slam(drive, frames, error_state, method)
    return metre(slam, drive, noise) if metre else slam


def joint_path(drive, noise, error_state, **options) -> np.ndarray:
    """(T, 4, 4): the path of `joint`, same arguments; what `calibration.covariance` runs again and again."""
    return joint(drive, noise, error_state, **options).trajectory.world_T_imu


def run_pipeline(drive, noise, error_state=None, *, gate=0.99, min_disparity=1.0, consider_calibration=False,
                 lens_px=None, progress=no_progress, **options) -> Result:
    """All the report's estimates of one drive.

    noise : of all of them. error_state, gate, min_disparity : of the joint filter, see `window_slam.run`.
    consider_calibration : whether to run the joint filter again with each knob of the calibration turned; lens_px : by
    how much, of the lenses, see `calibration.covariance`. progress : called as tqdm is, with
    total, desc and unit. options : further ones of `joint`. An accelerometer, where a drive has one, is what moves the
    car, from `inertial.initial` on; the truth is then put into the world of the estimate, which has z up.
    """
    if drive.imu is None:
        dead_reckoning = odometry.dead_reckon(drive, noise)
    else:
        begin = inertial.initial(drive, noise)
        dead_reckoning = inertial.dead_reckon(drive, noise, begin)
        options["motion_model"] = partial(inertial.AccelerometerDriven, begin=begin)
        drive = inertial.in_world_of_estimate(drive, dead_reckoning.world_T_imu)
    poses = dead_reckoning.world_T_imu
    initial = first_sight(drive, noise, poses, min_disparity)
    steps = mapping.run(drive, noise, poses, mapping.report_prior, gate=1, min_disparity=min_disparity)
    mapped = collect_mapping(progress(steps, total=drive.n_frames, desc="mapping", unit="frame"))
    options = {"noise": noise, "error_state": error_state or RightPerturbation(), "gate": gate,
               "min_disparity": min_disparity, **options}
    slam = joint(drive, progress=progress, **options)
    added = None
    if consider_calibration:
        added = calibration.covariance(drive, slam.trajectory.world_T_imu, partial(joint_path, **options), progress,
                                       lens_px)
    return Result(drive, noise, dead_reckoning, initial, mapped, slam, gate, added)


def first_sight(drive, noise, world_T_imu, min_disparity=1.0) -> MapBelief:
    """Each landmark where its first good stereo view puts it, the poses (T, 4, 4) assumed known.

    A view is good when its disparity is above `min_disparity` px. Covariance: that of the triangulation alone.
    Source: report section 3.2.1 and figure 2.
    """
    camera = drive.camera
    points, ok = camera.triangulate(drive.pixels, min_disparity)
    rows = np.flatnonzero(ok)[::-1]
    first = np.full(drive.n_landmarks, -1)
    first[drive.landmark[rows]] = rows  # of several writes to one place the last one stays: the first view
    seen = first >= 0
    landmarks, covariance = np.zeros((len(seen), 3)), np.zeros((len(seen), 3, 3))
    poses, points = np.asarray(world_T_imu)[drive.frame[first[seen]]], points[first[seen]]
    landmarks[seen] = camera.to_world(poses, points)
    R = poses[:, :3, :3] @ camera.imu_T_cam[:3, :3]
    covariance[seen] = R @ camera.triangulation_covariance(points, noise.sigma_px) @ np.swapaxes(R, -1, -2)
    return MapBelief(landmarks, covariance, seen)


def collect_mapping(steps) -> Mapped:
    """Listen to the steps of `mapping.run` and keep what a picture needs."""
    threshold = kalman.gate_threshold(0.99)
    measurements = contradicting = 0
    for step in steps:
        measurements += len(step.innovation.ids)
        contradicting += int(np.count_nonzero(~(step.innovation.nis <= threshold)))
    return Mapped(step.posterior, measurements, contradicting)


def collect_slam(drive, steps, error_state, method="slam") -> Slam:
    """Listen to `window_slam.run` and keep what a picture needs.

    steps : of `window_slam.run(drive, ...)` with this error state. A landmark's estimate is its last in the state.
    """
    M = drive.n_landmarks
    landmarks, spread, seen = np.zeros((M, 3)), np.zeros((M, 3, 3)), np.zeros(M, bool)

    def keep(belief, ids):
        rows = np.searchsorted(belief.ids, ids)
        landmarks[ids], seen[ids] = belief.landmarks[rows], True
        spread[ids] = world_landmark_covariance(belief, error_state)[rows]

    def heard():
        last = motion.start(Noise())  # nobody retires before frame 0
        for step in steps:
            if len(step.retired):
                keep(last, step.retired)
            last = step.posterior
            yield step
        keep(last, last.ids)

    begin = time.perf_counter()
    run = record(heard(), error_state)
    seconds = time.perf_counter() - begin
    return Slam(Trajectory(drive.times, run.world_T_imu, run.right_covariance), MapBelief(landmarks, spread, seen),
                run, seconds, method)
