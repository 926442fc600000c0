"""One look for every picture of the series: a method keeps its colour and its line from the first chapter on.

Colours that share a picture differ in lightness too, so they stay apart in a grey print and for colour-blind
readers, or else in line style. What is drawn as an Image in a notebook is also said in words, see `alt_text`.
"""

import base64
import io
import sys
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.figure import Figure as MatplotlibFigure

from .. import kalman

COLOURS = {
    # who says it: trajectories and maps
    "truth": "#000000", "dead_reckoning": "#E0B040", "mapping": "#3FA560", "localize": "#882255", "report": "#409DB0",
    "slam": "#B5485E", "invariant": "#004488", "smoother": "#7A5FB0", "batch": "#117744",
    # what it is: pixels, innovations, verdicts; expected is a bound or the value an honest filter would show
    "measured": "#EE7733", "predicted": "#0055AA", "accepted": "#3FA560", "rejected": "#CC3311", "prior": "#8C8C8C",
    "posterior": "#004488", "expected": "#555555", "faded": "#B8B8B8"}

# The same roles on a dark background: only those differ that would be too dark to see there.
DARK = {"truth": "#F0F0F0", "localize": "#D070A0", "slam": "#E07C90", "invariant": "#6AA8FF", "smoother": "#B09AE8",
        "predicted": "#6AA8FF", "rejected": "#FF6B50", "prior": "#A0A0A0", "posterior": "#6AA8FF",
        "expected": "#B5B5B5", "faded": "#606060"}

# Ends and middle of a scale for numbers of both signs; zero is near the background, but painted.
DIVERGING = {"light": ("#053061", "#4393C3", "#FFFFFF", "#D6604D", "#67001F"),
             "dark": ("#BFE0FF", "#3F8FD0", "#262626", "#D0603F", "#FFD2C0")}

LINESTYLES = {"truth": "-", "dead_reckoning": (0, (1, 1)), "mapping": "-.", "localize": (0, (5, 1, 1, 1)),
              "report": (0, (3, 1, 1, 1, 1, 1)), "slam": "--", "invariant": "-", "smoother": (0, (8, 2)), "batch": "-",
              "measured": "none", "predicted": "none", "prior": "--", "posterior": "-", "expected": "--"}

LABELS = {"truth": "ground truth", "dead_reckoning": "dead reckoning", "mapping": "mapping EKF",
          "localize": "odometry on a known map", "report": "SLAM, the report's values",
          "slam": "SLAM, right perturbation", "invariant": "SLAM, right-invariant", "smoother": "smoother",
          "batch": "batch estimate"}

_RC: dict[Any, Any] = {
    "figure.dpi": 100, "savefig.dpi": 100, "figure.figsize": (7.5, 4.5), "font.size": 10, "axes.titlesize": 11,
    "axes.titlelocation": "left", "axes.labelsize": 10, "xtick.labelsize": 9, "ytick.labelsize": 9,
    "legend.fontsize": 9, "legend.framealpha": 0.9, "legend.edgecolor": "0.8", "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True, "grid.color": "0.9", "grid.linewidth": 0.8,
    "axes.formatter.min_exponent": 6,  # on logarithmic scales 100, not 10², whose exponent is too small to read
    "lines.linewidth": 1.6, "lines.markersize": 4, "image.cmap": "cividis",
    "text.usetex": False, "font.family": "DejaVu Sans"}  # a user's matplotlibrc may ask for what is not installed

# For savefig: the name of matplotlib's version would make files differ that show the same.
PNG: dict[str, Any] = {"metadata": {"Software": None}}


def both_themes() -> dict[str, dict[str, Any]]:
    """The colours of the series on a light and on a dark background, for what is drawn outside of Python."""
    return {"light": {**COLOURS, "scale": DIVERGING["light"]}, "dark": {**COLOURS, **DARK, "scale": DIVERGING["dark"]}}


def use():
    """Apply the style to matplotlib; in a notebook each Figure is then stored with its alternative text."""
    rcParams.update(_RC)
    shell = _ipython()
    if shell is not None:
        shell.display_formatter.formatters["image/png"].for_type(MatplotlibFigure, png_and_alt)


def context():
    """The style for the pictures drawn inside a `with` block, whatever is set outside."""
    return rc_context(_RC)


def styled(draw):
    """Decorator of a function that draws: it runs in the series' style, whatever is set outside."""
    return context()(draw)


class Figure(MatplotlibFigure):
    """A figure that is measured and drawn in the series' style: tick labels are formatted when it is saved."""

    @styled
    def draw(self, renderer) -> None:
        super().draw(renderer)

    @styled
    def get_tightbbox(self, renderer=None, *, bbox_extra_artists=None):
        return super().get_tightbbox(renderer, bbox_extra_artists=bbox_extra_artists)


def _ipython():
    """The running IPython shell, or None; IPython itself is not needed and not imported."""
    module = sys.modules.get("IPython")
    return module.get_ipython() if module else None


def png_and_alt(figure):
    """A figure as IPython stores it: the PNG in base64, and the metadata of that output."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi="figure", bbox_inches="tight", **PNG)
    return base64.b64encode(file.getvalue()).decode(), {"alt": alt_text(figure)}


def alt_text(figure) -> str:
    """A figure in words, for a reader who cannot see it: its title, and for each axes what is plotted against what.

    All words are the figure's own: titles, labels of the axes, names in the legend.
    """
    parts = [figure.get_suptitle(), _scales(figure.get_supylabel(), figure.get_supxlabel())]
    for axes in figure.axes:
        if axes.get_visible():
            names = "; ".join(axes.get_legend_handles_labels()[1])
            parts.append(next(filter(None, map(axes.get_title, ("left", "center", "right"))), ""))
            parts.append(": ".join(filter(None, [_scales(axes.get_ylabel(), axes.get_xlabel()), names])))
    sentences = dict.fromkeys(" ".join(part.split()) for part in parts if part)  # what two axes share is said once
    return " ".join(words if words.endswith((".", "?")) else f"{words}." for words in sentences)


def _scales(y, x) -> str:
    return " against ".join(filter(None, [y, x]))


def line(method):
    """Keyword arguments of `matplotlib.axes.Axes.plot` for a method: colour, line style and label."""
    return {"color": COLOURS[method], "linestyle": LINESTYLES[method], "label": LABELS.get(method, method)}


def ellipse_points(mean, covariance, n=60):
    """Outline of the ellipse that holds a 2-D Gaussian with a probability of 95 %.

    mean : (..., 2). covariance : (..., 2, 2), same units squared, positive semi-definite.
    Returns (..., n, 2), a closed outline: the first point again at the end.
    The squared distance of a Gaussian in two dimensions is chi-square with 2 degrees of freedom; "two sigma"
    in the plane would hold 86 %, not 95 %.
    """
    values, axes = np.linalg.eigh(np.asarray(covariance, dtype=float))
    radii = np.sqrt(kalman.chi_square_quantile(0.95, 2) * np.maximum(values, 0.0))
    angle = np.linspace(0, 2 * np.pi, n)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    outline = (axes * radii[..., None, :]) @ circle
    return np.asarray(mean, dtype=float)[..., None, :] + np.swapaxes(outline, -1, -2)
