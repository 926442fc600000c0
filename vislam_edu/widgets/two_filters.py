"""Chapter 07: two joint filters over the same drive, half-step by half-step, each claiming what it claims."""

import numpy as np
from matplotlib.collections import PolyCollection

from .. import metrics
from ..error_state import RightInvariant, RightPerturbation
from ..plots.style import COLOURS, LINESTYLES, ellipse_points
from ..studies.observability import heading_variance
from ..studies.pipeline import right_pose_covariance, world_landmark_covariance
from .canvas import StepPicture
from .panels import MapPanel, TimePanel, legend

ERROR_STATES = {"slam": RightPerturbation(), "invariant": RightInvariant()}
TITLES = {"slam": "Right perturbation", "invariant": "Right-invariant"}


class TwoFiltersPicture(StepPicture):
    """Both maps with the 95 % ellipses of landmarks and position, and what both say of the heading.

    right, invariant : steps of `slam.run` over the same drive from the same start, with `RightPerturbation` and
    with `RightInvariant`. drive : the `Drive` with truth.
    Raises ValueError when the two runs differ in length.
    """

    name = "two filters"
    size = (10.0, 6.6)

    def __init__(self, right, invariant, drive):
        self.drive = drive
        self.runs = {"slam": tuple(right), "invariant": tuple(invariant)}
        if len(self.runs["slam"]) != len(self.runs["invariant"]):
            raise ValueError(
                f"invariant: {len(self.runs['invariant'])} steps, expected {len(self.runs['slam'])} as in the other run"
            )
        self._measure()
        super().__init__(self.runs["slam"])

    def _measure(self):
        """Claims and errors of both filters per half-step: (n,) each, radians for the heading."""
        truth = self.drive.true_world_T_imu
        self.sigma, self.error, self.nees = {}, {}, {}
        for name, steps in self.runs.items():
            beliefs = [belief for step in steps for belief in (step.prior, step.posterior)]
            true = np.repeat(truth[[step.k for step in steps]], 2, axis=0)
            poses = np.array([belief.world_T_imu for belief in beliefs])
            state = ERROR_STATES[name]
            self.sigma[name] = np.sqrt([heading_variance(state, belief) for belief in beliefs])
            self.error[name] = RightInvariant().pose_difference(true, poses)[:, 5]
            claimed = np.array([belief.pose_covariance for belief in beliefs])
            self.nees[name] = metrics.pose_nees(state, true, poses, claimed).pose

    def build(self):
        """The maps above, heading and NEES below."""
        ids = np.unique(np.concatenate([s.posterior.ids for steps in self.runs.values() for s in steps]))
        points = np.concatenate([self.drive.true_landmarks[ids, :2], self.drive.true_world_T_imu[:, :2, 3]])
        self.maps, self.position = {}, {}
        for name, left in (("slam", 0.06), ("invariant", 0.56)):
            panel = MapPanel(
                self,
                (left, 0.475, 0.43, 0.48),
                f"{TITLES[name]}: map from above, 95 % ellipses",
                points,
                self.drive.true_landmarks[ids],
                self.drive.true_world_T_imu,
            )
            panel.path.set_color(COLOURS[name])
            panel.axes.get_legend().get_lines()[0].set_color(COLOURS[name])
            self.position[name] = self.moves(
                panel.axes.add_collection(
                    PolyCollection([], facecolor=COLOURS[name], alpha=0.45, edgecolor="none"), autolim=False
                )
            )
            self.maps[name] = panel
        self._build_time()

    def _build_time(self):
        times = np.repeat([step.time for step in self.steps], 2)
        first = np.degrees(3 * self.sigma["invariant"][0])
        self.heading_lines = []
        for name in self.runs:
            looks = {"color": COLOURS[name], "lw": 1.6}
            self.heading_lines += [
                (np.abs(np.degrees(self.error[name])), {**looks, "label": f"error, {TITLES[name].lower()}"}),
                (np.degrees(3 * self.sigma[name]), {**looks, "ls": (0, (3, 2)), "label": "3σ claimed"}),
            ]
        top = 1.9 * max(values.max() for values, _ in self.heading_lines)
        grey = {"color": COLOURS["expected"], "ls": ":", "lw": 1.2}
        self.heading = TimePanel(
            self, (0.06, 0.08, 0.43, 0.29), "Heading error (degrees) and 3σ (dashed); dotted: at start",
            "", times, self.heading_lines, still=[(np.full(len(times), first), grey)], ylim=(0, top),
        )
        legend(self.heading.axes, self.heading.lines, columns=2)
        lines = [
            (self.nees[name], {"color": COLOURS[name], "ls": LINESTYLES[name], "lw": 1.6, "label": TITLES[name]})
            for name in self.runs
        ]
        band = metrics.chi2_band(6, probability=0.95)
        green = {"color": COLOURS["accepted"], "lw": 0.9}
        everything = np.concatenate([values for values, _ in lines])
        limits = (min(everything[everything > 0].min(), band[0]) / 2, 20 * max(everything.max(), band[1]))
        self.nees_panel = TimePanel(
            self, (0.56, 0.08, 0.43, 0.29), "NEES of the pose; green: its 95 % band", "", times, lines,
            still=[(np.full(len(times), edge), green) for edge in band], yscale="log", ylim=limits,
        )
        legend(self.nees_panel.axes, self.nees_panel.lines)

    def draw(self, i):
        """Show half-step i."""
        k, updated = i // 2, bool(i % 2)
        for name, steps in self.runs.items():
            belief = steps[k].posterior if updated else steps[k].prior
            path = np.array([s.posterior.world_T_imu for s in steps[:k]] + [belief.world_T_imu])
            state = ERROR_STATES[name]
            self.maps[name].draw(path, belief.landmarks, world_landmark_covariance(belief, state), updated)
            R = belief.world_T_imu[:3, :3]
            ground = (R @ right_pose_covariance(belief, state)[:3, :3] @ R.T)[:2, :2]
            self.position[name].set_verts([ellipse_points(belief.world_T_imu[:2, 3], ground)])
        self.heading.draw(i)
        self.nees_panel.draw(i)

    def caption(self, i):
        """What both claim of the heading, and how wrong they are."""
        words = [
            f"{TITLES[name].lower()}: heading off by {np.degrees(abs(self.error[name][i])):.2f}°, "
            f"claims 3σ = {np.degrees(3 * self.sigma[name][i]):.2f}°"
            for name in self.runs
        ]
        return f"{self.when(i)}. {'; '.join(words)}."

    def alt(self, i):
        """The picture in words."""
        return (
            f"Two maps from above with 95 % ellipses, right perturbation on the left and right-invariant on the right, "
            f"{self.when(i)}; heading errors against three standard deviations, and NEES of both, through time."
        )
