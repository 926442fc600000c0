"""Figures of chapter 12: a loop before and after it is closed; each returns a Figure."""

import numpy as np

from ...plots import drawing, style


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
