"""Chapter 8: each cure of a recording switched on and off, the filter run again, the path held against the truth."""

import numpy as np

from ... import metrics, se3, window_slam
from ...error_state import RightInvariant
from ...motion import TwistAndBias
from ...plots.style import COLOURS
from ...studies import pipeline
from ...widgets.canvas import Picture, Switch
from ..panels import add_axes, fit_equal, legend, moving_line

LOST = 20.0  # % of drift: beyond it there is nothing to compare


class CuredRun:
    """What the filter made of the recording with some of its cures applied.

    path, reference : (T, 4, 4) poses of the left camera, the world being that camera at frame 0.
    error : (T,) m from the reference. drift_percent : KITTI's, of the reference. ate_m : after alignment.
    rejected_share : of the measurements, kept out by the gate.
    """

    def __init__(self, path, rejected_share, reference):
        self.path, self.rejected_share = path, rejected_share
        self.error = np.linalg.norm(path[:, :3, 3] - reference[:, :3, 3], axis=-1)
        self.drift_percent, self.ate_m = metrics.kitti_drift(reference, path)[0], metrics.ate(reference, path)

    @property
    def lost(self) -> bool:
        """True when the path has nothing to do with the reference."""
        return bool(self.drift_percent > LOST)

    def __str__(self):
        drift, ate = round(self.drift_percent, 3), round(self.ate_m, 3)
        accuracy = "lost" if self.lost else f"drift {drift:.2g} %, ATE {ate:.2g} m"
        return f"{accuracy}; the gate keeps out {100 * self.rejected_share:.0f} %"


def camera_path(world_T_cam):
    """(T, 4, 4): the poses expressed in the frame of the first one, which does not depend on the IMU's axes."""
    return se3.inverse(world_T_cam[np.isfinite(world_T_cam[:, 0, 0])][0]) @ world_T_cam


def ground(path):
    """(T, 2) m, forward and left of the first camera: its z axis, and its x axis turned round."""
    return np.stack([path[:, 2, 3], -path[:, 0, 3]], axis=-1)


class CuresPicture(Picture):
    """The path from above and its distance from the reference, with a switch for each cure that the audit names.

    report : `report.Report`. noise : Noise. Findings without a cure have no switch.
    The reference is the ground truth; a recording without it is held against the path with every cure, which says what
    a cure changes and not whether it is right.
    faults : names of the findings with a cure, in the order of the audit.
    """

    name = "cures"
    size = (6.4, 3.9)

    def __init__(self, report, noise):
        self.report, self.noise = report, noise
        self._cures = {finding.fault: finding.cure for finding in report.findings if finding.cure}
        self.faults = tuple(self._cures)
        self.controls = {fault.replace(" ", "_"): Switch(f"cure {fault}") for fault in self.faults}  # in the same order
        self._outcomes = {}
        self.truth = report.drive.truth_world_T_cam is not None
        self.reference = camera_path(report.drive.truth_world_T_cam) if self.truth else self._path(self.faults)[0]
        super().__init__()

    def _path(self, faults):
        """(path, rejected share) with the cures of these faults; each combination is filtered once."""
        drive, error_state = self.report.drive, RightInvariant()
        for fault in self.faults:
            if fault in faults:
                drive = drive.apply(self._cures[fault])
        steps = window_slam.run(drive, self.noise, error_state, motion_model=TwistAndBias)
        result = pipeline.collect_slam(drive, steps, error_state, "invariant")
        return camera_path(result.trajectory.world_T_imu @ drive.camera.imu_T_cam), result.rejected_share

    def outcome(self, faults) -> CuredRun:
        """What comes out with the cures of these faults applied, in the order of the audit; filtered once, then kept.

        Raises ValueError for a fault that the audit did not name.
        """
        unknown = set(faults) - set(self.faults)
        if unknown:
            raise ValueError(f"no cure for {', '.join(sorted(unknown))}; the audit named {', '.join(self.faults)}")
        key = frozenset(faults)
        if key not in self._outcomes:
            path, rejected_share = self._path(key)
            self._outcomes[key] = CuredRun(path, rejected_share, self.reference)
        return self._outcomes[key]

    def build(self):
        name = "ground truth" if self.truth else "with every cure"
        path = ground(self.reference)
        self.map = add_axes(self, (0.1, 0.14, 0.43, 0.75), "Path of the left camera",
                            "forward at the start (m)", "left at the start (m)")
        fit_equal(self.map, path, margin=25.0)  # what leaves it is lost anyway
        (reference,) = self.map.plot(*path.T, color=COLOURS["truth"], lw=1.2, label=name)
        self.line = moving_line(self, self.map, color=COLOURS["invariant"], lw=1.6, label="filter")
        legend(self.map, [reference, self.line], loc="upper left")
        self.times = self.report.drive.times - self.report.drive.times[0]
        self.axes = add_axes(self, (0.66, 0.14, 0.32, 0.75), f"Distance from {'the truth' if self.truth else name}",
                             "time since start (s)", "distance (m)", yscale="log", ylim=(0.01, 300),
                             xlim=(0, self.times[-1]))
        self.error = moving_line(self, self.axes, color=COLOURS["invariant"], lw=1.6)

    def _on(self, state):
        return [fault for control, fault in zip(self.controls, self.faults) if state[control]]

    def draw(self, **state):
        outcome = self.outcome(self._on(state))
        self.line.set_data(*ground(outcome.path).T)
        self.error.set_data(self.times[1:], np.maximum(outcome.error[1:], 1e-3))

    def caption(self, **state):
        on = self._on(state)
        return f"Cured: {', '.join(on) or 'nothing'}. Result: {self.outcome(on)}."

    def alt(self, **state):
        outcome = self.outcome(self._on(state))
        how = "has nothing to do with" if outcome.lost else "follows"
        return (f"Map of the filter's path, which {how} the reference, and its distance from it over time, "
                f"{np.nanmax(outcome.error):.2g} m at most. {self.caption(**state)}")
