"""Pictures of chapters 11 and 12: sparse matrices, errors of iterations, a loop before and after it is closed."""

import numpy as np

from .. import metrics
from . import drawing, style


def _panels(n, height=2.4, **looks):
    """A figure with n axes side by side, and the list of them. height : inches, of the axes."""
    with style.context():
        figure = style.Figure(figsize=(drawing.WIDTH, height + 0.8), layout="constrained")
        return figure, list(np.atleast_1d(figure.subplots(1, n, **looks)))


def sparsity(matrices, title):
    """Where matrices are not zero, side by side. matrices : {title: dense or scipy sparse matrix}. Returns a Figure."""
    figure, panels = _panels(len(matrices))
    for axes, (name, matrix) in zip(panels, matrices.items()):
        rows, columns = matrix.nonzero()
        axes.plot(columns, rows, ",", color=style.COLOURS["posterior"], rasterized=True)
        axes.set(title=name, xlim=(-0.5, matrix.shape[1] - 0.5), ylim=(matrix.shape[0] - 0.5, -0.5), xlabel="column",
                 ylabel="row", aspect="equal" if matrix.shape[0] == matrix.shape[1] else "auto")
        axes.grid(False)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def iterations(drive, paths, title):
    """Position error through time, from the first iteration (light) to the last (dark). Returns a Figure.

    drive : has truth. paths : list of (T, 4, 4).
    """
    figure, axes = drawing.new_figure(2.6)
    for i, path in enumerate(paths):
        last = i == len(paths) - 1
        label = "start: dead reckoning" if i == 0 else "last iteration" if last else f"iteration {i}"
        looks = {"color": style.COLOURS["batch"], "alpha": 0.3 + 0.7 * i / max(1, len(paths) - 1),
                 "linestyle": "-" if last else ":"} if i else {"color": style.COLOURS["dead_reckoning"]}
        axes.plot(drive.times - drive.times[0], metrics.position_errors(drive.true_world_T_imu, path), label=label,
                  **looks)
    axes.set(xlabel="time since start (s)", ylabel="position error (m)")
    return drawing.finish(figure, title)


def draw_batch(result, world_T_imu):
    """Dead reckoning, the filter and the batch estimate on one map. result : `pipeline.Result`. Returns a Figure."""
    method = result.slam.method
    paths = {"dead_reckoning": result.dead_reckoning.world_T_imu, method: result.slam.trajectory.world_T_imu,
             "batch": world_T_imu}
    view = [T[:, :3, 3] for T in paths.values()]
    if result.drive.has_truth:
        view.append(result.drive.true_world_T_imu[:, :3, 3])
    figure, axes = drawing.new_map(drawing.view_around(*view))
    drawing.draw_truth(axes, result.drive)
    for name, poses in paths.items():
        drawing.draw_trajectory(axes, poses, name)
    apart = np.linalg.norm(world_T_imu[:, :3, 3] - result.slam.trajectory.world_T_imu[:, :3, 3], axis=-1)
    return drawing.finish(figure, f"The batch estimate and the filter are {apart.mean():.2f} m apart on average")


def over_time(times, lines, ylabel, title, **scales):
    """Numbers through time. lines : {key of `style.COLOURS`: (T,)}. Returns a Figure.

    scales : for `matplotlib.axes.Axes.set`.
    """
    figure, axes = drawing.new_figure(2.6)
    for name, values in lines.items():
        axes.plot(times - times[0], values, **style.line(name))
    axes.set(xlabel="time since start (s)", ylabel=ylabel, xlim=(0, times[-1] - times[0]), **scales)
    return drawing.finish(figure, title)


def loop(drive, paths, landmarks, covariances, title):
    """A loop with its map, from above: true path, estimated path, 95 % ellipse of each landmark.

    paths : (T, 4, 4), as far as driven. landmarks : (n, 3), m, world. covariances : (n, 3, 3), m^2. Returns a Figure.
    """
    figure, axes = drawing.new_map(drawing.view_around(drive.true_world_T_imu[:, :3, 3], margin=15.0))
    drawing.draw_truth(axes, drive)
    drawing.draw_trajectory(axes, paths, "invariant")
    drawing.draw_ellipses(axes, landmarks, covariances, style.COLOURS["measured"], "95 % of each landmark")
    return drawing.finish(figure, title)


def by_eighth(before, after, title):
    """A number for each eighth of a loop, before and after it was closed. before, after : (8,), m. Returns a Figure."""
    figure, axes = drawing.new_figure(2.4)
    place = np.arange(1, len(before) + 1)
    axes.bar(place - 0.2, before, 0.4, color=style.COLOURS["prior"], label="before the loop is closed")
    axes.bar(place + 0.2, after, 0.4, color=style.COLOURS["posterior"], label="after")
    axes.set(xlabel="eighth of the loop in which the landmark was first seen", ylabel="median sigma (m)", xticks=place)
    return drawing.finish(figure, title)
