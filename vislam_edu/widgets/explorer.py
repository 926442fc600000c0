"""The explorer: a filter's history, packed once and drawn in the browser, where every half-step can be touched.

    Explorer(window_slam.run(drive, noise), drive)

The front end is `explorer.js`, one ES module without dependencies, loaded by anywidget in a notebook and by
`save_html` in a page that needs neither kernel nor network.
"""

import base64
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import anywidget
import traitlets

from ..drive import Drive
from ..error_state import ErrorState
from . import explorer_still, history, packing
from .canvas import Still
from .history import History

MODULE = Path(__file__).with_name("explorer.js")
BOTH = 2  # value of `show`: both runs side by side

PAGE = Path(__file__).with_name("page.html")


class Explorer(anywidget.AnyWidget):
    """Map, joint covariance, one landmark and errors through time of a filter's history, linked.

    Parameters
    ----------
    steps : iterable of `Step`, from `window_slam.run`, `mapping.run`, `odometry.localize` or any other
        generator of Steps whose beliefs are a joint `Belief`, a `MapBelief` or a `PoseBelief` (such as a filter of
        your own); or a dict {name: steps} of two runs over the same drive, which are shown side by side.
    drive : Drive that the steps were run on; its truth is drawn where it has one.
    error_state : `ErrorState` of a joint filter, by default `error_state.fitting`; for two runs one for both, or a
        dict {name: ErrorState}.
    world_T_imu : (T, 4, 4), the poses given to a filter that estimates a map only.
    name : of the run, shown in the widget's text.
    start : the frame to begin with, after its last half-step; the last frame by default.
    landmark : id of the landmark that is chosen at first; by default the one that stays longest.
    show : which run, 0 or 1, or `BOTH`; of two runs both by default.
    quantity : what is drawn through time at first: "forward error" (the default), "left error", "heading error",
        "NEES of the pose", "NIS / landmark", or a standard deviation before and after each update: "forward σ",
        "left σ", "heading σ".

    Raises KeyError for an unknown quantity, and ValueError for an empty history, runs of different length, or more than
    `packing.LIMIT` bytes.

    Attributes
    ----------
    half_step, landmark, show : what is shown, kept the same in the browser and in Python.
    histories : list of `history.History`.

    Other histories: `Explorer.from_beliefs`. New data in a widget that is on the page: `update`. A page: `save_html`.

    Example
    -------
    >>> from vislam_edu import recordings, window_slam
    >>> from vislam_edu.noise import Noise
    >>> drive = recordings.load(recordings.find("first_steps.npz")).slice(0, 5)
    >>> Explorer(window_slam.run(drive, Noise()), drive, name="joint filter")
    Explorer(joint filter, 10 half-steps)
    """

    _esm = MODULE
    header = traitlets.Dict().tag(sync=True)
    data = traitlets.Bytes().tag(sync=True)
    half_step = traitlets.Int().tag(sync=True)
    landmark = traitlets.Int(-1).tag(sync=True)
    show = traitlets.Int(0).tag(sync=True)

    def __init__(self, steps: Iterable | Mapping[str, Iterable], drive: Drive,
                 error_state: ErrorState | Mapping[str, ErrorState] | None = None, *, world_T_imu=None,
                 name: str = "filter", start: int | None = None, landmark: int | None = None, show: int | None = None,
                 quantity: str | None = None):
        histories = _histories(steps, drive, error_state, world_T_imu, name)
        start = None if start is None else histories[0].at(start)
        self._open(histories, drive, start, landmark, show, quantity)

    def _open(self, histories: list[History], drive, start, landmark, show, quantity=None):
        """Pack the histories and open the widget."""
        self.histories, self.drive = histories, drive
        start = len(histories[0].snapshots) - 1 if start is None else start
        landmark = longest_seen(histories[0]) if landmark is None else landmark
        show = (BOTH if len(histories) > 1 else 0) if show is None else show
        header, data = packing.pack(histories, drive, start, landmark, show, quantity)
        super().__init__(header=header, data=data, half_step=start, landmark=landmark, show=show)

    @classmethod
    def from_beliefs(cls, labels: Sequence[str], beliefs: Sequence[Any], drive: Drive, *, name: str = "estimate",
                     unit: str = "iteration", error_state: ErrorState | None = None,
                     frames: Sequence[int] | None = None, captions: Sequence[str] = (),
                     series: Mapping[str, Sequence[float]] | None = None, start: int | None = None,
                     landmark: int | None = None) -> "Explorer":
        """An explorer whose slider steps through single beliefs: iterations, pairs fused, keyframes.

        labels : n texts, such as "iteration 3" or "2 pairs fused". beliefs : n of `belief.Belief` (one pose and its
        landmarks) or `history.PathBelief` (a whole path and its landmarks, covariances where they are known).
        name : of the estimate. unit : what one position of the slider is, such as "iteration" or "pair fused".
        error_state : of the beliefs' covariances, by default `error_state.fitting`.
        frames : n frames of the drive, those of the beliefs' (last) poses; by default its last frame.
        captions : n texts, by default what changed from one belief to the next.
        series : {name: n numbers} to be drawn below, such as the cost of each iteration; on a logarithmic scale where
        they span more than a factor of 100. start : the belief to begin with. landmark : as above.
        Raises ValueError when labels and beliefs differ in number or the data are too large.

        Example: `Explorer.from_beliefs([f"iteration {i}" for i in range(n)], beliefs, drive, series={"cost": costs})`.
        """
        self = cls.__new__(cls)
        one = history.from_beliefs(labels, beliefs, drive, name=name, unit=unit, error_state=error_state,
                                   frames=frames, captions=captions, series=series)
        self._open([one], drive, start, landmark, 0)
        return self

    def update(self, steps: Iterable | Mapping[str, Iterable],
               error_state: ErrorState | Mapping[str, ErrorState] | None = None) -> None:
        """Show other steps of the same drive in the same place; what is chosen stays chosen. Arguments as above."""
        now = self.histories[0].snapshots[self.half_step]
        self.histories = _histories(steps, self.drive, error_state, None, self.histories[0].name)
        start = self.histories[0].at(now.frame, now.stage)
        header, data = packing.pack(self.histories, self.drive, start, self.landmark, self.show,
                                    self.header["quantity"])
        with self.hold_sync():
            self.half_step, self.header, self.data = start, header, data

    def caption(self, i: int, run: int = 0) -> str:
        """What led to snapshot i of a run, in words: the line below the views."""
        shot = self.histories[run].snapshots[i]
        return f"{shot.label}: {shot.caption}."

    @property
    def n(self) -> int:
        """Number of positions of the slider."""
        return self.header["n"]

    def save_html(self, path: str | Path, title: str | None = None) -> Path:
        """Write the explorer as one HTML file that works without kernel and network; returns its path."""
        header = {**self.header, "start": self.half_step, "landmark": self.landmark, "show": self.show}
        # "</script" cannot occur in base64; in the texts of the header its "<" is written as an escape.
        page = Template(PAGE.read_text(encoding="utf-8")).substitute(
            title=escape(title or " and ".join(h.name for h in self.histories)),
            header=json.dumps(header).replace("<", "\\u003c"), data=base64.b64encode(self.data).decode(),
            module=MODULE.read_text(encoding="utf-8"))
        path = Path(path)
        path.write_text(page, encoding="utf-8")
        return path

    def still(self, i: int | None = None, show: int | None = None) -> Still:
        """The picture of snapshot i, by default what is shown, as an output that needs no script."""
        return Still(*explorer_still.draw(self.histories, self.drive, self.half_step if i is None else i, self.landmark,
                                          self.show if show is None else show, self.header["quantity"]))

    def __repr__(self):
        """Fixed, so that a notebook's stored text never depends on what is shown or on an address."""
        names = " and ".join(one.name for one in self.histories)
        return f"Explorer({names}, {self.n} {self.histories[0].unit}s)"

    def _repr_mimebundle_(self, **kwargs):
        """The live widget, and the still picture with its alternative text for where no script runs."""
        bundle = super()._repr_mimebundle_(**kwargs)
        data, metadata = bundle if isinstance(bundle, tuple) else (bundle or {}, {})
        still, its_metadata = self.still()._repr_mimebundle_()
        return {**data, "image/png": still["image/png"]}, {**metadata, **its_metadata}


def _histories(steps, drive, error_state, world_T_imu, name) -> list[History]:
    """One history, or one for each entry of a dict."""
    runs = {key: tuple(one) for key, one in (steps if isinstance(steps, Mapping) else {name: steps}).items()}
    states = error_state if isinstance(error_state, Mapping) else dict.fromkeys(runs, error_state)
    if not 1 <= len(runs) <= BOTH:
        raise ValueError(f"an explorer shows one run or two, got {len(runs)}")
    births = {step.k for one in runs.values() for step in one if len(history.born_last(step))}
    made = [history.from_steps(key, one, drive, states.get(key), world_T_imu=world_T_imu, births=births)
            for key, one in runs.items()]
    if made[0].colour == made[-1].colour:
        made[1:] = [replace(one, colour="report") for one in made[1:]]
    return made


def longest_seen(one: History) -> int:
    """The id that is in most snapshots, or in most sights where no landmark is estimated; -1 for none."""
    held = (s.ids if len(s.ids) or s.sight is None else s.sight.ids for s in one.snapshots)
    counts = Counter(landmark for ids in held for landmark in ids.tolist())
    return max(counts, key=lambda key: (counts[key], -key), default=-1)
