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

from ... import motion, window_slam
from ...drive import Drive
from ...error_state import ErrorState, RightPerturbation
from ...noise import Noise
from ...simulate import faults as recording_faults
from ...stereo import StereoCamera
from ..ch10 import broken_filters as ch10
from ..ch10.broken_filters import wrong

HEALTHY = "nothing"

PIECES = {
    "camera Jacobian": "the derivative of the pixels by the point in the camera frame",
    "triangulation": "the point in the camera frame, from its pixels",
    "landmark Jacobian": "H of the landmark: the derivative of the pixels by its position",
    "pose Jacobian": "H of the pose: the derivative of the pixels by its six errors",
    "correction": "how the estimated error is put into the pose and the landmarks",
    "predicted pose": "where the IMU moves the pose",
    "predicted covariance": "how F and W move the covariance, cross terms included",
    "new landmarks": "mean, covariance and correlation of a landmark at its birth",
    "covariance after the update": "what the filter keeps of the covariance when a frame is done",
    "noise values": "the sigmas that the filter believes of the IMU and of the pixels",
    "IMU": "the IMU's samples in the recording",
    "tracks": "the pixels in the recording, and which landmark they belong to",
    "extrinsics": "where the recording says that the camera sits on the body",
    HEALTHY: "no piece is wrong",
}
KINDS = {
    "sign": "a sign is wrong, or an inverse is missing",
    "transpose": "a matrix is transposed, or is not where it should be",
    "frame": "a quantity of one frame is used as one of another",
    "factor": "a quantity is a constant times what it should be",
    "order": "entries stand in another order than the code assumes",
    "units": "a number in one unit is used as one in another: degrees, pixels",
    "missing": "a term or a step is left out",
    "counted twice": "one measurement is used as two",
    "noise": "more or less noise than is assumed",
    "offset": "a constant is added",
    "timing": "a value belongs to another time",
    "outliers": "some values have nothing to do with the truth",
    HEALTHY: "no piece is wrong",
}
SEEN_BY = {"camera Jacobian": ("H",), "triangulation": ("birth",), "landmark Jacobian": ("H",), "pose Jacobian": ("H",),
           "correction": ("update",), "predicted pose": ("predict",), "predicted covariance": ("predict",),
           "new landmarks": ("birth",), "covariance after the update": ("standing still", "update"),
           "noise values": ("predict",), "IMU": ("recording",), "tracks": ("recording",), "extrinsics": ("recording",)}


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
    levels : in which it is drawn. tests : see `seen_by`, where they are not those of its piece.
    """

    piece: str
    kind: str
    changes: Callable[[float], dict[str, Any]]
    severities: tuple[float, ...] = (1.0,)
    levels: tuple[int, ...] = (1, 2, 3)
    also: tuple[tuple[str, str], ...] = ()
    tests: tuple[str, ...] = ()

    @property
    def answers(self) -> tuple[tuple[str, str], ...]:
        """(piece, kind) pairs that count as right."""
        return ((self.piece, self.kind), *self.also)

    @property
    def seen_by(self) -> tuple[str, ...]:
        """The tests of `clinic.TESTS` that separate it from healthy patients."""
        return self.tests or SEEN_BY.get(self.piece, ())


# --- pieces that are wrong, beyond those of chapter 10 ---------------------------------------------------------

@dataclass(frozen=True, eq=False)
class Edited:
    """What stands at a seam of a Build and makes an edited object. diff : the wrong lines (-) beside the right (+)."""

    make: Callable[..., Any]
    diff: str

    def __call__(self, *arguments: Any) -> Any:
        return self.make(*arguments)


def _camera(kind):
    return {"camera": Edited(lambda camera: kind(camera.K, camera.baseline, camera.cam_T_imu), kind.diff)}


def _state(kind):
    return {"error_state": Edited(lambda camera: kind(), kind.diff)}


def _error(method, *edits):
    """The right perturbation with edits in a method."""
    return _state(wrong(RightPerturbation, method, *edits))


def _gain(factor):
    return _error("retract", ("n = len(landmarks)", f"n, delta = len(landmarks), {factor} * delta"))


def _transition(F):
    """Another F in the prediction."""
    kind = wrong(RightPerturbation, "pose_transition", ("se3.adjoint(se3.inverse(increment))", F))
    return {"motion_model": Edited(lambda drive, noise, error_state: motion.ImuDriven(drive, noise, kind()), kind.diff)}


_MovedInTheWorld = wrong(motion.ImuDriven, "transition", ("belief.world_T_imu @ self.increments[k]",
                                                          "self.increments[k] @ belief.world_T_imu"))
_NextSample = ch10.other_twists("np.vstack([drive.twists[1:], drive.twists[-1:]])")
_DoubledW = wrong(motion.ImuDriven, "__init__", ("noise.twist_covariance", "2 * noise.twist_covariance"))


def _noise(**factors):
    return {"noise": lambda noise: replace(noise, **{key: value * getattr(noise, key)
                                                     for key, value in factors.items()})}


def births_first(prior, ids, pixels, settings):
    """A right frame, built unusually: new landmarks join before the known ones correct. Each is measured once."""
    known = window_slam.contains(prior.ids, ids)
    joined = window_slam.add_correlated(prior, ids[~known], pixels[~known], settings)
    return prior, *window_slam.update(joined, ids[known], pixels[known], settings)


# --- recordings that are wrong --------------------------------------------------------------------------------

def _recorded(change, *arguments, **options):
    return {"recording": lambda drive: change(drive, *arguments, **options)}


def _noisier_gyro(drive, factor):
    extra = np.zeros((drive.n_frames, 6))
    extra[:, 3:] = (factor**2 - 1) ** 0.5 * Noise().sigma_omega * np.random.default_rng(drive.n_landmarks).normal(
        size=(drive.n_frames, 3))
    return drive.replace(twists=drive.twists + extra)


def _fixed(changes):
    return lambda severity: changes


def _frame(process_frame):
    return _fixed({"process_frame": process_frame})


def _model(motion_model):
    return _fixed({"motion_model": motion_model})


_HAT = "J @ se3.so3_hat(s)"
_OR_NOISE = (("noise values", "factor"), ("noise values", "noise"))  # what reads like a factor of W
_OR_W = (("noise values", "factor"), ("predicted covariance", "factor"))  # like a wrong sigma of the IMU

FAULTS: dict[str, Fault] = {
    HEALTHY: Fault(HEALTHY, HEALTHY, _fixed({}), levels=(2, 3)),
    "births first": Fault(HEALTHY, HEALTHY, _frame(births_first), levels=(2, 3)),
    "depth": Fault("camera Jacobian", "factor", _fixed(_camera(ch10.NotDividedByDepth))),
    "bearings": Fault("triangulation", "units", _fixed(_camera(ch10.PixelsAsBearings))),
    "extrinsics": Fault("pose Jacobian", "frame", _fixed({"error_state": ch10.WithoutExtrinsics})),
    "sign": Fault("pose Jacobian", "sign", _fixed(_state(ch10.SignFlipped))),
    "rotation sign": Fault("pose Jacobian", "sign", _fixed(_error("jacobians", (_HAT, f"-{_HAT}")))),
    "position sign": Fault("pose Jacobian", "sign", _fixed(_error("jacobians", ("[-J,", "[J,")))),
    "rotation factor": Fault("pose Jacobian", "factor", lambda s: _error("jacobians", (_HAT, f"{s} * {_HAT}")),
                             (0.5, 2.0)),
    "landmark transposed": Fault("landmark Jacobian", "transpose", _fixed(_error("jacobians", (":3].T", ":3]")))),
    "world": Fault("correction", "frame", _fixed(_state(ch10.WorldCorrection))),
    "copy": Fault("correction", "missing", _fixed(_state(ch10.LandmarksOnACopy))),
    "order": Fault("correction", "order", _fixed(_state(ch10.GroupedOrder))),
    "gain": Fault("correction", "factor", _gain, (0.4, 1.6)),
    "never": Fault("covariance after the update", "missing", _frame(ch10.without_cross_covariance)),
    "cross": Fault("predicted covariance", "missing", _model(ch10.CrossNotPropagated), levels=(2, 3)),
    "F transposed": Fault("predicted covariance", "sign", _fixed(_transition("se3.adjoint(increment)"))),
    "F left out": Fault("predicted covariance", "missing", _fixed(_transition("np.eye(6)")), levels=(2, 3)),
    "tau": Fault("predicted covariance", "factor", _model(ch10.NoiseWithoutTau), also=_OR_NOISE),
    "W doubled": Fault("predicted covariance", "factor", _model(_DoubledW), levels=(2, 3), also=_OR_NOISE),
    "swapped": Fault("predicted pose", "order", _model(ch10.SwappedTwist)),
    "degrees": Fault("predicted pose", "units", _model(ch10.Degrees)),
    "moved in the world": Fault("predicted pose", "frame", _model(_MovedInTheWorld)),
    "next sample": Fault("predicted pose", "timing", _model(_NextSample), levels=(3,), also=(("IMU", "timing"),)),
    "birth": Fault("new landmarks", "missing", _frame(ch10.born_uncorrelated)),
    "twice": Fault("new landmarks", "counted twice", _frame(ch10.used_twice), levels=(2, 3)),
    "prior": Fault("new landmarks", "missing", _frame(window_slam.as_report)),
    "birth sign": Fault("new landmarks", "sign", _fixed(_error("birth", ("-R @", "R @")))),
    "birth not turned": Fault("new landmarks", "frame",
                              _fixed(_error("birth", ("axis=-1), R", "axis=-1), np.eye(3)")))),
    "sigma_px": Fault("noise values", "noise", lambda s: _noise(sigma_px=s), (0.5, 1.6, 2.5), tests=("birth",),
                      also=(("noise values", "factor"),)),
    "sigma_v": Fault("noise values", "noise", lambda s: _noise(sigma_v=s), (0.3, 2.5, 5.0), levels=(2, 3), also=_OR_W),
    "sigma_omega": Fault("noise values", "noise", lambda s: _noise(sigma_omega=s), (0.3, 2.5, 5.0), levels=(2, 3),
                         also=_OR_W),
    "both sigmas": Fault("noise values", "noise", lambda s: _noise(sigma_v=s, sigma_omega=s), (10.0,), also=_OR_W),
    "gyro bias": Fault("IMU", "offset", lambda size: _recorded(recording_faults.add_gyro_bias, [0, 0, size]),
                       (0.08, -0.08, 0.12)),
    "late": Fault("IMU", "timing", lambda samples: _recorded(recording_faults.delay_imu, round(samples)), (3.0, 5.0),
                  levels=(3,)),
    "speed": Fault("IMU", "factor",
                   lambda s: _recorded(lambda drive: drive.replace(twists=drive.twists * np.repeat([s, 1], 3))),
                   (0.8, 1.25)),
    "noisy gyro": Fault("IMU", "noise", lambda factor: _recorded(_noisier_gyro, factor), (3.0, 4.0), levels=(3,)),
    "flipped": Fault("extrinsics", "sign", _fixed(_recorded(recording_faults.flip_imu_axes))),
    "outliers": Fault("tracks", "outliers", lambda share: _recorded(recording_faults.outlier_tracks, share, seed=1),
                      (0.25, 0.4)),
    "copies": Fault("tracks", "timing", _fixed(_recorded(recording_faults.copy_frames)), levels=(3,)),
    "rows": Fault("tracks", "offset",
                  lambda px: _recorded(lambda drive: drive.replace(pixels=drive.pixels + np.array([0, 0, 0, px]))),
                  (2.0, -3.0)),
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
