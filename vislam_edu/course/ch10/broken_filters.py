"""The joint filter with one mistake each, over one drive, from one start.

`VARIANTS` holds them in the order of notebook 10; each replaces one piece of the right filter and nothing else. Where
that piece is a line of the package, it is an edit of that line and shows its diff.
Every mistake was found in a published solution of this very project. Nothing here is right: do not build on it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ... import motion, window_slam
from ...error_state import RightPerturbation
from ...plots.text import two_digits
from ...stereo import StereoCamera
from ...studies.runs import Run, attempt
from ..checks.edit import Edit, diff, edited


def wrong(kind: type, method: str, *edits: Edit) -> Any:
    """A subclass of `kind` with edits in one method; its `diff` shows the wrong lines (-) beside the right ones (+)."""
    right = getattr(kind, method)
    text = f"{kind.__name__}.{method}\n{diff(right, *edits)}"
    return type(kind)(kind.__name__, (kind,), {method: edited(right, *edits), "diff": text})


# --- the camera ---------------------------------------------------------------------------------------------

NotDividedByDepth = wrong(StereoCamera, "projection_jacobian",
                          ("self.K_s @ dpi_dq(q)", "q[..., 2, None, None] * self.K_s @ dpi_dq(q)"))
PixelsAsBearings = wrong(StereoCamera, "triangulate",
                         ("bearing(self.K, np.stack([u_left, 0.5 * (v_left + v_right)], axis=-1))",
                          "np.stack([u_left, v_left, np.ones_like(u_left)], axis=-1)"))

# --- the error state ----------------------------------------------------------------------------------------

SignFlipped = wrong(RightPerturbation, "jacobians", ("[-J, J @", "[J, -J @"))
WorldCorrection = wrong(RightPerturbation, "retract",
                        ("world_T_imu @ se3.exp(delta[3 * n:])", "se3.exp(delta[3 * n:]) @ world_T_imu"))
LandmarksOnACopy = wrong(RightPerturbation, "retract", ("landmarks + delta[:3 * n].reshape(n, 3)", "landmarks"))
GroupedOrder = wrong(RightPerturbation, "retract", (".reshape(n, 3)", ".reshape(3, n).T"))


class WithoutExtrinsics(RightPerturbation):
    """The pose Jacobian -K_s dpi/dq odot(s): what the IMU frame says, written as if in the camera frame.

    No edit: the code multiplies by the extrinsics once, for the landmark and for the pose.
    """

    def __init__(self, camera):
        self.imu_R_cam = camera.imu_T_cam[:3, :3]

    def jacobians(self, world_T_imu, landmarks, J):
        H_landmark, _ = super().jacobians(world_T_imu, landmarks, J)
        return H_landmark, super().jacobians(world_T_imu, landmarks, J @ self.imu_R_cam)[1]


# --- the motion model ---------------------------------------------------------------------------------------

_TAUS = "taus = drive.taus[:, None]\n"


def other_twists(twists):
    """The motion model of other twists than the drive's. twists : how they are written, in terms of `drive`."""
    return wrong(motion.ImuDriven, "__init__", (_TAUS, f"{_TAUS}    drive = drive.replace(twists={twists})\n"))


NoiseWithoutTau = wrong(motion.ImuDriven, "__init__", ("taus[..., None] * se3.right", "se3.right"))
SwappedTwist = other_twists("np.roll(drive.twists, 3, axis=1)")
Degrees = other_twists("np.hstack([drive.twists[:, :3], np.radians(drive.twists[:, 3:])])")


class CrossNotPropagated(motion.ImuDriven):
    """Sigma_LR left as it was while the pose block moved on."""

    def predict(self, belief, k):
        after, n = super().predict(belief, k), belief.pose.start
        P = after.covariance.copy()
        P[:n, n:], P[n:, :n] = belief.covariance[:n, n:], belief.covariance[n:, :n]
        return replace(after, covariance=P)


# --- new landmarks ------------------------------------------------------------------------------------------

def born_uncorrelated(prior, ids, pixels, settings):
    """A frame whose new landmarks are as uncertain as their triangulation, and correlated with nothing."""
    known = window_slam.contains(prior.ids, ids)
    updated, innovation = window_slam.update(prior, ids[known], pixels[known], settings)
    posterior = window_slam.add_correlated(updated, ids[~known], pixels[~known], settings)
    new = ~window_slam.contains(updated.ids, posterior.ids)
    # Old variables are group 0, each new landmark is one of its own; what ties different groups together is cut.
    group = np.append(np.repeat(np.where(new, 1 + np.arange(len(new)), 0), 3), np.zeros(6))
    P = np.where(group[:, None] == group, posterior.covariance, 0.0)
    return prior, replace(posterior, covariance=P), innovation


def used_twice(prior, ids, pixels, settings):
    """A frame that measures its new landmarks a second time, with the pixels they were triangulated from."""
    new = ~window_slam.contains(prior.ids, ids)
    _, posterior, innovation = window_slam.correlated(prior, ids, pixels, settings)
    again = new & window_slam.contains(posterior.ids, ids)
    return prior, window_slam.update(posterior, ids[again], pixels[again], settings)[0], innovation


# --- the covariance after a frame ---------------------------------------------------------------------------

def without_cross_covariance(prior, ids, pixels, settings):
    """A frame after which landmarks and pose are assumed independent: what many first versions do."""
    prior, posterior, innovation = window_slam.correlated(prior, ids, pixels, settings)
    blocks = [*posterior.landmark_covariance, posterior.covariance[posterior.pose.start:, posterior.pose.start:]]
    return prior, replace(posterior, covariance=block_diag(*blocks)), innovation


# --- the filters --------------------------------------------------------------------------------------------

@dataclass(frozen=True, eq=False)
class Variant:
    """A filter with a mistake: its title, what is given to `window_slam.run`, and the exercise whose check catches it.

    applied_to : drive -> (drive, keyword arguments of `window_slam.run`). exercise, mistake : names in `exercises`;
    empty for the right filter. edit : the class that `wrong` made, or None where the mistake is no edit.
    """

    title: str
    applied_to: Callable
    exercise: str = ""
    mistake: str = ""
    edit: Any = None


def _with(**arguments):
    return lambda drive: (drive, arguments)


def _of_edit(title, kind, exercise, mistake):
    """The variant with a camera, an error state or a motion model that `wrong` made."""
    if not issubclass(kind, StereoCamera):
        piece = {"motion_model": kind} if issubclass(kind, motion.ImuDriven) else {"error_state": kind()}
        return Variant(title, _with(**piece), exercise, mistake, kind)

    def applied_to(drive):
        return drive.replace(camera=kind(drive.camera.K, drive.camera.baseline, drive.camera.cam_T_imu)), {}
    return Variant(title, applied_to, exercise, mistake, kind)


VARIANTS = {
    "right": Variant("the right filter", _with()),
    "depth": _of_edit("1/q3 forgotten", NotDividedByDepth, "projection_jacobian", "1/q3 forgotten"),
    "bearings": _of_edit("pixels used as bearings", PixelsAsBearings, "triangulate", "pixels used as bearings"),
    "extrinsics": Variant("extrinsics forgotten",
                          lambda drive: (drive, {"error_state": WithoutExtrinsics(drive.camera)}),
                          "pose_jacobian", "extrinsics forgotten"),
    "sign": _of_edit("pose sign flipped", SignFlipped, "pose_jacobian", "sign flipped"),
    "world": _of_edit("world and body mixed", WorldCorrection, "joint_update", "world and body mixed"),
    "copy": _of_edit("a copy updated", LandmarksOnACopy, "joint_update", "chained indexing updates a copy"),
    "order": _of_edit("orders mixed", GroupedOrder, "joint_update", "interleaved and grouped orders mixed"),
    "never": Variant("cross terms never written", _with(process_frame=without_cross_covariance), "joint_update",
                     "cross-covariances cut"),
    "cross": Variant("cross terms left behind", _with(motion_model=CrossNotPropagated), "predict_joint",
                     "cross-covariances not propagated"),
    "birth": Variant("born uncorrelated", _with(process_frame=born_uncorrelated), "new_landmark",
                     "no correlation with the pose"),
    "twice": Variant("born, then used again", _with(process_frame=used_twice), "new_landmark",
                     "first measurement used twice"),
    "tau": _of_edit("W not scaled by tau", NoiseWithoutTau, "process_noise", "not scaled by tau"),
    "swapped": _of_edit("twist order swapped", SwappedTwist, "se3_exp", "rotation and translation swapped"),
    "degrees": _of_edit("degrees", Degrees, "se3_exp", "degrees"),
}

LOST = 10.0  # m; who was ever as far from the truth as that, in a drive of a minute at most, is lost
_NIS, _NEES = 100, 1000  # above, a number tells nothing more: it depends on the machine's rounding


@dataclass(frozen=True, eq=False)
class Visit:
    """What a piece did on the drive, frame by frame, as far as it came.

    title : of the piece. run : `Run`. error : (T,) m, distance from the truth. nis : (T,), mean over the measurements
    of a frame, 4 if the filter is honest, NaN where it predicted none. nees : (T,) of the pose, 6 if the filter is
    honest, infinite where its covariance is not positive definite.
    """

    title: str
    run: Run
    error: np.ndarray
    nis: np.ndarray
    nees: np.ndarray

    @property
    def lost(self) -> bool:
        """Whether it stopped or was ever `LOST` metres from the truth."""
        return self.run.problem is not None or self.error.max() > LOST

    @property
    def rmse(self) -> float:
        """m, of the position."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def numbers(self) -> tuple[str, str, str]:
        """RMSE of the position, mean NIS and mean NEES, to the digits that do not depend on the machine."""
        rmse = "diverged" if self.lost else f"{self.rmse:.2f} m"
        return rmse, _capped(np.nanmean(self.nis), _NIS), _capped(np.mean(self.nees), _NEES)


def _capped(value, most) -> str:
    return two_digits(value) if value <= most else f"> {most}"


def visit(piece, drive, noise, world_T_imu, gate=1) -> Visit:
    """Drive a piece. drive : Drive with truth. noise : Noise. world_T_imu : (4, 4), where it believes to start.

    There is no gate by default: it would hide a mistake by keeping out the measurements that contradict it.
    A filter that ends in NaN, or with a covariance that is not positive definite, is stopped there; the visit holds
    what was before.
    """
    drive, arguments = piece.applied_to(drive)
    arguments = {"error_state": RightPerturbation()} | arguments
    with np.errstate(all="ignore"):
        run = attempt(window_slam.run(drive, noise, gate=gate, world_T_imu=world_T_imu, **arguments))
        true = drive.true_world_T_imu
        return Visit(piece.title, run, run.errors(true), run.frame_nis, run.nees(true))
