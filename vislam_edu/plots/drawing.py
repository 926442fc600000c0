"""Static pictures: maps seen from above, uncertainty as 95 % regions, ground truth in black.

Functions that start with `draw_` put artists on axes that they are given. The others make a `Figure` and
return it. pyplot is not involved: in a notebook the figure is the cell's last expression (no semicolon), in a
script `figure.savefig(path)` writes it.

Maps are in metres, world frame, equal scales: x (forward at the start) to the right, y (left at the start) up.
"""

import re
import textwrap

import numpy as np
from matplotlib.collections import LineCollection
from scipy.special import ndtri

from .. import se3
from . import style

__all__ = ["TWO_SIDED_95", "WIDTH", "draw_ellipses", "draw_inset", "draw_landmarks", "draw_position_ellipses",
           "draw_trajectory", "draw_truth", "finish", "heading", "heading_error", "heading_sigma",
           "inside", "new_figure", "new_map", "over_time", "plane_sigma", "position_covariance", "position_outlines",
           "trajectories", "view_around", "view_with_outlines"]

WIDTH = 6.4  # inches, of every figure: 640 px
_AXES_LEFT, _AXES_WIDTH = 0.75, 5.5  # inches, the same in every figure, so that pictures line up on a page
_MAP_HEIGHTS = (3.0, 5.4)  # inches, least and greatest height of a map's axes
_TITLE_CHARACTERS = 64  # of a line above the axes
_LINE = 0.2  # inches, a line of a title or a legend
_LEGEND_HANDLE, _LEGEND_CHARACTER = 0.6, 0.063  # inches
TWO_SIDED_95 = float(ndtri(0.975))


def position_covariance(trajectory):
    """(T, 3, 3) m^2, covariance of each position in the world frame.

    trajectory : Trajectory, whose covariance is that of a right perturbation: p - p_hat = R epsilon_v.
    """
    R = trajectory.world_T_imu[:, :3, :3]
    return R @ trajectory.covariance[:, :3, :3] @ np.swapaxes(R, -1, -2)


def heading(world_T_imu):
    """(...) rad in (-pi, pi], direction of the body's x axis over the ground, world x towards y."""
    return np.arctan2(world_T_imu[..., 1, 0], world_T_imu[..., 0, 0])


def heading_sigma(trajectory):
    """(T,) rad, standard deviation of the rotation about the world's z axis."""
    z = trajectory.world_T_imu[:, 2, :3]  # the world's z axis in the body frame
    return np.sqrt(np.einsum("ki,kij,kj->k", z, trajectory.covariance[:, 3:, 3:], z))


def plane_sigma(trajectory):
    """(T,) m, standard deviation of the position in the plane: root of the mean of the variances of x and y."""
    return np.sqrt(np.trace(position_covariance(trajectory)[:, :2, :2], axis1=1, axis2=2) / 2)


def view_around(*positions, margin=30.0):
    """Limits (x_min, x_max, y_min, y_max), m, of a map that shows these positions and a margin.

    positions : arrays (..., 2 or more), rows with NaN are left out. margin : m on every side. Landmarks are
    not asked: one badly triangulated point a kilometre away would shrink the drive to a dot.
    """
    xy = np.concatenate([np.asarray(p, dtype=float)[..., :2].reshape(-1, 2) for p in positions])
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        xy = np.zeros((1, 2))
    (x0, y0), (x1, y1) = xy.min(axis=0) - margin, xy.max(axis=0) + margin
    # The shorter side is lengthened where the map would be flatter or taller than a page allows
    low, high = (h / _AXES_WIDTH for h in _MAP_HEIGHTS)
    width, height = x1 - x0, y1 - y0
    more_height, more_width = max(0.0, low * width - height), max(0.0, height / high - width)
    return x0 - more_width / 2, x1 + more_width / 2, y0 - more_height / 2, y1 + more_height / 2


def view_with_outlines(paths, outlines):
    """The view around paths and ellipses; ellipses that leave the paths far behind (by a quarter of their
    extent) are cut off, or a filter that knows nothing would shrink the drive to a dot.
    """
    xy = np.concatenate([p[:, :2] for p in paths])
    xy = xy[np.isfinite(xy).all(axis=1)]
    low, high = xy.min(axis=0), xy.max(axis=0)
    reach = 0.25 * np.linalg.norm(high - low)
    return view_around(xy, *[np.clip(o, low - reach, high + reach) for o in outlines], margin=10.0)


def inside(view, points):
    """(n,) bool: which points (n, 2 or more) lie within the view."""
    x0, x1, y0, y1 = view
    return (points[:, 0] >= x0) & (points[:, 0] <= x1) & (points[:, 1] >= y0) & (points[:, 1] <= y1)


@style.styled
def new_map(view):
    """Figure and equal-axis map for a view (x_min, x_max, y_min, y_max), m."""
    x0, x1, y0, y1 = view
    figure, axes = new_figure(_AXES_WIDTH * (y1 - y0) / (x1 - x0))
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal",
             xlabel="x, forward at the start (m)", ylabel="y, left at the start (m)")
    return figure, axes


@style.styled
def new_figure(height=3.0):
    """Figure of the series' width and its one axes, in the series' style. height : inches, of the axes."""
    figure = style.Figure(figsize=(WIDTH, height))
    return figure, figure.add_axes((_AXES_LEFT / WIDTH, 0, _AXES_WIDTH / WIDTH, 1))


@style.styled
def finish(figure, title):
    """Title above the axes and legend below them, where neither can hide data; the figure grows to hold both.

    The places are computed: a layout engine does not settle when the scales of the axes must be equal.
    """
    axes = figure.axes[0]
    box = axes.get_position(original=True)
    height = box.height * figure.get_figheight()
    title = re.sub(r"(?<=\d) (?=(m|s|%)\b|%)", "\N{NO-BREAK SPACE}", title)
    lines = textwrap.wrap(title, _TITLE_CHARACTERS, break_on_hyphens=False)
    handles, labels = axes.get_legend_handles_labels()
    column = _LEGEND_HANDLE + _LEGEND_CHARACTER * max(map(len, labels), default=0)
    columns = min(len(labels), max(1, int(WIDTH / column)))
    rows = -(-len(labels) // max(1, columns))
    below, above = 0.55 + (0.15 + _LINE * rows if rows else 0.0), 0.15 + _LINE * len(lines)
    total = below + height + above
    figure.set_size_inches(WIDTH, total)
    axes.set_position((box.x0, below / total, box.width, height / total))
    axes.set_title("\n".join(lines))
    if rows:
        legend = figure.legend(handles, labels, loc="lower center", ncols=columns)
        for line in legend.get_lines():  # a map's dots are too small to tell their colour, other markers are not
            line.set_markersize(max(line.get_markersize(), 5))
    return figure


def draw_trajectory(axes, world_T_imu, method, **changes):
    """The path of the IMU with a dot where it starts. method : key of `style.COLOURS`. Returns the line."""
    path = world_T_imu[:, :2, 3]
    line, = axes.plot(path[:, 0], path[:, 1], **{**style.line(method), **changes})
    start = path[np.isfinite(path).all(axis=1)][:1]
    axes.plot(start[:, 0], start[:, 1], "o", color=line.get_color(), markersize=6, zorder=3)
    return line


def draw_truth(axes, drive):
    """The true path in black, if the drive has one. Returns the line or None."""
    return draw_trajectory(axes, drive.true_world_T_imu, "truth", linewidth=1.2) if drive.has_truth else None


def draw_landmarks(axes, points, method, **changes):
    """Landmarks (n, 3) as dots. Returns the line that holds them."""
    looks = {"linestyle": "none", "marker": ".", "markersize": 3, "markeredgewidth": 0, "alpha": 0.6,
             "color": style.COLOURS[method], "label": f"landmarks, {style.LABELS[method]}"}
    line, = axes.plot(points[:, 0], points[:, 1], **{**looks, **changes})
    return line


def position_outlines(trajectory, count=12):
    """(count, n, 2) m, 95 % ellipses of the position at frames evenly spread from the first to the last."""
    frames = np.unique(np.linspace(0, len(trajectory.times) - 1, count).astype(int))
    return style.ellipse_points(trajectory.world_T_imu[frames, :2, 3], position_covariance(trajectory)[frames, :2, :2])


def draw_position_ellipses(axes, trajectory, method, count=12):
    """The `position_outlines` of a trajectory. Returns the LineCollection."""
    collection = LineCollection(position_outlines(trajectory, count), colors=style.COLOURS[method],
                                linewidths=0.9, label=f"95 % of the position, {style.LABELS[method]}")
    return axes.add_collection(collection, autolim=False)


def draw_ellipses(axes, means, covariances, colour, label="95 % ellipses"):
    """Outlines that each hold a Gaussian on the ground plane with a probability of 95 %.

    means : (n, 2 or more), m. covariances : (n, 2 or more, the same), m^2, in the world frame; x, y are used.
    Returns the LineCollection.
    """
    outlines = style.ellipse_points(means[:, :2], covariances[:, :2, :2])
    return axes.add_collection(LineCollection(outlines, colors=colour, linewidths=0.9, label=label), autolim=False)


def draw_inset(axes, centre, half, place, title):
    """A magnified square of a map. centre : (2,), m. half : m, half its side. place : (x, y, width, height) as shares
    of the axes. Returns its axes, which hold nothing yet; a frame in the map shows where it is."""
    x, y = centre
    inset = axes.inset_axes(place, aspect="equal", xlim=(x - half, x + half), ylim=(y - half, y + half))
    inset.tick_params(labelsize=8)
    inset.locator_params(nbins=3)
    inset.set_title(title, fontsize=9)
    inset.patch.set_alpha(0.95)
    axes.indicate_inset(inset_ax=inset, edgecolor=style.COLOURS["expected"])
    return inset


@style.styled
def trajectories(drive, estimates, title=""):
    """Paths of several methods on one map, each with 95 % ellipses; the truth in black where there is one.

    drive : Drive. estimates : dict from a key of `style.COLOURS` to a Trajectory. Returns a Figure.
    """
    paths = [t.world_T_imu[:, :3, 3] for t in estimates.values()]
    if drive.has_truth:
        paths.append(drive.true_world_T_imu[:, :3, 3])
    figure, axes = new_map(view_with_outlines(paths, [position_outlines(t) for t in estimates.values()]))
    draw_truth(axes, drive)
    for method, trajectory in estimates.items():
        draw_trajectory(axes, trajectory.world_T_imu, method)
        draw_position_ellipses(axes, trajectory, method)
    return finish(figure, title)


def heading_error(true_world_T_imu, world_T_imu):
    """(...) rad in (-pi, pi], estimated minus true heading; NaN where there is no truth."""
    return heading(world_T_imu @ se3.inverse(true_world_T_imu))


def over_time(times, lines, ylabel, title, **scales):
    """Numbers through time. lines : {key of `style.COLOURS`: (T,)}. Returns a Figure.

    scales : for `matplotlib.axes.Axes.set`.
    """
    figure, axes = new_figure(2.6)
    for name, values in lines.items():
        axes.plot(times - times[0], values, **style.line(name))
    axes.set(xlabel="time since start (s)", ylabel=ylabel, xlim=(0, times[-1] - times[0]), **scales)
    return finish(figure, title)
