"""Chapter 05: a cross-covariance as an ellipse, and the joint filter run again beside the run it is compared with."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import ipywidgets
import numpy as np

from ... import kalman, window_slam
from ...belief import Step
from ...drive import Drive
from ...noise import Noise
from ...plots.style import COLOURS, ellipse_points
from ...widgets import history
from ...widgets.canvas import Choice, Decades, Number, Picture
from ...widgets.explorer import Explorer
from ...widgets.panel import Control
from ..panels import add_axes, legend_above

AS_IT_WAS, WHAT_IF = "as it was", "what if"
STEPS = ("1 birth", "2 looks", "3 drive", "4 one more look")
CONTROLS: dict[str, Number | Choice] = {
    "after": Choice("after", STEPS[0], STEPS), "looks": Number("looks in step 2", 5, 1, 99, 1)}
START_SIGMA, LOOK_SIGMA, DRIVE_SIGMA = 1.0, 0.1, 2.0  # m, of the two numbers: the car, a look at m - p, the drive


def two_numbers(looks: int, drop: bool) -> list[np.ndarray]:
    """(2, 2) covariances m^2 of [m, p] after a birth, so many looks at m - p, a drive of p, and one more look.

    drop : whether the cross-covariance is set to zero after each step. The birth is the first look, so it is not used
    again.
    """
    def kept(P):
        return np.diag(np.diag(P)) if drop else P

    def look(P):
        return kept(kalman.update(P, np.array([[1.0, -1.0]]), np.array([[LOOK_SIGMA**2]]), np.zeros(1))[1])

    P = START_SIGMA**2
    states = [kept(np.array([[P + LOOK_SIGMA**2, P], [P, P]]))]
    for _ in range(looks):
        states.append(look(states[-1]))
    driven = states[-1] + np.diag([0.0, DRIVE_SIGMA**2])
    return [states[0], states[-1], driven, look(driven)]


NOTHING, LANDMARK, FRAME = "nothing", "all later looks at the chosen landmark", "the frame that is shown"


def leaving_out(what: str, number: int) -> Callable:
    """A `process_frame` for one `window_slam.run` without a frame, or without a landmark's looks after its birth."""
    frames = count()

    def process(prior, ids, pixels, settings):
        k = next(frames)
        keep = np.full(len(ids), k != number) if what == FRAME else (ids != number) | ~np.isin(ids, prior.ids)
        return window_slam.correlated(prior, ids[keep], pixels[keep], settings)

    return process


class WhatIf(ipywidgets.VBox):
    """An explorer of the joint filter with two controls that run it again: V times k, and measurements left out.

    drive : Drive. noise : Noise of the run that it is compared with. start : the frame to begin with.
    factor : control, k in V -> k V. leave_out : control, which measurements the filter does not get: `NOTHING`, those
    of the `LANDMARK` that is chosen when it is set, after its birth, or those of the `FRAME` that is shown then.
    text : the widget that says what was left out, and by how much the sigmas of the shown half-step differ.
    explorer : the two runs side by side. left_out : (what, number), or None.
    """

    def __init__(self, drive: Drive, noise: Noise, start: int | None = None):
        self.drive, self.noise = drive, noise
        self.left_out: tuple[str, int] | None = None
        self.before: list[Step] = list(window_slam.run(drive, noise))
        self.after = self.before
        self.factor = Control(Decades("V ×", 1.0, 0.01, 100.0, 0.1))
        self.leave_out = Control(Choice("leave out", NOTHING, (NOTHING, LANDMARK, FRAME)))
        self.explorer = Explorer({AS_IT_WAS: self.before, WHAT_IF: self.before}, drive, start=start)
        self.text = ipywidgets.HTML()
        self.factor.observe(lambda _: self._run(), names="value")
        self.leave_out.observe(self._leave_out, names="value")
        self.explorer.observe(self._say, names="half_step")
        controls = ipywidgets.Box([self.factor, self.leave_out],
                                  layout=ipywidgets.Layout(flex_flow="row wrap", align_items="center"))
        super().__init__([controls, self.text, self.explorer])
        self._say()

    def _leave_out(self, change):
        shown = self.explorer.histories[0].snapshots[self.explorer.half_step]
        number = {LANDMARK: self.explorer.landmark, FRAME: shown.frame}.get(change.new, -1)
        self.left_out = (change.new, number) if number >= 0 else None
        self._run()

    def _run(self):
        V_times_k = replace(self.noise, sigma_px=self.noise.sigma_px * self.factor.value**0.5)
        process = leaving_out(*self.left_out) if self.left_out else window_slam.correlated
        self.after = list(window_slam.run(self.drive, V_times_k, process_frame=process))
        self.explorer.update({AS_IT_WAS: self.before, WHAT_IF: self.after})
        self._say()

    def ratios(self) -> dict[str, float]:
        """Longest sigma of the pose's position and of each landmark in the shown half-step: what if over as it was."""
        was, now = (one.snapshots[self.explorer.half_step] for one in self.explorer.histories)
        common, i, j = np.intersect1d(was.ids, now.ids, return_indices=True)
        longest = [history.principal_sigmas(np.concatenate([np.array([one.pose_covariance])[:, :3, :3],
                                                            one.landmark_covariance[rows]]))[:, 0]
                   for one, rows in ((was, i), (now, j))]
        return dict(zip(["pose", *map(str, common)], longest[1] / longest[0]))

    def _say(self, change=None):
        what, number = self.left_out or (NOTHING, -1)
        left_out = {NOTHING: "", LANDMARK: f"Without the looks at landmark {number} after its birth. ",
                    FRAME: f"Without frame {number}. "}[what]
        ranked = sorted(self.ratios().items(), key=lambda item: -abs(np.log(item[1])))
        shown = ", ".join(f"{name}: {ratio:.2f}" for name, ratio in ranked[:8] if abs(ratio - 1) > 0.005) or "none"
        accepted = np.concatenate([step.innovation.accepted for step in self.after])
        self.text.value = (f'<div role="status" style="line-height: 1.4">{left_out}σ in this half-step, what if over '
                           f"as it was, largest changes first: {shown}. The gate lets in {accepted.mean():.0%} of all "
                           "measurements.</div>")

    def __repr__(self):
        """Fixed, see `Explorer`."""
        return f"WhatIf({self.explorer!r})"

    def _repr_mimebundle_(self, **kwargs):
        """The live widget, with the explorer's still picture and metadata, see `Panel`."""
        data, metadata = self.explorer._repr_mimebundle_(**kwargs)
        return {**data, **(super()._repr_mimebundle_(**kwargs) or {})}, metadata


class TwoNumbersPicture(Picture):
    """A landmark m and a car p on a line as an ellipse in the plane of their errors, joint and with m and p kept apart.

    A birth, some looks at m - p, a drive of the car, one more look: each with what it came from.
    """

    name = "two numbers"
    size = (8.4, 4.4)
    controls = CONTROLS

    def build(self):
        self.rows = []
        for left, title in ((0.08, "Joint"), (0.57, "Cross-covariance dropped after each step")):
            axes = add_axes(self, (left, 0.13, 0.41, 0.68), title, "error of the landmark m (m)",
                            "error of the car p (m)", xlim=(-6, 6), ylim=(-6, 6), aspect="equal")
            (band,) = axes.fill([], [], color=COLOURS["measured"], alpha=0.5, lw=2, label="m − p measured")
            (was,) = axes.plot([], [], "--", color=COLOURS["prior"], label="before")
            (now,) = axes.plot([], [], "-", lw=2, color=COLOURS["posterior"], label="now, 95 %")
            legend_above(axes, [was, now, band])
            self.rows.append(self.moves(band, was, now))

    def draw(self, after, looks):
        """Show a step, after so many looks in the second."""
        step = STEPS.index(after)
        for (band, was, now), drop in zip(self.rows, (False, True)):
            states = two_numbers(looks, drop)
            for line, P in ((was, states[step - 1] if step else None), (now, states[step])):
                line.set_data(*(([], []) if P is None else ellipse_points(np.zeros(2), P).T))
            half = 1.96 * LOOK_SIGMA * (looks**-0.5 if step == 1 else 1)
            band.set_xy([[-6 + half, -6], [6 + half, 6], [6 - half, 6], [-6 - half, -6]])
            band.set_visible(step != 2)

    def caption(self, after, looks):
        found = []
        for name, drop in (("joint", False), ("dropped", True)):
            P = two_numbers(looks, drop)[STEPS.index(after)]
            apart = np.sqrt(P[0, 0] + P[1, 1] - 2 * P[0, 1])
            found.append(f"{name}: car {np.sqrt(P[1, 1]):.2f} m, landmark {np.sqrt(P[0, 0]):.2f} m, "
                         f"distance {apart:.2f} m")
        return f"{after}, standard deviations. {'; '.join(found)}."

    def alt(self, **state):
        return ("The 95 % ellipse of the errors of a landmark and a car, before and after a step, in two filters; a "
                f"look is a narrow band along the diagonal. {self.caption(**state)}")
