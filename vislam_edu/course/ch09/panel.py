"""Chapter 09: the same drive with every landmark, every second, ... every twentieth, filtered anew for each."""

import numpy as np
from matplotlib.collections import LineCollection

from ... import metrics, plots, window_slam
from ...error_state import RightInvariant
from ...plots.style import COLOURS
from ...studies import pipeline
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, legend, moving_line

MOST = 20  # of how many landmarks one is kept, at most
ELLIPSES = 12  # along the path
CONTROLS = {"every": Number("keep one in", 10, 1, MOST, 1)}


class Thinned:
    """What the joint filter makes of every `every`-th landmark of a drive with truth.

    landmarks : how many are left. visible : of them in view, on average. trajectory : Trajectory. map : MapBelief.
    error : (T,) m, distance of each position from the true one. rms : m, of it over the drive. claimed : (T,) m, what
    the filter expects of it, the root of the trace of the position's covariance.
    """

    def __init__(self, drive, noise, every, error_state):
        part = drive.subsample(every)
        run = pipeline.collect_slam(part, window_slam.run(part, noise, error_state), error_state)
        self.landmarks, self.visible = part.n_landmarks, part.visible.mean()
        self.trajectory, self.map = run.trajectory, run.map
        self.error = metrics.position_errors(drive.true_world_T_imu, run.trajectory.world_T_imu)
        self.rms = float(np.sqrt(np.mean(self.error**2)))
        self.claimed = np.sqrt(np.trace(plots.position_covariance(run.trajectory), axis1=1, axis2=2))


class SubsamplingPicture(Picture):
    """Map, position error against what the filter claims, and the error of each share of the landmarks tried so far.

    Each position of the slider runs the filter once, the first time it is looked at.

    drive : `Drive` with truth, also of its landmarks. noise : Noise. error_state : by default `RightInvariant()`,
    whose claims can be taken at their word.
    """

    name = "every n-th landmark"
    size = (6.4, 6.0)
    controls = CONTROLS

    def __init__(self, drive, noise, error_state=None):
        self.drive, self.noise, self.error_state = drive, noise, error_state or RightInvariant()
        self.tried = {}
        super().__init__()

    def run(self, every) -> Thinned:
        """The filter's result for every `every`-th landmark, computed once."""
        if every not in self.tried:
            self.tried[every] = Thinned(self.drive, self.noise, every, self.error_state)
        return self.tried[every]

    def build(self):
        path, blue = self.drive.true_world_T_imu[:, :2, 3], COLOURS["invariant"]
        self.map = add_axes(self, (0.1, 0.42, 0.88, 0.54), "Map from above", "x (m)", "y (m)")
        (truth,) = self.map.plot(*path.T, "-", lw=1.6, color=COLOURS["truth"], label="true path")
        self.map.plot(*self.drive.true_landmarks[:, :2].T, "+", ms=3, mew=0.5, color="0.75", zorder=0)
        box = self.map.get_window_extent()
        low, high = path.min(axis=0), path.max(axis=0)
        half = 1.25 * max((high - low) / (box.width, box.height)) / 2 * np.array([box.width, box.height])  # m
        (x0, y0), (x1, y1) = (low + high) / 2 - half, (low + high) / 2 + half
        self.map.set(xlim=(x0, x1), ylim=(y0, y1))
        (self.points,) = self.map.plot([], [], ".", ms=3, color=COLOURS["slam"], label="landmarks kept")
        (self.path,) = self.map.plot([], [], "--", lw=1.6, color=blue, label="estimated path")
        self.ellipses = self.map.add_collection(LineCollection([], colors=blue, lw=1.0, label="95 % of the position"),
                                                autolim=False)
        names = legend(self.map, [truth, self.path, self.points, self.ellipses], columns=2, loc="center")
        self.moves(self.points, self.ellipses, self.path, names)  # the names too, or the landmarks would cover them

        t = self.drive.times - self.drive.times[0]
        self.time = add_axes(self, (0.1, 0.08, 0.38, 0.24), "Position error", "time (s)", "error (m)",
                             xlim=(0, t[-1]), ylim=(0, 10))
        self.error = self.moves(*self.time.plot(t, 0 * t, color=COLOURS["slam"], label="error"))
        self.claimed = self.moves(*self.time.plot(t, 0 * t, "--", color=blue, label="claimed, RMS"))
        legend(self.time, [self.error, self.claimed], loc="upper left")

        self.share = add_axes(self, (0.6, 0.08, 0.38, 0.24), "RMS error, of what was tried", "one in ... is kept",
                              "RMS error (m)", xlim=(0, MOST + 1), ylim=(0.05, 20), yscale="log",
                              xticks=[1, 5, 10, 15, 20])
        self.others = moving_line(self, self.share, "o-", lw=0.8, color="0.6")
        self.this = moving_line(self, self.share, "o", ms=8, color=COLOURS["slam"])

    def draw(self, every):
        """Show every `every`-th landmark."""
        run = self.run(every)
        self.points.set_data(*run.map.landmarks[run.map.seen, :2].T)
        self.path.set_data(*run.trajectory.world_T_imu[:, :2, 3].T)
        self.ellipses.set_segments(plots.position_outlines(run.trajectory, ELLIPSES))
        self.error.set_ydata(run.error)
        self.claimed.set_ydata(run.claimed)
        tried = sorted(self.tried)
        self.others.set_data(tried, [self.tried[e].rms for e in tried])
        self.this.set_data([every], [run.rms])

    def caption(self, every):
        run = self.run(every)
        return (f"{run.landmarks} of {self.drive.n_landmarks} landmarks, {run.visible:.0f} in view on average: "
                f"{run.rms:.2g} m RMS; at the end {run.error[-1]:.2g} m, claimed {run.claimed[-1]:.2g} m.")

    def alt(self, every):
        run = self.run(every)
        return (f"Map from above: true path in black, estimated path with 95 % ellipses from {run.landmarks} "
                f"landmarks, one in {every}; its position error through time against what the filter claims, "
                f"{run.rms:.2g} m RMS; the RMS error for each share of the landmarks tried so far.")
