"""Chapter 10: the joint filter with one mistake, beside the right one: path, position error, NIS and NEES."""

import textwrap

import numpy as np
from matplotlib.figure import Figure

from ... import metrics, plots
from ...plots import style
from ...plots.style import COLOURS
from ...widgets.canvas import Choice, Picture
from ..panels import LETTERING, add_axes, legend, moving_line

LIMITS = {"error": (0.01, 300), "nis": (0.5, 1e5), "nees": (0.1, 3e5)}
TITLES = {"error": "Distance from the truth (m)", "nis": "NIS, mean of a frame; dotted: 4",
          "nees": "NEES; green: its 95 % band"}


def view(drive, margin=0.15):
    """(x0, x1, y0, y1) m: the true path from above in a square, with a share of its size around it."""
    path = drive.true_world_T_imu[:, :2, 3]
    low, high = path.min(axis=0), path.max(axis=0)
    half = (high - low).max() * (0.5 + margin)
    x, y = (low + high) / 2
    return x - half, x + half, y - half, y + half


def gallery(visits, drive, columns=4) -> Figure:
    """All paths from above, one small map each, truth black; a path that leaves its map has left the street.

    visits : sequence of `broken_filters.Visit`. drive : the `Drive` they made, with truth.
    """
    rows = -(-len(visits) // columns)
    with style.context():
        figure = Figure(figsize=(plots.WIDTH, 2.1 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        x0, x1, y0, y1 = view(drive)
        for place, visit in zip(axes.flat, visits):
            place.plot(*drive.true_world_T_imu[:, :2, 3].T, color=COLOURS["truth"], lw=2.4)
            place.plot(*visit.run.world_T_imu[:, :2, 3].T, color=_colour(visit), lw=1.2, ls="--" if visit.lost else "-")
            words = "{}\nNIS {}\nNEES {}".format(textwrap.fill(visit.title, 23), *visit.numbers[1:])
            place.set_title(words, fontsize=8.5, color=_colour(visit))
            place.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
        for place in axes.flat[len(visits):]:
            place.set_visible(False)
        figure.supxlabel("x (m)", fontsize="medium")
        figure.supylabel("y (m)", fontsize="medium")
        lost = sum(visit.lost for visit in visits)
        figure.suptitle(f"{lost} of {len(visits)} filters lose the street (red, dashed); truth black",
                        fontsize=11, x=0.01, ha="left")
    return figure


def _colour(visit):
    return COLOURS["rejected" if visit.lost else "predicted"]


class MuseumPicture(Picture):
    """One mistake at a time, chosen from a list, in red; the right filter in blue and the truth in black.

    visits : sequence of `broken_filters.Visit`, the right filter's first. drive : the `Drive` they made, with truth.
    Raises ValueError for fewer than two visits.
    """

    name = "mistake museum"
    size = (6.4, 5.8)

    def __init__(self, visits, drive):
        self.visits, self.drive = tuple(visits), drive
        if len(self.visits) < 2:
            raise ValueError(f"visits: the right filter and at least one mistake, got {len(self.visits)} in all")
        names = [visit.title for visit in self.visits[1:]]
        self.controls = {"piece": Choice("mistake", names[0], tuple(names))}
        super().__init__()

    def build(self):
        right, times = self.visits[0], self.drive.times - self.drive.times[0]
        x0, x1, y0, y1 = view(self.drive)
        self.map = add_axes(self, (0.1, 0.54, 0.38, 0.35), "From above", "x (m)", "y (m)", aspect="equal",
                            xlim=(x0, x1), ylim=(y0, y1))
        red = COLOURS["rejected"]
        self.title = self.moves(self.figure.text(0.02, 0.95, "", fontsize=12, weight="bold", color=red))
        self.words = self.moves(self.figure.text(0.98, 0.95, "", fontsize=LETTERING, ha="right"))
        truth = self.map.plot(*self.drive.true_world_T_imu[:, :2, 3].T, color=COLOURS["truth"], lw=2.6, label="truth")
        good = self.map.plot(*right.run.world_T_imu[:, :2, 3].T, color=COLOURS["predicted"], lw=1.2,
                             label="right filter")
        self.path = moving_line(self, self.map, color=red, lw=1.6, ls="--", label="with the mistake")
        self.lines = {}
        places = {"error": (0.58, 0.54, 0.4, 0.35), "nis": (0.1, 0.15, 0.38, 0.26), "nees": (0.58, 0.15, 0.4, 0.26)}
        for kind, rect in places.items():
            axes = add_axes(self, rect, TITLES[kind], "time (s)", xlim=(0, times[-1]), yscale="log", ylim=LIMITS[kind])
            axes.plot(times, getattr(right, kind), color=COLOURS["predicted"], lw=1.2)
            self.lines[kind] = moving_line(self, axes, color=red, lw=1.4, ls="--")
            if kind == "nis":
                axes.axhline(4, color=COLOURS["expected"], ls=":", lw=1.4)
            if kind == "nees":
                band = metrics.chi2_band(6, probability=0.95)
                axes.axhspan(*band, color=COLOURS["accepted"], alpha=0.25, linewidth=0)
        legend(self.figure, [*truth, *good, self.path], loc="lower left")
        self.times = times

    def _visit(self, title):
        return next(visit for visit in self.visits if visit.title == title)

    def draw(self, piece):
        """Show one mistake. piece : its title."""
        visit = self._visit(piece)
        self.title.set_text(visit.title)
        self.words.set_text("RMSE {}, NIS {}, NEES {}".format(*visit.numbers))
        self.path.set_data(*visit.run.world_T_imu[:, :2, 3].T)
        for kind, line in self.lines.items():
            values = np.clip(getattr(visit, kind), *LIMITS[kind])  # what leaves the axes runs along their edge
            line.set_data(self.times[:len(values)], values)

    def caption(self, piece):
        visit, right = self._visit(piece), self.visits[0]
        stopped = "" if visit.run.stopped is None else " It could not go on to the end."
        return (f"{visit.title}: position RMSE {visit.numbers[0]} (right filter {right.numbers[0]}), mean NIS "
                f"{visit.numbers[1]} ({right.numbers[1]}), mean NEES {visit.numbers[2]} ({right.numbers[2]}).{stopped}")

    def alt(self, piece):
        return (f"Paths from above: the truth, the right filter and the one with the mistake '{piece}'; "
                f"through time, their distance from the truth, NIS and NEES. {self.caption(piece)}")
