"""Chapter 05: the joint filter run again with other assumptions, beside the run it is compared with."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import ipywidgets

from ... import window_slam
from ...belief import Step
from ...drive import Drive
from ...noise import Noise
from ...widgets.canvas import Decades, Switch
from ...widgets.explorer import Explorer
from ...widgets.panel import Control

AS_IT_WAS, WHAT_IF = "as it was", "what if"


def leaving_out(frame: int, landmark: int, process_frame: Callable = window_slam.correlated) -> Callable:
    """A `process_frame` for one `window_slam.run` that never sees one measurement: this landmark in this frame."""
    frames = count()

    def process(prior, ids, pixels, settings):
        keep = (ids != landmark) | (next(frames) != frame)
        return process_frame(prior, ids[keep], pixels[keep], settings)

    return process


class WhatIf(ipywidgets.VBox):
    """An explorer of the joint filter with two controls that run it again: V times k, and one measurement left out.

    drive : Drive. noise : Noise of the run that it is compared with. start : the half-step to begin with.
    factor : control, k in V -> k V. leave_out : control; when switched on, the filter runs without the measurement of
    the landmark that is chosen in the explorer, in the frame that is shown.
    explorer : the two runs side by side. left_out : (frame, landmark) that is left out, or None.
    """

    def __init__(self, drive: Drive, noise: Noise, start: int | None = None):
        self.drive, self.noise = drive, noise
        self.left_out: tuple[int, int] | None = None
        self.before: list[Step] = list(window_slam.run(drive, noise))
        self.factor = Control(Decades("V ×", 1.0, 0.01, 100.0, 0.1))
        self.leave_out = Control(Switch("leave out the chosen landmark's measurement in this frame"))
        self.explorer = Explorer({AS_IT_WAS: self.before, WHAT_IF: self.before}, drive, start=start)
        self.factor.observe(lambda _: self._run(), names="value")
        self.leave_out.observe(self._leave_out, names="value")
        controls = ipywidgets.Box([self.factor, self.leave_out], layout=ipywidgets.Layout(flex_flow="row wrap"))
        super().__init__([controls, self.explorer])

    def steps(self) -> list[Step]:
        """The filter run as the controls say."""
        V_times_k = replace(self.noise, sigma_px=self.noise.sigma_px * self.factor.value**0.5)
        process = leaving_out(*self.left_out) if self.left_out else window_slam.correlated
        return list(window_slam.run(self.drive, V_times_k, process_frame=process))

    def _leave_out(self, change):
        frame = self.before[self.explorer.half_step // 2].k
        self.left_out = (frame, self.explorer.landmark) if change.new and self.explorer.landmark >= 0 else None
        self._run()

    def _run(self):
        self.explorer.update({AS_IT_WAS: self.before, WHAT_IF: self.steps()})

    def __repr__(self):
        """Fixed, see `Explorer`."""
        return f"WhatIf({self.explorer!r})"

    def _repr_mimebundle_(self, **kwargs):
        """The live widget, with the explorer's still picture and metadata, see `Panel`."""
        data, metadata = self.explorer._repr_mimebundle_(**kwargs)
        return {**data, **(super()._repr_mimebundle_(**kwargs) or {})}, metadata
