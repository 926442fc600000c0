"""Figures of chapter 01. Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame; each is a Figure."""

import numpy as np

from ...plots import drawing, style


@style.styled
def sigmas_over_time(trajectory):
    """Standard deviations that a trajectory claims: of its position in the plane (m), of its heading (degrees).

    trajectory : Trajectory. The position's is the root of the mean variance of x and y, `plane_sigma`.
    """
    since_start = trajectory.times - trajectory.times[0]
    position, heading = drawing.plane_sigma(trajectory), np.degrees(drawing.heading_sigma(trajectory))
    figure, axes = drawing.new_figure(height=2.6)
    axes.plot(since_start, position, color=style.COLOURS["dead_reckoning"], label="position (m)")
    axes.plot(since_start, heading, "--", color=style.COLOURS["predicted"], label="heading (°)")
    axes.set(xlabel="time since start (s)", ylabel="standard deviation (m, °)")
    shrinks = [100 * np.mean(np.diff(sigma) < 0) for sigma in (position, heading)]
    return drawing.finish(figure, f"The standard deviation of the position shrinks in {shrinks[0]:.0f} % of the steps, "
                                  f"that of the heading in {shrinks[1]:.0f} %")


@style.styled
def heading_band(drive, trajectory, method="dead_reckoning"):
    """How wrong the heading is, and how wrong it claims to be: error over time and a 95 % band.

    drive : Drive. trajectory : Trajectory. method : key of `style.COLOURS`. Without truth the band is drawn
    around zero and nothing is known about the error. Returns a Figure.
    """
    t = trajectory.times - trajectory.times[0]
    band = np.degrees(drawing.TWO_SIDED_95 * drawing.heading_sigma(trajectory))
    figure, axes = drawing.new_figure()
    axes.fill_between(t, -band, band, color=style.COLOURS[method], alpha=0.25, linewidth=0, label="95 % band claimed")
    axes.set(xlabel="time since start (s)", ylabel="heading error (°)", xlim=(0, t[-1] or 1))
    name = style.LABELS[method][0].upper() + style.LABELS[method][1:]
    if not drive.has_truth:
        return drawing.finish(figure, f"{name} claims its heading to ±{band[-1]:.2g}° at the end")
    error = np.degrees(drawing.heading_error(drive.true_world_T_imu, trajectory.world_T_imu))
    axes.plot(t, error, color=style.COLOURS[method], label="estimated minus true heading")
    known = np.isfinite(error)
    share = 100 * np.mean(np.abs(error[known]) <= band[known])
    claim, off = band[known][-1], abs(error[known][-1])
    return drawing.finish(figure, f"{name} claims its heading to ±{claim:.2g}° at the end and is {off:.2g}° off: "
                          f"inside the 95 % band in {share:.0f} % of frames")


@style.styled
def cloud_and_outlines(truth, positions, outlines, shares):
    """End positions of many runs with two outlines that should hold 95 % of them.

    truth : (T, 4, 4), the path up to the end. positions : (n, 2 or more), m. outlines : dict with "ellipse" and
    "banana", (m, 2) each. shares : dict of the same keys, the share of the runs inside.
    """
    figure, axes = drawing.new_map(drawing.view_around(truth[:, :3, 3], positions, margin=10))
    drawing.draw_trajectory(axes, truth, "truth")
    axes.plot(*positions[:, :2].T, ".", color=style.COLOURS["prior"], markersize=2,
              label=f"{len(positions)} noisy runs")
    axes.plot(*outlines["ellipse"].T, "--", color=style.COLOURS["slam"], label="95 %, Gaussian in x and y")
    axes.plot(*outlines["banana"].T, color=style.COLOURS["posterior"], label="95 %, Gaussian in exp coordinates")
    return drawing.finish(figure, "The ellipse should hold 95 % of the runs and holds "
                                  f"{100 * shares['ellipse']:.0f} %; the same covariance through exp holds "
                                  f"{100 * shares['banana']:.0f} %")
