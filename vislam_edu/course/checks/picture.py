"""A picture of a wrong result beside the right one, where it has one.

A covariance becomes an ellipse, poses a path from above, any larger matrix two tables of colours with the wrong entries
framed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import SymLogNorm
from matplotlib.patches import Rectangle

from ...plots import drawing
from ...plots.style import ellipse_points, png_and_alt, styled
from .comparing import wrong_entries

_YOURS, _RIGHT = "#d55e00", "#0072b2"


@dataclass(frozen=True, eq=False)
class Picture:
    """Drawn when a notebook shows it. name : of the result. came, should : the student's and the right one."""

    name: str
    came: np.ndarray
    should: np.ndarray
    tolerance: float

    def __repr__(self) -> str:
        return f"picture of {self.name}, yours and the right one"

    def figure(self):
        """The matplotlib figure."""
        draw = _way_to_draw(self.came, self.should)
        assert draw  # a picture is made only where there is a way to draw it
        return draw(self)

    def _repr_mimebundle_(self, include=None, exclude=None):
        png, metadata = png_and_alt(self.figure())
        return {"image/png": png, "text/plain": repr(self)}, {"image/png": metadata}


def picture_of(exercise, came: list, should: list) -> Picture | None:
    """The picture of the first wrong result that can be drawn; None if no result can."""
    for name, a, b in zip(exercise.outputs or ("the result",), came, should):
        if a.shape == b.shape and np.isfinite(a).all() and np.isfinite(b).all() and \
                wrong_entries(a, b, exercise.tolerance).any() and _way_to_draw(a, b):
            return Picture(name, a, b, exercise.tolerance)
    return None


def _way_to_draw(came, should) -> Callable | None:
    if should.ndim == 3 and should.shape[1:] == (4, 4) and np.allclose(should[:, 3], [0, 0, 0, 1]):
        return _paths
    if should.ndim == 2 and _is_covariance(should) and _is_covariance(came):
        return _ellipses
    return _matrices if should.ndim == 2 and min(should.shape) >= 3 else None


def _is_covariance(P) -> bool:
    return len(P) == P.shape[1] and np.allclose(P, P.T) and np.linalg.eigvalsh((P + P.T) / 2).min() >= 0 and P.any()


@styled
def _curves(picture, points, line, labels, title):
    """The right result and the student's as lines. points : function of a result that gives the points (n, 2)."""
    figure, axes = drawing.new_figure()
    for result, label, colour in ((picture.should, "right", _RIGHT), (picture.came, "yours", _YOURS)):
        axes.plot(*points(result).T, line, label=label, color=colour)
    axes.set(xlabel=labels[0], ylabel=labels[1], aspect="equal")
    axes.set_adjustable("datalim")
    return drawing.finish(figure, f"{picture.name}: {title}")


def _paths(picture):
    return _curves(picture, lambda poses: poses[:, :2, 3], "o-", ("x (m)", "y (m)"), "positions from above")


def _ellipses(picture):
    return _curves(picture, lambda P: ellipse_points(np.zeros(2), P[:2, :2]), "-",
                   ("first variable", "second variable"), "95 % ellipses of its first two variables")


def _matrices(picture):
    framed = np.argwhere(wrong_entries(picture.came, picture.should, picture.tolerance))
    return matrices(picture.came, picture.should, "right", framed, f"{picture.name}: wrong entries are framed")


@styled
def matrices(mine, right, name, framed, title):
    """A figure of two matrices and their difference, each on a colour scale of its own.

    mine, right : (n, m), the student's and that of `name`. framed : (k, 2), entries with a frame.
    """
    figure, axes = drawing.new_figure(height=2.6)
    gap, columns = np.full((len(mine), 1), np.nan), mine.shape[1]
    scaled = [matrix / (np.nanmax(np.abs(matrix)) or 1.0) for matrix in (mine, right, mine - right)]
    axes.imshow(np.hstack([scaled[0], gap, scaled[1], gap, scaled[2]]), cmap="RdBu_r", aspect="auto",
                norm=SymLogNorm(1e-3, vmin=-1, vmax=1))
    lefts = (columns + 1) * np.arange(3)
    for row, column in framed:
        for left in lefts:
            corner = left + column - 0.5, row - 0.5
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor="black", linewidth=2))
    axes.set(xticks=lefts + (columns - 1) / 2, xticklabels=["yours", name, f"yours - {name}"])
    axes.grid(False)
    return drawing.finish(figure, title)
