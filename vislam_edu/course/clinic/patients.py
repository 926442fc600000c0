"""The clinic's patients: joint filters and recordings with one fault, two, or none, drawn by a key.

`FAULTS` holds every fault with the piece that it sits in and its kind. A `Build` is what a patient is made of: the
seams of `window_slam.run`, and what happens to the recording. Whoever reads this file can work out which fault a
patient has; an examination takes a secret key (`python -m vislam_edu clinic`).
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ... import motion, se3, window_slam
from ...drive import Drive
from ...error_state import ErrorState, RightPerturbation
from ...noise import Noise
from ...simulate import faults as recording_faults
from ...stereo import StereoCamera
from ..ch10 import broken_filters as museum

HEALTHY = "nothing"

# Where a piece sits: the seam of a Build that a cure replaces.
SEAMS = {
    "camera Jacobian": "camera", "triangulation": "camera",
    "landmark Jacobian": "error_state", "pose Jacobian": "error_state", "correction": "error_state",
    "predicted pose": "motion_model", "predicted covariance": "motion_model",
    "new landmarks": "process_frame", "covariance after the update": "process_frame",
    "noise values": "noise", "IMU": "recording", "tracks": "recording", "extrinsics": "recording",
}
PIECES = (*SEAMS, HEALTHY)
KINDS = ("sign", "transpose", "frame", "factor", "order", "units", "missing", "counted twice", "noise", "offset",
         "timing", "outliers", HEALTHY)


def unchanged(value: Any) -> Any:
    """What a healthy patient does with its camera, its noise and its recording."""
    return value


def right_perturbation(camera: StereoCamera) -> ErrorState:
    """The error state of a healthy patient."""
    return RightPerturbation()


@dataclass(frozen=True, eq=False)
class Build:
    """What a patient is made of; the defaults are healthy.

    camera : StereoCamera -> StereoCamera, what the filter computes with. error_state : StereoCamera -> ErrorState.
    motion_model, process_frame : as in `window_slam.run`. noise : Noise -> Noise, what the filter believes of the
    sensors. recording : Drive -> Drive, what became of the recording before the filter got it.
    """

    camera: Callable[[StereoCamera], StereoCamera] = unchanged
    error_state: Callable[[StereoCamera], ErrorState] = right_perturbation
    motion_model: Callable[..., motion.MotionModel] = motion.ImuDriven
    process_frame: Callable[..., window_slam.Frame] = window_slam.correlated
    noise: Callable[[Noise], Noise] = unchanged
    recording: Callable[[Drive], Drive] = unchanged


@dataclass(frozen=True, eq=False)
class Fault:
    """One fault. piece, kind : the answer; also : further answers that no test can tell apart.

    changes : severity -> {seam of `Build`: what stands there}. severities : one is drawn.
    levels : in which it is drawn. seen_by : the tests of `clinic.TESTS` that separate it from healthy patients.
    """

    piece: str
    kind: str
    changes: Callable[[float], dict[str, Any]]
    severities: tuple[float, ...] = (1.0,)
    levels: tuple[int, ...] = (1, 2, 3)
    also: tuple[tuple[str, str], ...] = ()
    seen_by: tuple[str, ...] = ()

    @property
    def answers(self) -> tuple[tuple[str, str], ...]:
        """(piece, kind) pairs that count as right."""
        return ((self.piece, self.kind), *self.also)


# --- pieces that are wrong, beyond those of the museum --------------------------------------------------------

def _camera(kind):
    return {"camera": lambda camera: kind(camera.K, camera.baseline, camera.cam_T_imu)}


def _pose_columns(factors):
    """The pose Jacobian with its six columns multiplied."""
    class Scaled(RightPerturbation):
        def jacobians(self, world_T_imu, landmarks, J):
            H_landmark, H_pose = super().jacobians(world_T_imu, landmarks, J)
            return H_landmark, H_pose * factors
    return {"error_state": lambda camera: Scaled()}


class _LandmarkTransposed(RightPerturbation):
    """J R, where J R^T belongs."""

    def jacobians(self, world_T_imu, landmarks, J):
        return J @ world_T_imu[:3, :3], super().jacobians(world_T_imu, landmarks, J)[1]


def _gain(factor):
    class Scaled(RightPerturbation):
        def retract(self, world_T_imu, landmarks, delta):
            return super().retract(world_T_imu, landmarks, factor * delta)
    return {"error_state": lambda camera: Scaled()}


class _BirthSign(RightPerturbation):
    """G = R [I, +s^]."""

    def birth(self, world_T_imu, points_imu):
        G, A = super().birth(world_T_imu, points_imu)
        return G * np.repeat([1, -1], 3), A


class _BirthNotTurned(RightPerturbation):
    """The triangulation's covariance left in the IMU frame."""

    def birth(self, world_T_imu, points_imu):
        return super().birth(world_T_imu, points_imu)[0], np.eye(3)


def _transition(F):
    """F as a function of the step's increment."""
    class Changed(RightPerturbation):
        def pose_transition(self, after, increment, body_noise):
            return F(increment), body_noise

    def model(drive, noise, error_state):
        return motion.ImuDriven(drive, noise, Changed())
    return {"motion_model": model}


class _MovedInTheWorld(motion.ImuDriven):
    """exp(tau u^) T."""

    def predict(self, belief, k):
        return replace(super().predict(belief, k), world_T_imu=self.increments[k] @ belief.world_T_imu)


class _NextSample(motion.ImuDriven):
    """Step k driven by the sample of frame k + 1."""

    def __init__(self, drive, noise, error_state):
        super().__init__(drive.replace(twists=np.vstack([drive.twists[1:], drive.twists[-1:]])), noise, error_state)


class _DoubledW(motion.ImuDriven):
    """2 W."""

    def __init__(self, drive, noise, error_state):
        super().__init__(drive, noise, error_state)
        self.Q = 2 * self.Q


def _noise(**factors):
    return {"noise": lambda noise: replace(noise, **{key: value * getattr(noise, key)
                                                     for key, value in factors.items()})}


def births_first(prior, ids, pixels, settings):
    """A right frame, built unusually: new landmarks join before the known ones correct. Each is measured once."""
    known = window_slam.contains(prior.ids, ids)
    joined = window_slam.add_correlated(prior, ids[~known], pixels[~known], settings)
    return prior, *window_slam.update(joined, ids[known], pixels[known], settings)


# --- recordings that are wrong --------------------------------------------------------------------------------

def _recording(change):
    return {"recording": change}


def _scaled_speed(factor):
    return _recording(lambda drive: drive.replace(twists=drive.twists * np.repeat([factor, 1], 3)))


def _noisy_gyro(factor):
    def noisier(drive):
        sigma = (factor**2 - 1) ** 0.5 * Noise().sigma_omega
        extra = sigma * np.random.default_rng(drive.n_landmarks).normal(size=(drive.n_frames, 3))
        return drive.replace(twists=drive.twists + np.hstack([np.zeros_like(extra), extra]))
    return _recording(noisier)


def _row_offset(px):
    return _recording(lambda drive: drive.replace(pixels=drive.pixels + np.array([0, 0, 0, px])))


def _late(samples):
    return _recording(lambda drive: recording_faults.delay_imu(drive, round(samples)))


def _bias(size):
    return _recording(lambda drive: recording_faults.add_gyro_bias(drive, [0, 0, size]))


def _outliers(share):
    return _recording(lambda drive: recording_faults.outlier_tracks(drive, share, seed=1))


def _fixed(changes):
    return lambda severity: changes


def _state(kind):
    return {"error_state": lambda camera: kind()}


FAULTS: dict[str, Fault] = {
    HEALTHY: Fault(HEALTHY, HEALTHY, _fixed({}), levels=(2, 3)),
    "births first": Fault(HEALTHY, HEALTHY, _fixed({"process_frame": births_first}), levels=(2, 3)),
    "depth": Fault("camera Jacobian", "factor", _fixed(_camera(museum.NotDividedByDepth)), seen_by=("H",)),
    "bearings": Fault("triangulation", "units", _fixed(_camera(museum.PixelsAsBearings)), seen_by=("birth",)),
    "extrinsics": Fault("pose Jacobian", "frame",
                        _fixed({"error_state": museum.WithoutExtrinsics}), seen_by=("H",)),
    "sign": Fault("pose Jacobian", "sign", _fixed(_pose_columns(-1.0)), seen_by=("H",)),
    "rotation sign": Fault("pose Jacobian", "sign", _fixed(_pose_columns(np.repeat([1, -1], 3))), seen_by=("H",)),
    "position sign": Fault("pose Jacobian", "sign", _fixed(_pose_columns(np.repeat([-1, 1], 3))), seen_by=("H",)),
    "rotation factor": Fault("pose Jacobian", "factor", lambda s: _pose_columns(np.repeat([1, s], 3)), (0.5, 2.0),
                             seen_by=("H",)),
    "landmark transposed": Fault("landmark Jacobian", "transpose", _fixed(_state(_LandmarkTransposed)),
                                 seen_by=("H",)),
    "world": Fault("correction", "frame", _fixed(_state(museum.WorldCorrection)), seen_by=("update",)),
    "copy": Fault("correction", "missing", _fixed(_state(museum.LandmarksOnACopy)), seen_by=("update",)),
    "order": Fault("correction", "order", _fixed(_state(museum.GroupedOrder)), seen_by=("update",)),
    "gain": Fault("correction", "factor", _gain, (0.4, 1.6), seen_by=("update",)),
    "never": Fault("covariance after the update", "missing", _fixed({"process_frame": museum.without_cross_covariance}),
                   seen_by=("standing still", "update")),
    "cross": Fault("predicted covariance", "missing", _fixed({"motion_model": museum.CrossNotPropagated}),
                   levels=(2, 3), seen_by=("predict",)),
    "F transposed": Fault("predicted covariance", "sign", _fixed(_transition(se3.adjoint)), seen_by=("predict",)),
    "F left out": Fault("predicted covariance", "missing", _fixed(_transition(lambda increment: np.eye(6))),
                        levels=(2, 3), seen_by=("predict",)),
    "tau": Fault("predicted covariance", "factor", _fixed({"motion_model": museum.NoiseWithoutTau}),
                 also=(("noise values", "factor"), ("noise values", "noise")), seen_by=("predict",)),
    "W doubled": Fault("predicted covariance", "factor", _fixed({"motion_model": _DoubledW}), levels=(2, 3),
                       also=(("noise values", "factor"), ("noise values", "noise")), seen_by=("predict",)),
    "swapped": Fault("predicted pose", "order", _fixed({"motion_model": museum.SwappedTwist}), seen_by=("predict",)),
    "degrees": Fault("predicted pose", "units", _fixed({"motion_model": museum.Degrees}), seen_by=("predict",)),
    "moved in the world": Fault("predicted pose", "frame", _fixed({"motion_model": _MovedInTheWorld}),
                                seen_by=("predict",)),
    "next sample": Fault("predicted pose", "timing", _fixed({"motion_model": _NextSample}), levels=(3,),
                         also=(("IMU", "timing"),), seen_by=("predict",)),
    "birth": Fault("new landmarks", "missing", _fixed({"process_frame": museum.born_uncorrelated}),
                   seen_by=("birth",)),
    "twice": Fault("new landmarks", "counted twice", _fixed({"process_frame": museum.used_twice}), levels=(2, 3),
                   seen_by=("birth",)),
    "prior": Fault("new landmarks", "missing", _fixed({"process_frame": window_slam.as_report}), seen_by=("birth",)),
    "birth sign": Fault("new landmarks", "sign", _fixed(_state(_BirthSign)), seen_by=("birth",)),
    "birth not turned": Fault("new landmarks", "frame", _fixed(_state(_BirthNotTurned)), seen_by=("birth",)),
    "sigma_px": Fault("noise values", "noise", lambda s: _noise(sigma_px=s), (0.5, 1.6, 2.5), seen_by=("birth",),
                      also=(("noise values", "factor"),)),
    "sigma_v": Fault("noise values", "noise", lambda s: _noise(sigma_v=s), (0.3, 2.5, 5.0), levels=(2, 3),
                     also=(("noise values", "factor"), ("predicted covariance", "factor")), seen_by=("predict",)),
    "sigma_omega": Fault("noise values", "noise", lambda s: _noise(sigma_omega=s), (0.3, 2.5, 5.0), levels=(2, 3),
                         also=(("noise values", "factor"), ("predicted covariance", "factor")), seen_by=("predict",)),
    "both sigmas": Fault("noise values", "noise", lambda s: _noise(sigma_v=s, sigma_omega=s), (10.0,),
                         also=(("noise values", "factor"), ("predicted covariance", "factor")), seen_by=("predict",)),
    "gyro bias": Fault("IMU", "offset", _bias, (0.08, -0.08, 0.12), seen_by=("recording",)),
    "late": Fault("IMU", "timing", _late, (3.0, 5.0), levels=(3,), seen_by=("recording",)),
    "speed": Fault("IMU", "factor", _scaled_speed, (0.8, 1.25), seen_by=("recording",)),
    "noisy gyro": Fault("IMU", "noise", _noisy_gyro, (3.0, 4.0), levels=(3,), seen_by=("recording",)),
    "flipped": Fault("extrinsics", "sign", _fixed(_recording(recording_faults.flip_imu_axes)), seen_by=("recording",)),
    "outliers": Fault("tracks", "outliers", _outliers, (0.25, 0.4), seen_by=("recording",)),
    "copies": Fault("tracks", "timing", _fixed(_recording(recording_faults.copy_frames)), levels=(3,),
                    seen_by=("recording",)),
    "rows": Fault("tracks", "offset", _row_offset, (2.0, -3.0), seen_by=("recording",)),
}


# --- drawing --------------------------------------------------------------------------------------------------

@dataclass(frozen=True, eq=False)
class Drawn:
    """What was drawn: the names of the faults, the build that has them, and a seed for the patient's drives."""

    faults: tuple[str, ...]
    build: Build = field(repr=False)
    seed: int

    @property
    def healthy(self) -> bool:
        return all(FAULTS[name].piece == HEALTHY for name in self.faults)


def stream(key: str, *what: Any) -> np.random.Generator:
    """The random numbers that belong to a key and a purpose: a keyed hash, the same on every machine."""
    text = " ".join(map(str, what)).encode()
    digest = hashlib.blake2s(text, key=hashlib.blake2s(key.encode()).digest()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8]))


FIRST = ("tau", "never", "births first")  # the first three patients of level 1, in this order, for everyone


def draw(student: int | str, number: int, level: int, key: str = "") -> Drawn:
    """Patient `number` (from 1) of a student at a level (1, 2 or 3). key : secret of an examination, "" for practice.

    In practice the first three patients of level 1 are the same for everyone: `FIRST`.
    Raises ValueError for another level or number.
    """
    if level not in (1, 2, 3) or number < 1:
        raise ValueError(f"patients are numbered from 1, levels are 1, 2 and 3; got {number} and {level}")
    rng = stream(key, "patient", student, number, level)
    seed = int(rng.integers(2**31))
    if not key and level == 1 and number <= len(FIRST):
        return of(FIRST[number - 1:number], rng, seed)
    names = [name for name, fault in FAULTS.items() if level in fault.levels]
    healthy = [name for name in names if FAULTS[name].piece == HEALTHY]
    sick = [name for name in names if name not in healthy]
    if healthy and rng.random() < 0.2:
        return of((str(rng.choice(healthy)),), rng, seed)
    first = str(rng.choice(sick))
    if level < 3 or rng.random() < 0.5:
        return of((first,), rng, seed)
    seams = set(FAULTS[first].changes(1.0))
    others = [name for name in sick if not seams & set(FAULTS[name].changes(1.0))]
    return of((first, str(rng.choice(others))), rng, seed)


def of(names: tuple[str, ...], rng: np.random.Generator, seed: int) -> Drawn:
    """A patient with these faults, their severities drawn by `rng`; its drives come from `seed`."""
    build = Build()
    for name in names:
        fault = FAULTS[name]
        build = replace(build, **fault.changes(float(rng.choice(fault.severities))))
    return Drawn(tuple(names), build, seed)
