"""The axes that several chapters share: a map from above, the left image, and a quantity through time."""

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Polygon
from scipy.stats import chi2

from ..plots.style import COLOURS, ellipse_points
from ..simulate import IMAGE_SIZE

# Points. GitHub shows a picture of 1000 px 830 px wide, where lettering of 9.5 points measures 8.2.
TITLE, LETTERING = 10, 9.5
CAR = np.array([[2.2, 0.0], [-1.4, 1.2], [-1.4, -1.2]])  # m, body x and y: an arrow head, nose forward


def add_axes(picture, rect, title, xlabel="", ylabel="", **kwargs):
    """Axes at rect (left, bottom, width, height as shares of the figure) with small lettering."""
    axes = picture.figure.add_axes(rect, **kwargs)
    axes.set_title(title, fontsize=TITLE, loc="left")
    axes.set_xlabel(xlabel, fontsize=LETTERING)
    axes.set_ylabel(ylabel, fontsize=LETTERING)
    axes.tick_params(labelsize=LETTERING)
    return axes


def legend(axes, handles, columns=9, **kwargs):
    """A legend in one row or a few, by default under the axes' upper edge on the right."""
    kwargs = {"loc": "upper right", "borderaxespad": 0.3, **kwargs}
    return axes.legend(
        handles=handles,
        ncols=columns,
        fontsize=LETTERING,
        framealpha=0.85,
        handlelength=1.6,
        handletextpad=0.5,
        columnspacing=1.0,
        borderpad=0.3,
        labelspacing=0.3,
        **kwargs,
    )


def legend_above(axes, handles, lines=1, x=0.0):
    """A legend of one line or two between the axes and their title, which moves up. x : share of the axes' width."""
    axes.set_title(axes.get_title("left"), fontsize=TITLE, loc="left", pad=3 + 16 * lines, x=x)
    return legend(axes, handles, columns=-(-len(handles) // lines), loc="lower left", bbox_to_anchor=(x, 1),
                  frameon=False, borderaxespad=0)


def image_axes(picture, rect, title):
    """Axes at rect that are one camera's image, px; v points down."""
    width, height = IMAGE_SIZE
    return add_axes(picture, rect, title, xlim=(0, width), ylim=(height, 0), aspect="equal", anchor="W",
                    facecolor="0.97")


def phase_colour(updated):
    """Grey while the filter only predicts, blue once it has looked."""
    return COLOURS["posterior" if updated else "prior"]


def outline(world_T_imu, shape=CAR):
    """Corners (n, 2) of a shape given in body x and y, seen from above in the world."""
    return shape @ world_T_imu[:2, :2].T + world_T_imu[:2, 3]


def principal_sigmas(covariance):
    """(..., 3) standard deviations along the principal axes, largest first. covariance : (..., 3, 3)."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))[..., ::-1]


def nis_band(n_numbers):
    """NIS / degrees of freedom that 95 % of honest frames show, (2, ...), for frames of so many numbers."""
    n_numbers = np.asarray(n_numbers)
    return np.array([chi2.ppf(p, n_numbers) / n_numbers for p in (0.025, 0.975)])


class MapPanel:
    """The world from above: the car, where it was, and landmarks with their 95 % ellipses.

    rect : as for `add_axes`. points : (n, 2) m, what the map must hold; its scale is equal on both axes and fixed.
    true_landmarks : (M, 3) and true_path : (T, 4, 4), or None.
    """

    def __init__(self, picture, rect, title, points, true_landmarks=None, true_path=None):
        self.axes = add_axes(picture, rect, title, "x (m)", "y (m)")
        self._fit(points)
        handles = []
        if true_landmarks is not None:
            handles += self.axes.plot(*true_landmarks[:, :2].T, "+", ms=5, mew=0.8, color="0.55", label="true landmark")
        if true_path is not None:
            handles += self.axes.plot(*true_path[:, :2, 3].T, "-", lw=0.8, color="0.55", label="true path")
        self.ellipses = self.axes.add_collection(
            PolyCollection([], facecolor=(0, 0.3, 0.6, 0.06), lw=1.2, label="95 % ellipse"), autolim=False
        )
        (self.points,) = self.axes.plot([], [], ".", ms=4, color="black", label="landmark")
        (self.chosen,) = self.axes.plot([], [], "o", ms=9, mew=1.5, mfc="none", mec=COLOURS["measured"])
        (self.path,) = self.axes.plot([], [], "-", lw=1.4, color=COLOURS["posterior"], label="path")
        self.car = self.axes.add_patch(Polygon(CAR, facecolor="white", edgecolor="black", lw=1.0))
        picture.moves(self.ellipses, self.points, self.chosen, self.path, self.car)
        legend(self.axes, [self.path, self.points, *handles], loc="upper left", columns=2)

    def _fit(self, points):
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
        box = self.axes.get_window_extent()
        scale = max(*((high - low) * 1.1 / (box.width, box.height)))  # m per px
        half = scale * np.array([box.width, box.height]) / 2
        (x0, y0), (x1, y1) = (low + high) / 2 - half, (low + high) / 2 + half
        self.axes.set(xlim=(x0, x1), ylim=(y0, y1))

    def draw(self, path, means, covariances, updated, chosen=()):
        """path : (k, 4, 4), ends where the car is. means : (n, 2+), covariances : (n, 2+, 2+), m and m^2, world.

        updated : the phase, by `phase_colour`. chosen : (2,), a landmark to ring, or empty.
        """
        self.ellipses.set_verts(ellipse_points(means[:, :2], covariances[:, :2, :2]))
        self.ellipses.set_edgecolor(phase_colour(updated))
        self.points.set_data(*means[:, :2].T)
        self.chosen.set_data(*np.reshape(chosen, (-1, 2)).T)
        self.path.set_data(*path[:, :2, 3].T)
        self.car.set_xy(outline(path[-1]))


class ImagePanel:
    """The left image: every measured pixel, and around it, enlarged, what the filter had predicted.

    Predicted pixel, innovation and the 95 % ellipse of S are drawn `enlarged` times as far from the measured
    pixel as they are: an innovation is a few pixels of 1241, too short to be seen. At the update the prediction
    moves towards the measurement.
    """

    def __init__(self, picture, rect, enlarged):
        self.enlarged = enlarged
        title = f"Left image (px); predictions {enlarged} × as far from the measured pixel"
        self.axes = image_axes(picture, rect, title)
        self.ellipses = self.axes.add_collection(
            PolyCollection([], facecolor="none", edgecolor=COLOURS["predicted"], lw=1.0, label="95 % of S"),
            autolim=False,
        )
        self.arrows = self.axes.add_collection(
            LineCollection([], lw=1.6, color=COLOURS["accepted"], label="innovation"), autolim=False
        )
        (self.predicted,) = self.axes.plot([], [], "x", ms=5, mew=1.2, color=COLOURS["predicted"], label="predicted")
        (self.measured,) = self.axes.plot([], [], "o", ms=3.5, color=COLOURS["measured"], label="measured")
        (self.chosen,) = self.axes.plot([], [], "o", ms=11, mew=1.5, mfc="none", mec=COLOURS["measured"])
        picture.moves(self.ellipses, self.arrows, self.predicted, self.measured, self.chosen)
        legend_above(self.axes, [self.measured, self.predicted, self.arrows, self.ellipses])

    def draw(self, innovation, pixels, projected=None, chosen=()):
        """innovation : `kalman.Innovation`. pixels : (n, 4), all that was measured. chosen : (2,) or empty.

        projected : (m, 4), where the shown belief puts the landmarks of the innovation, by default as predicted.
        """
        measured, predicted = innovation.measured[:, :2], innovation.predicted[:, :2]
        projected = predicted if projected is None else projected[:, :2]
        far = measured + self.enlarged * (predicted - measured)
        self.ellipses.set_verts(ellipse_points(far, self.enlarged**2 * innovation.covariance[:, :2, :2]))
        self.arrows.set_segments(np.stack([far, measured], axis=1))
        self.arrows.set_color([COLOURS["accepted" if good else "rejected"] for good in innovation.accepted])
        self.arrows.set_linestyle(["-" if good else ":" for good in innovation.accepted] or "-")
        self.predicted.set_data(*(measured + self.enlarged * (projected - measured)).T)
        self.measured.set_data(*pixels[:, :2].T)
        self.chosen.set_data(*np.reshape(chosen, (-1, 2)).T)


class TimePanel:
    """Quantities through time, drawn up to the half-step that is shown.

    times (n,) s of the half-steps. lines : list of (values (n,), keyword arguments of `plot`). still : the
    same for lines that are there from the start, such as a band.
    """

    def __init__(self, picture, rect, title, ylabel, times, lines, still=(), **axes):
        self.times = times
        xlabel = axes.pop("xlabel", "time (s)")
        self.axes = add_axes(picture, rect, title, xlabel, ylabel, **axes)
        self.axes.set_xlim(times[0], times[0] + 1.02 * max(times[-1] - times[0], 0.1))
        for values, style in still:
            self.axes.plot(times, values, **style)
        self.values = [np.array(values) for values, _ in lines]
        self.lines = [
            self.axes.plot(times, values, marker="o", ms=4, markevery=[-1], **style)[0] for values, style in lines
        ]
        self.cursor = self.axes.axvline(times[0], color="0.6", lw=0.8)
        picture.moves(self.cursor, *self.lines)

    def draw(self, i, values=None):
        """Show half-steps 0 ... i, of other values than at the start if they are given, one (n,) for each line."""
        for line, y in zip(self.lines, self.values if values is None else values):
            line.set_data(self.times[: i + 1], y[: i + 1])
        self.cursor.set_xdata([self.times[i]] * 2)
