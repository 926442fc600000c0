"""Axes and legends with small lettering, shared by the pictures of several chapters."""

import numpy as np

from .. import plots
from ..simulate import IMAGE_SIZE

# Points. GitHub shows a picture of 1000 px 830 px wide, where lettering of 9.5 points measures 8.2.
TITLE, LETTERING = 10, 9.5


def add_axes(picture, rect, title, xlabel="", ylabel="", **kwargs):
    """Axes at rect (left, bottom, width, height as shares of the figure) with small lettering."""
    axes = picture.figure.add_axes(rect, **kwargs)
    axes.set_title(title, fontsize=TITLE, loc="left")
    axes.set_xlabel(xlabel, fontsize=LETTERING)
    axes.set_ylabel(ylabel, fontsize=LETTERING)
    axes.tick_params(labelsize=LETTERING)
    return axes


def moving_line(picture, axes, *form, **style):
    """A line of the axes, empty until the picture's `draw` gives it points. form, style : as of matplotlib's plot."""
    return picture.moves(*axes.plot([], [], *form, **style))


def legend(axes, handles, columns=9, **kwargs):
    """A legend in one row or a few, by default under the axes' upper edge on the right."""
    kwargs = {"loc": "upper right", "borderaxespad": 0.3, **kwargs}
    return axes.legend(handles=handles, ncols=columns, fontsize=LETTERING, framealpha=0.85, handlelength=1.6,
                       handletextpad=0.5, columnspacing=1.0, borderpad=0.3, labelspacing=0.3, **kwargs)


def legend_above(axes, handles, lines=1, x=0.0):
    """A legend of one line or two between the axes and their title, which moves up. x : share of the axes' width."""
    axes.set_title(axes.get_title("left"), fontsize=TITLE, loc="left", pad=3 + 16 * lines, x=x)
    return legend(axes, handles, columns=-(-len(handles) // lines), loc="lower left", bbox_to_anchor=(x, 1),
                  frameon=False, borderaxespad=0)


def fit_equal(axes, *points, margin):
    """Limits of equal scale on both axes that hold points (n, 2) with a margin, in their units."""
    x0, x1, y0, y1 = plots.view_around(*points, margin=margin)
    box = axes.get_window_extent()
    scale = max((x1 - x0) / box.width, (y1 - y0) / box.height)  # units per px
    (x, y), half = np.array([x0 + x1, y0 + y1]) / 2, scale / 2 * np.array([box.width, box.height])
    axes.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))


def round_up(length, steps=(1, 2, 5, 10)):
    """The next of these numbers times a power of ten: axes that hold it change seldom."""
    power = 10.0 ** np.floor(np.log10(length))
    return power * next(step for step in steps if step * power >= length)


def image_axes(picture, rect, title):
    """Axes at rect that are one camera's image, px; v points down."""
    width, height = IMAGE_SIZE
    return add_axes(picture, rect, title, xlim=(0, width), ylim=(height, 0), aspect="equal", anchor="W",
                    facecolor="0.97")


def new_image():
    """Figure and axes that are the left camera's image, px; v points down."""
    figure, axes = plots.new_figure(height=1.75)
    axes.set(xlim=(0, IMAGE_SIZE[0]), ylim=(IMAGE_SIZE[1], 0), aspect="equal", xlabel="u (px)", ylabel="v (px)")
    return figure, axes
