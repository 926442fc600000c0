"""Figures of chapter 11: sparse matrices, and the error from one iteration to the next; each returns a Figure."""

import numpy as np

from ... import metrics
from ...plots import drawing, style


@style.styled
def sparsity(matrices, title):
    """Where matrices are not zero, side by side. matrices : {title: dense or scipy sparse matrix}. Returns a Figure."""
    figure = style.Figure(figsize=(drawing.WIDTH, 3.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(matrices)))
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
