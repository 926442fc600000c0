"""What all pictures share: a figure drawn off screen, of which only the parts that move are drawn again."""

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from ..plots import style

DPI, SHARP = 100, 2  # dots per inch of a stored picture; a live one has twice as many, for screens that show them


@dataclass(frozen=True)
class Number:
    """A control that holds a number: its label (with unit), where it starts, and its range.

    Whole numbers when `step` is an int.
    """

    label: str
    value: float
    low: float
    high: float
    step: float

    def __post_init__(self):
        if not self.low <= self.value <= self.high or self.step <= 0:
            raise ValueError(f"{self.label}: {self.value} must lie in [{self.low}, {self.high}], step {self.step} > 0")


@dataclass(frozen=True)
class Decades(Number):
    """A `Number` on a logarithmic scale; its `step` is in powers of ten, so 0.1 is a factor of 1.26."""

    def __post_init__(self):
        super().__post_init__()
        if self.low <= 0:
            raise ValueError(f"{self.label}: a logarithmic scale cannot begin at {self.low}")


@dataclass(frozen=True)
class Switch:
    """A control that is on or off: its label, and how it starts."""

    label: str
    value: bool = False


@dataclass(frozen=True)
class Choice:
    """A control that is one of some names: its label, the name that it starts with, and all of them.

    Up to four names are buttons side by side, more are a list. Raises ValueError when the first is not among them.
    """

    label: str
    value: str
    names: tuple[str, ...]

    def __post_init__(self):
        if self.value not in self.names:
            raise ValueError(f"{self.label}: {self.value!r} is not one of {', '.join(self.names)}")


@dataclass(frozen=True)
class Still:
    """One picture that does not move, shown by a notebook with or without a kernel.

    png : the file's bytes. alt : what it shows, in words.
    """

    png: bytes
    alt: str

    def __repr__(self):
        return f"Still({self.alt!r})"

    def _repr_mimebundle_(self, include=None, exclude=None):
        """The picture with its alternative text."""
        data = {"text/plain": repr(self), "image/png": base64.b64encode(self.png).decode()}
        return data, {"image/png": {"alt": self.alt}}


class Picture:
    """A figure whose state is set by `draw(...)`; a chapter's picture derives from it.

    A subclass defines
    `build()`          its axes on `self.figure`; every artist that changes is given to `self.moves(...)`
    `draw(**state)`    sets those artists to a state, and nothing else
    `caption(**state)` one line that says what is to be seen
    `alt(**state)`     the picture in words, for a reader who cannot see it

    name : what it shows. size : inches, at 100 dots per inch.
    controls : dict name -> `Number`, `Switch` or `Choice`: keyword arguments of `draw` that a reader may change.
    """

    name = "picture"
    size: tuple[float, float] = (10.0, 5.0)
    controls: Mapping[str, Number | Switch | Choice] = MappingProxyType({})

    def __init__(self):
        self._moving = []
        self._background = None
        with style.context():
            self.figure = Figure(figsize=self.size, dpi=DPI)
            self.canvas = FigureCanvasAgg(self.figure)
            self.build()

    def build(self):
        """Make the axes and the artists."""
        raise NotImplementedError

    def moves(self, *artists):
        """Declare artists that `draw` changes; they are drawn in this order, on top of all that stands still.

        Returns the artist, or the tuple of artists.
        """
        self._moving.extend(artists)
        return artists[0] if len(artists) == 1 else artists

    def draw(self, *args: Any, **state: Any) -> None:
        """Set the artists that move to this state."""
        raise NotImplementedError

    def caption(self, *args: Any, **state: Any) -> str:
        """One line that says what is to be seen."""
        raise NotImplementedError

    def alt(self, *args: Any, **state: Any) -> str:
        """The picture in words, for a reader who cannot see it."""
        raise NotImplementedError

    @property
    def start(self) -> dict[str, float | str]:
        """What the controls begin with: `png` and `still` fill in those that are not given."""
        return {name: control.value for name, control in self.controls.items()}

    def png(self, *args, **state) -> bytes:
        """The picture of this state as fast as it can be had: what stands still is drawn once and kept."""
        self.draw(*args, **self.start | state)
        return self._png(SHARP, compress_level=1)  # it lives for one frame: fast rather than small

    def still(self, *args, **state) -> Still:
        """The picture of this state for keeping: fewer pixels, packed small, with alternative text."""
        state = self.start | state
        self.draw(*args, **state)
        return Still(self._png(1), self.alt(*args, **state))

    def frame(self, axes, centre, half):
        """Set equal axes to the square of half side `half` around `centre` (2,).

        What stands still has to be drawn again when this changes, so it should change rarely.
        """
        limits = np.column_stack([centre - half, centre + half])
        if not np.array_equal(limits, [axes.get_xlim(), axes.get_ylim()]):
            axes.set(xlim=limits[0], ylim=limits[1])
            self._background = None

    def _png(self, scale, **options):
        """The drawn figure as a file. scale : dots per inch, as a multiple of `DPI`. options : of Pillow's save."""
        if self.figure.dpi != scale * DPI:
            self.figure.set_dpi(scale * DPI)
            self._background = None
        if self._background is None:
            self._background = self._draw_background()
        self.canvas.restore_region(self._background)
        renderer = self.canvas.get_renderer()
        for artist in self._moving:
            artist.draw(renderer)
        size = self.canvas.get_width_height(physical=True)
        image = Image.frombuffer("RGBA", size, self.canvas.buffer_rgba(), "raw", "RGBA", 0, 1).convert("RGB")
        file = io.BytesIO()
        image.save(file, "png", **options)
        return file.getvalue()

    def _draw_background(self):
        """All that stands still. The rest is hidden meanwhile, so that it leaves no ghost."""
        visible = [artist.get_visible() for artist in self._moving]
        for artist in self._moving:
            artist.set_visible(False)
        with style.context():
            self.canvas.draw()
        for artist, shown in zip(self._moving, visible):
            artist.set_visible(shown)
        return self.canvas.copy_from_bbox(self.figure.bbox)
