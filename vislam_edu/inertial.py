"""The joint filter with a real IMU: pose, velocity and both biases are estimated, gyro and accelerometer move them.

    for step in window_slam.run(drive, noise, RightInvariant(), motion_model=inertial.AccelerometerDriven):
        step.posterior.motion          # velocity (world), gyro bias, accelerometer bias

`imu` has the mathematics, with a state R, p, v, b_g, b_a. Here it meets the filter's order [p, R, v, b_g, b_a], and an
`ErrorState`, which decides what an error of position and rotation is. The velocity is a vector of the world as the
position is, and its error is defined in the same way: with the right-invariant error the three become one element of
SE_2(3), and F holds nothing but the identity, tau and gravity wherever no bias is involved.

Source: Barrau, Bonnabel, The invariant extended Kalman filter as a stable observer, 2017; Hartley et al.,
Contact-aided invariant extended Kalman filtering, 2020.

>>> samples = ImuSamples(np.arange(200) * 0.005, np.full((200, 3), 0.01), np.tile([0, 0, 9.9], (200, 1)))
>>> round(still_until(samples), 3)
0.995
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from . import imu, motion, se3, window_slam
from .belief import Belief
from .drive import Drive, DriveError
from .error_state import ErrorState, InverseDepth, RightPerturbation
from .imu import ADIS16448, ImuNoise, State
from .noise import Noise
from .odometry import Trajectory

NAMES_THE_WORLD = np.diag(np.repeat([1e-8, 1e-8, 1e-6, 0, 0], 3))  # what is zero by definition at the start
BIAS_SIGMA = np.repeat([0.1, 0.2], 3)  # rad/s and m/s^2, what a bias may be before anything was measured
STILL = 0.02, 0.3  # rad/s and m/s^2: how far the samples of an IMU at rest may spread
LEAST_STILL, STILL_PX = 0.3, 2.0  # s, the shortest stand-still to start from; px, the median track in that time
UP = 0.2  # rad, how far up may be estimated wrongly
ALIGN = 2.0  # s, of a drive that begins in motion: how much of it its start is found from
LEAST_TRACKS, PATH_SIGMA = 8, 0.02  # in each frame of that part; m, of the cameras' path over it


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """What an IMU measured. Sample k lasts from times[k] to times[k + 1].

    times : (n,) s, increasing. gyro : (n, 3), rad/s. accelerometer : (n, 3), m/s^2, specific force. noise : `ImuNoise`.
    Raises DriveError.
    """

    times: np.ndarray
    gyro: np.ndarray
    accelerometer: np.ndarray
    noise: ImuNoise = ADIS16448

    def __post_init__(self) -> None:
        n = np.size(self.times)
        for name, shape in (("times", (n,)), ("gyro", (n, 3)), ("accelerometer", (n, 3))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise DriveError(f"imu {name}: shape {value.shape}, expected {shape}")
            if not np.isfinite(value).all():
                raise DriveError(f"imu {name}: sample {np.argwhere(~np.isfinite(value))[0, 0]} is not finite")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        stuck = np.flatnonzero(np.diff(self.times) <= 0)
        if stuck.size:
            raise DriveError(f"imu times: do not increase, sample {stuck[0] + 1} is at {self.times[stuck[0] + 1]} s")

    def between(self, start: float, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gyro (n, 3), accelerometer (n, 3) and how long each lasts (n,), s, from start to end: what `imu` takes.

        Raises DriveError where there are no samples.
        """
        if start < self.times[0] - 1e-6 or end > self.times[-1] + 1e-6:
            raise DriveError(f"imu times: from {self.times[0]} to {self.times[-1]} s, no samples between the frames "
                             f"at {start} and {end} s")
        first, last = np.searchsorted(self.times, [start, end])
        edges = np.concatenate([[start], self.times[first:last], [end]])
        edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])]
        rows = np.searchsorted(self.times, edges[:-1] + 1e-9, side="right") - 1
        return self.gyro[rows], self.accelerometer[rows], np.diff(edges)


def samples_of(drive: Drive) -> ImuSamples:
    """The samples of a drive. Raises DriveError for one without an accelerometer, or whose samples do not cover it."""
    if drive.imu is None:
        raise DriveError(f"{drive.name or 'this drive'} has no accelerometer (imu is None)")
    drive.imu.between(drive.times[0], drive.times[-1])
    return drive.imu


def to_imu_order(error_state: ErrorState, world_T_imu: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(15, 15): error of a filter [p, R, v, b_g, b_a] to that of `imu` [R, p, v, b_g, b_a], to first order."""
    R = world_T_imu[:3, :3]
    pose, moving = error_state.world_pose(world_T_imu), error_state.world_pose(se3.pose(R, velocity))
    M = np.eye(15)
    M[imu.ROTATION, :6] = R.T @ pose[3:]
    M[imu.POSITION, :6] = pose[:3]
    M[imu.VELOCITY, 3:6], M[imu.VELOCITY, 6:9] = moving[:3, 3:], moving[:3, :3]
    return M


class AccelerometerDriven(motion.MotionModel):
    """The motion model of a real IMU: nine states join the pose, motion = [velocity, gyro bias, accelerometer bias].

    begin : state at frame 0 and its covariance (15, 15), in the order of `imu`; by default `initial`. The IMU's own
    noise is that of the samples. Raises DriveError for a drive without samples.
    """

    def __init__(self, drive: Drive, noise: Noise, error_state: ErrorState,
                 begin: tuple[State, np.ndarray] | None = None) -> None:
        self.samples, self.times, self.drive, self.noise = samples_of(drive), drive.times, drive, noise
        self.error_state, self.begin = error_state, begin
        self.no_points = np.empty((0, *error_state.point_shape))

    def start(self, world_T_imu: np.ndarray | None = None) -> Belief:
        """The belief at frame 0. A pose given takes the place of the one that the samples show."""
        state, P = self.begin or initial(self.drive, self.noise)
        if world_T_imu is not None:
            T = np.array(world_T_imu)
            turn = T[:3, :3] @ state.rotation.T
            state = replace(state, rotation=T[:3, :3], position=T[:3, 3], velocity=turn @ state.velocity)
        T = se3.pose(state.rotation, state.position)
        M = np.linalg.inv(to_imu_order(self.error_state, T, state.velocity))
        return Belief(T, self.no_points, np.empty(0, dtype=int), motion.symmetric(M @ P @ M.T),
                      np.concatenate([state.velocity, state.gyro_bias, state.accelerometer_bias]))

    def transition(self, belief: Belief, k: int) -> motion.Transition:
        """From frame k to frame k + 1 along the samples between them, joined into one motion."""
        state = state_of(belief)
        joined = imu.preintegrate(*self.samples.between(*self.times[k:k + 2]), state.gyro_bias,
                                  state.accelerometer_bias, self.samples.noise)
        end = imu.predict(state, joined)
        after = se3.pose(end.rotation, end.position)
        F, Q = imu.transition(state.rotation, joined)
        N = np.linalg.inv(to_imu_order(self.error_state, after, end.velocity))
        F = N @ F @ to_imu_order(self.error_state, belief.world_T_imu, state.velocity)
        moved = self.error_state.landmark_transition
        return motion.Transition(after, np.concatenate([end.velocity, belief.motion[3:]]), F,
                                 moved(belief.points, (F - np.eye(15))[:6]), N, moved(belief.points, N[:6]), Q)

    def retract_motion(self, belief: Belief, delta: np.ndarray) -> np.ndarray:
        """The velocity is corrected as a position is, the biases by a sum."""
        as_pose = se3.pose(belief.world_T_imu[:3, :3], belief.motion[:3])
        moved, _ = self.error_state.retract(as_pose, self.no_points, delta[np.r_[6:9, 3:6]])
        return np.concatenate([moved[:3, 3], belief.motion[3:] + delta[9:]])


def state_of(belief: Belief) -> State:
    """The mean of a belief as a `State` of `imu`."""
    T, values = belief.world_T_imu, belief.motion
    return State(T[:3, :3], T[:3, 3], values[:3], values[3:6], values[6:9])


def true_states(start: np.ndarray, world_T_imu: np.ndarray, velocities: np.ndarray, biases: np.ndarray) -> list[State]:
    """The truth in the world in which an estimate begins, at the pose `start` (4, 4): its state at each of T frames.

    world_T_imu : (T, 4, 4). velocities : (T, 3), m/s. biases : (T, 6), rad/s and m/s^2.
    """
    W = in_world_of(start, world_T_imu[0])
    poses, velocities = W @ world_T_imu, velocities @ W[:3, :3].T
    return [State(T[:3, :3], T[:3, 3], v, b[:3], b[3:]) for T, v, b in zip(poses, velocities, biases)]


def error(belief: Belief, true: State, error_state: ErrorState) -> np.ndarray:
    """(15,), the error [p, R, v, b_g, b_a] of a belief in its own coordinates: what its covariance speaks of."""
    mean = state_of(belief)

    def difference(of: np.ndarray, by: np.ndarray) -> np.ndarray:
        return error_state.pose_difference(se3.pose(true.rotation, of), se3.pose(mean.rotation, by))

    return np.concatenate([difference(true.position, mean.position), difference(true.velocity, mean.velocity)[:3],
                           true.difference(mean)[imu.BIASES]])


def in_world_of(start: np.ndarray, world_T_imu: np.ndarray) -> np.ndarray:
    """W (4, 4), which takes a world with z up to the one in which an estimate begins, at the pose `start` (4, 4).

    world_T_imu : (4, 4), the true pose there. A turn about up and a shift: the four numbers that no IMU and no camera
    measures. What remains between W world_T_imu and `start` is an error of roll and pitch.
    """
    turn = start[:3, :3] @ world_T_imu[:3, :3].T
    R = se3.so3_exp([0, 0, np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])])
    return se3.pose(R, start[:3, 3] - R @ world_T_imu[:3, 3])


def in_world_of_estimate(drive: Drive, world_T_imu: np.ndarray) -> Drive:
    """The drive with its truth in the world of estimated poses (T, 4, 4), which has z up, see `in_world_of`.

    Where the truth's own world has another axis up, by more than `UP`, the two first poses become the same.
    """
    if not drive.has_truth:
        return drive
    truth = drive.true_world_T_imu
    first = np.flatnonzero(np.isfinite(truth[:, 0, 0]))[0]
    W = in_world_of(world_T_imu[first], truth[first])
    if (W @ truth[first])[2, :3] @ world_T_imu[first, 2, :3] < np.cos(UP):
        W = world_T_imu[first] @ se3.inverse(truth[first])
    landmarks = drive.truth_landmarks
    return drive.replace(truth_world_T_cam=W @ drive.truth_world_T_cam,
                         truth_landmarks=None if landmarks is None else se3.transform(W, landmarks))


def still_until(samples: ImuSamples, start: float = -np.inf, window: float = 0.2) -> float:
    """The time, s, until which the IMU stands still: within `STILL` of the first `window` s. `start` : s, from where.

    A car at constant speed on a smooth road looks the same: no IMU can tell.
    """
    rows = samples.times >= start
    times, values = samples.times[rows], np.hstack([samples.gyro, samples.accelerometer])[rows]
    first = values[times <= times[0] + window].mean(axis=0)
    size = max(1, np.searchsorted(times, times[0] + window / 4))
    sums = np.cumsum(np.concatenate([np.zeros((1, 6)), values - first]), axis=0)
    means = np.abs(sums[size:] - sums[:-size]) / size  # over a twentieth of a second: noise is no motion
    moving = np.flatnonzero((means > np.repeat(STILL, 3)).any(axis=1))
    return float(times[moving[0]]) if moving.size else float(times[-1])


def stands_still(drive: Drive) -> bool:
    """Whether a drive begins with a stand-still of at least `LEAST_STILL`: neither its IMU nor its tracks move.

    Raises DriveError without samples.
    """
    until = drive.times[0] + LEAST_STILL
    ids, pixels = drive.observed(0)
    later, moved = drive.observed(min(int(np.searchsorted(drive.times, until)), drive.n_frames - 1))
    _, a, b = np.intersect1d(ids, later, return_indices=True)
    tracks_rest = len(a) == 0 or np.median(np.abs(moved[b] - pixels[a])) < STILL_PX
    return bool(tracks_rest and still_until(samples_of(drive), drive.times[0]) >= until)


def initial(drive: Drive, noise: Noise) -> tuple[State, np.ndarray]:
    """State and covariance (15, 15), order of `imu`, at frame 0: from a stand-still, without one from `aligned`."""
    samples, start = samples_of(drive), drive.times[0]
    if not stands_still(drive):
        return aligned(drive, noise)
    state, P = imu.stand_still(*samples.between(start, still_until(samples, start)), samples.noise, BIAS_SIGMA[3])
    return state, P + NAMES_THE_WORLD


def camera_path(drive: Drive, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Poses (T, 4, 4) in the IMU frame at frame 0, and the gyro's bias (3,), rad/s, from cameras and gyro alone.

    The filter of `motion.TwistAndBias` without a measured speed: an acceleration of about 5 m/s^2 may change it.
    """
    samples, tau = samples_of(drive), drive.taus.mean()
    pieces = [samples.between(*ends) for ends in pairwise(drive.times)]
    omega = np.array([np.average(gyro, axis=0, weights=taus) for gyro, _, taus in pieces])
    twists = np.pad(np.concatenate([omega, omega[-1:]]), ((0, 0), (3, 0)))
    steps = window_slam.run(drive.replace(twists=twists, imu_sample="k"), replace(noise, sigma_v=1e3, sigma_omega=0.01),
                            InverseDepth(), motion_model=partial(motion.TwistAndBias, walk_v=5 * tau,
                                                                 walk_omega=5 * tau))
    beliefs = [step.posterior for step in steps]
    return np.array([belief.world_T_imu for belief in beliefs]), beliefs[-1].motion[6:]


def aligned(drive: Drive, noise: Noise) -> tuple[State, np.ndarray]:
    """State and covariance (15, 15), order of `imu`, at frame 0 of a drive that begins in motion.

    The cameras' path p_k of the first `ALIGN` s, in the IMU frame at frame 0, is what the preintegrated samples say
    for the right velocity v, gravity g and accelerometer bias b: p_k = v t + g t^2 / 2 + (motion) + (its derivative) b.
    This is linear in these nine numbers; |g| is known. The covariance is wide: the filter then uses the same samples
    and pixels again, from a start that is near enough to linearise at.
    Raises DriveError where too few tracks are in view.
    Source: Qin, Li, Shen, VINS-Mono, 2018, section V-B, for cameras whose scale is known.
    """
    samples, begin, g = samples_of(drive), drive.times[0], np.linalg.norm(imu.GRAVITY)
    first = drive.slice(0, int(np.searchsorted(drive.times, begin + ALIGN)))
    if first.n_frames < 5 or first.visible.min() < LEAST_TRACKS:
        raise DriveError(f"{drive.name or 'this drive'} begins without a stand-still of {LEAST_STILL} s, and its first "
                         f"{ALIGN:g} s have frames with fewer than {LEAST_TRACKS} tracks: begin it at rest, or "
                         "later, where more is in view")
    path, gyro_bias = camera_path(first, noise)
    motions = [imu.preintegrate(*samples.between(begin, end), gyro_bias, np.zeros(3), samples.noise)
               for end in first.times[1:]]
    A = np.concatenate([np.hstack([m.duration * np.eye(3), m.duration**2 / 2 * np.eye(3),
                                   m.bias_jacobian[imu.POSITION, 3:]]) for m in motions]) / PATH_SIGMA
    r = np.concatenate([T[:3, 3] - m.position for T, m in zip(path[1:], motions)]) / PATH_SIGMA
    A, r = np.vstack([A, np.eye(3, 9, 6) / BIAS_SIGMA[3]]), np.append(r, np.zeros(3))
    x = np.linalg.lstsq(A, r)[0]
    for _ in range(3):  # the length of g is known: along the direction found so far it is a linear equation
        length = np.pad(x[3:6] / np.linalg.norm(x[3:6]), 3)
        x = np.linalg.lstsq(np.vstack([A, 1e3 * length]), np.append(r, 1e3 * g))[0]
    R = imu.upright(-x[3:6] / np.linalg.norm(x[3:6]))
    state = State(R, np.zeros(3), R @ x[:3], gyro_bias, x[6:])
    P = np.diag(np.square(np.repeat([0.0, 0.0, 0.3, 0.01, BIAS_SIGMA[3]], 3)))
    P[imu.ROTATION, imu.ROTATION] = 0.03**2 * (np.eye(3) - np.outer(R[2], R[2]))  # about up it names the world
    return state, P + NAMES_THE_WORLD


def dead_reckon(drive: Drive, noise: Noise, begin: tuple[State, np.ndarray]) -> Trajectory:
    """Gyro and accelerometer integrated with nothing to correct them, from `begin` on, see `AccelerometerDriven`."""
    model = AccelerometerDriven(drive, noise, RightPerturbation(), begin)
    beliefs = [model.start()]
    for k in range(drive.n_frames - 1):
        beliefs.append(model.predict(beliefs[-1], k))
    return Trajectory(drive.times, np.array([b.world_T_imu for b in beliefs]),
                      np.array([b.pose_covariance for b in beliefs]))
