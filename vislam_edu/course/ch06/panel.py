"""Chapter 06: the filter run again for other W, V and Sigma_0, and what its errors and innovations say to that."""

from functools import cache, partial

import numpy as np
from matplotlib.collections import PolyCollection

from ... import metrics, odometry, window_slam
from ...error_state import RightInvariant, RightPerturbation
from ...noise import Noise
from ...plots.style import COLOURS, ellipse_points
from ...plots.text import two_digits
from ...studies.runs import record
from ...widgets.canvas import Decades, Number, Picture, Switch
from ...widgets.history import frame_nis, nis_band
from ..panels import LETTERING, TITLE, add_axes, legend, moving_line, round_up

LEFT, YAW = 1, 5  # of the pose error: across the road, where an error of the heading shows, and the heading
ELLIPSES = 6
ENLARGED = 10  # times, the errors on the map: tenths of a metre cannot be seen beside a street
_TRUE = Noise()
CONTROLS: dict[str, Number | Switch] = {
    "sigma_v": Decades("σ v (m/s)", _TRUE.sigma_v, 0.005, 50.0, 0.1),
    "sigma_omega": Decades("σ ω (rad/s)", _TRUE.sigma_omega, 0.0005, 5.0, 0.1),
    "sigma_px": Decades("σ px (px)", _TRUE.sigma_px, 0.07, 7.0, 0.1),
    "start": Decades("start, × σ", 1.0, 0.01, 100.0, 0.1),
    "report_birth": Switch("new landmarks as in the report (2 I)"),
    "invariant": Switch("right-invariant error (chapter 07)"),
}


class FilterRun:
    """The joint filter without a gate over T frames, run with one setting of `CONTROLS` and held against the truth.

    drive : Drive with truth. begin : (4, 4), where the filter believes to start. noise : Noise, whose initial
    covariance is multiplied by start**2.

    world_T_imu : (T, 4, 4). error, sigma : (T, 6), of the pose as a right perturbation, m and rad. final_error : m,
    distance from the truth at the end. ground : (T, 2, 2) m^2, covariance of the position seen from above.
    nees : (T,) of the pose, 6 degrees of freedom. nis : (T,) of a frame, divided by its degrees of freedom;
    NaN where nothing was predicted. measurement_nis : mean NIS of one stereo measurement, 4 if all is right.
    """

    def __init__(self, drive, begin, noise, sigma_v=_TRUE.sigma_v, sigma_omega=_TRUE.sigma_omega,
                 sigma_px=_TRUE.sigma_px, start=1.0, report_birth=False, invariant=False):
        believed = Noise(sigma_v, sigma_omega, sigma_px, start**2 * noise.initial_pose_covariance, noise.landmark_prior)
        error_state = RightInvariant() if invariant else RightPerturbation()
        process_frame = window_slam.as_report if report_birth else window_slam.correlated
        steps = list(window_slam.run(drive, believed, error_state, process_frame=process_frame, gate=1,
                                     world_T_imu=begin))
        run, truth = record(steps, error_state), drive.true_world_T_imu
        P, R = run.right_covariance, run.world_T_imu[:, :3, :3]
        nis, numbers = np.transpose([frame_nis(step, drive, error_state) for step in steps])
        self.world_T_imu, self.nees, self.measurement_nis = run.world_T_imu, run.nees(truth), run.mean_nis
        self.error = RightPerturbation().pose_difference(truth, run.world_T_imu)
        self.final_error = float(np.linalg.norm(self.error[-1, :3]))
        self.sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
        self.ground = (R @ P[:, :3, :3] @ R.swapaxes(1, 2))[:, :2, :2]
        self.nis = nis / np.where(numbers > 0, numbers, np.nan)


class TuningPicture(Picture):
    """A drive filtered with the noise that the sliders say: map, errors and bands, NEES and NIS through time.

    drive : Drive with truth, short enough that a run takes a fraction of a second.
    world_T_imu : (4, 4), where the filter believes to start. A start at the truth would let any Sigma_0 pass.
    noise : Noise, of the sensors in truth; its initial covariance is what the slider "start" multiplies.

    There is no gate: it would hide from the NIS what does not fit.
    Raises ValueError for a drive without truth.
    """

    name = "tuning"
    size = (6.4, 5.6)
    controls = CONTROLS

    def __init__(self, drive, world_T_imu, noise=None):
        if not drive.has_truth:
            raise ValueError("the tuning picture holds errors against the truth, which this drive has not")
        self.drive, self.world_T_imu, self.noise = drive, np.asarray(world_T_imu), noise or Noise()
        self._filtered = cache(partial(FilterRun, self.drive, self.world_T_imu, self.noise))
        super().__init__()

    def outcome(self, **state) -> FilterRun:
        """The run that the controls stand for, done once and kept. What is not given is as at the start."""
        return self._filtered(**self.start | state)

    def build(self):
        times = self.drive.times - self.drive.times[0]
        self._build_map()
        self.errors = [
            self._build_error((0.115, 0.33, 0.37, 0.17), "Error to the left (m)", times),
            self._build_error((0.61, 0.33, 0.37, 0.17), "Heading error (°)", times),
        ]
        drive = self.drive
        again = drive.frame[drive.first_seen[drive.landmark] < drive.frame]  # a first view is no prediction's test
        numbers = 4 * np.maximum(np.bincount(again, minlength=len(times)), 1)
        band6 = np.tile(np.array(metrics.chi2_band(6, probability=0.95))[:, None], len(times))
        self.nees = self._build_test((0.115, 0.08, 0.37, 0.17), "NEES of the pose, honest: 6", times, band6, 6,
                                     (0.1, 1e5))
        self.nis = self._build_test((0.61, 0.08, 0.37, 0.17), "NIS of a frame / its numbers: 1", times,
                                    nis_band(numbers), 1, (0.01, 300))

    def _build_map(self):
        truth = self.drive.true_world_T_imu
        dead = odometry.dead_reckon(self.drive, self.noise, self.world_T_imu).world_T_imu
        self.map = add_axes(self, (0.115, 0.61, 0.865, 0.31), "", "x (m)", "y (m)", aspect="equal",
                            adjustable="datalim")
        self.map.set_title(f"From above; errors and 95 % ellipses {ENLARGED} × as large", fontsize=TITLE, loc="left",
                           pad=22)
        black = self.map.plot(*truth[:, :2, 3].T, color=COLOURS["truth"], lw=1.2, label="truth")
        yellow = self.map.plot(*self._enlarged(dead).T, color=COLOURS["dead_reckoning"], lw=1.4, ls=(0, (1, 1)),
                               label="IMU alone")
        self.ellipses = self.moves(self.map.add_collection(
            PolyCollection([], facecolor="none", edgecolor=COLOURS["slam"], lw=1.0), autolim=False))
        self.path = moving_line(self, self.map, color=COLOURS["slam"], lw=1.6, ls="--", label="joint filter")
        low, high = truth[:, :2, 3].min(axis=0), truth[:, :2, 3].max(axis=0)
        margin = 0.12 * (high - low).max()
        self.map.update_datalim([low - margin, high + margin])
        legend(self.map, [*black, *yellow, self.path], loc="lower left", bbox_to_anchor=(0, 1), frameon=False,
               borderaxespad=0.1)

    def _enlarged(self, world_T_imu):
        """(T, 2) m: positions seen from above, their distance from the truth enlarged."""
        truth = self.drive.true_world_T_imu[:, :2, 3]
        return truth + ENLARGED * (world_T_imu[:, :2, 3] - truth)

    def _build_error(self, rect, title, times):
        """An error and the edges of its band of 3 sigma."""
        axes = add_axes(self, rect, f"{title}, ± 3σ dashed", xlim=(times[0], times[-1]))
        style = {"color": COLOURS["expected"], "ls": "--", "lw": 1.0}
        edges = [axes.plot(times, 0 * times, **style)[0] for _ in range(2)]
        (line,) = axes.plot(times, 0 * times, color=COLOURS["slam"], lw=1.4)
        return self.moves(line, *edges)

    def _build_test(self, rect, title, times, band, honest, limits):
        """A chi-square number on a logarithmic scale, in its 95 % band, and a text for its mean."""
        axes = add_axes(self, rect, title, "time (s)", xlim=(times[0], times[-1]), yscale="log", ylim=limits)
        axes.fill_between(times, *band, color=COLOURS["accepted"], alpha=0.2, linewidth=0)
        axes.axhline(honest, color=COLOURS["accepted"], lw=0.8)
        (line,) = axes.plot(times, np.ones_like(times), color=COLOURS["slam"], lw=1.2)
        words = axes.text(0.985, 0.9, "", fontsize=LETTERING, ha="right", va="top", transform=axes.transAxes,
                          bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5})
        return self.moves(line, words)

    def draw(self, **state):
        """Run the filter with these values, if it has not been run yet, and show it."""
        run = self.outcome(**state)
        path = self._enlarged(run.world_T_imu)
        self.path.set_data(*path.T)
        shown = np.linspace(0, len(run.nees) - 1, ELLIPSES).astype(int)
        self.ellipses.set_verts(ellipse_points(path[shown], ENLARGED**2 * run.ground[shown]))
        for artists, axis, unit in zip(self.errors, (LEFT, YAW), (1.0, np.degrees(1.0))):
            error, three_sigma = unit * run.error[:, axis], 3 * unit * run.sigma[:, axis]
            for line, values in zip(artists, (error, three_sigma, -three_sigma)):
                line.set_ydata(values)
            self._fit(artists[0].axes, np.abs([error, three_sigma]).max())
        for (line, words), values in zip((self.nees, self.nis), (run.nees, run.nis)):
            line.set_ydata(values)
            words.set_text(f"mean {two_digits(np.nanmean(values))}")

    def _fit(self, axes, top):
        """Limits that hold ± top and change seldom, as the axes must be drawn again."""
        limit = round_up(top)
        if axes.get_ylim()[1] != limit:
            axes.set_ylim(-limit, limit)
            self._background = None

    def caption(self, **state):
        run = self.outcome(**state)
        low, high = metrics.chi2_band(6, probability=0.95)
        inside = 100 * np.mean((low <= run.nees) & (run.nees <= high))
        return (f"NEES {two_digits(run.nees.mean())} (6 is honest, {inside:.0f} % of the frames inside the band); "
                f"NIS of single measurements {two_digits(run.measurement_nis)} (4 is honest), "
                f"of whole frames {two_digits(np.nanmean(run.nis))} (1 is honest); "
                f"{two_digits(run.final_error)} m from the truth at the end.")

    def alt(self, **state):
        run, s = self.outcome(**state), self.start | state
        which = "right-invariant" if s["invariant"] else "right-perturbation"
        birth = "as in the report" if s["report_birth"] else "correlated"
        return (f"The {which} filter with sigma_v {s['sigma_v']:.2g} m/s, sigma_omega {s['sigma_omega']:.2g} rad/s, "
                f"sigma_px {s['sigma_px']:.2g} px, start {s['start']:.2g} sigma, new landmarks {birth}: path on a "
                "map, two errors with three standard deviations, NEES "
                f"(mean {two_digits(run.nees.mean())}) and NIS, through time.")
