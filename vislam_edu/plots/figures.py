"""Figures of chapters 00 to 05 that are more than one line of matplotlib; each returns a Figure.

Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame, pixels of the left camera unless it is said
otherwise. The titles say what was found, so they are computed from what is drawn.
"""

import numpy as np
from matplotlib.collections import LineCollection

from .. import se3
from . import drawing, style


@style.styled
def gyro_and_truth(drive):
    """The measured and the true rate of turn to the left (rad/s) over time. drive : Drive with a true path."""
    truth = drive.true_world_T_imu
    true_twists = se3.log(se3.inverse(truth[:-1]) @ truth[1:]) / drive.taus[:, None]
    since_start, measured = drive.times[:-1] - drive.times[0], drive.step_twists[:, 5]
    figure, axes = drawing.new_figure(height=2.4)
    axes.plot(since_start, measured, ".", color=style.COLOURS["measured"], label="gyro, measured")
    axes.plot(since_start, true_twists[:, 5], color=style.COLOURS["truth"], label="true")
    axes.set(xlabel="time since start (s)", ylabel="turning rate (rad/s)")
    noise = np.std(measured - true_twists[:, 5])
    return drawing.finish(figure, f"Rate of turn to the left; the gyro's noise is {noise:.3f} rad/s")


@style.styled
def feature_tracks(drive, k, frames=5):
    """The features of frame k in the left image, each with its path through the last `frames` frames."""
    ids, pixels = drive.observed(k)
    recent = (drive.frame >= k - frames) & (drive.frame <= k)
    tracks = [drive.pixels[recent & (drive.landmark == i), :2] for i in ids]
    figure, axes = _image()
    label = f"the last {drive.times[k] - drive.times[k - frames]:.1f} s"
    axes.add_collection(LineCollection(tracks, colors=style.COLOURS["prior"], label=label))
    axes.plot(*pixels[:, :2].T, ".", color=style.COLOURS["measured"], label=f"feature in frame {k}, left camera")
    return drawing.finish(figure, f"Frame {k}: {len(ids)} features move away from the point the car drives towards")


@style.styled
def disparities(drive, k):
    """The features of frame k: where the left camera sees each, where the right one does, and a line between."""
    ids, pixels = drive.observed(k)
    disparity = pixels[:, 0] - pixels[:, 2]
    figure, axes = _image()
    axes.add_collection(LineCollection(list(pixels.reshape(-1, 2, 2)), colors=style.COLOURS["faded"],
                                       label="disparity"))
    axes.plot(*pixels[:, 2:].T, "x", color=style.COLOURS["predicted"], label="right camera")
    axes.plot(*pixels[:, :2].T, "o", color=style.COLOURS["measured"], label="left camera")
    return drawing.finish(figure, f"Frame {k}: {len(ids)} features, disparities from {disparity.min():.0f} px (far) "
                                  f"to {disparity.max():.0f} px (near)")


@style.styled
def two_paths_and_a_map(drive, reckoned, joint):
    """Dead reckoning and a joint filter with its map; an inset magnifies the last metres.

    drive : Drive with a true path. reckoned : Trajectory. joint : `pipeline.Slam`.
    """
    truth = drive.true_world_T_imu
    figure, axes = drawing.new_map(drawing.view_around(truth[:, :3, 3], reckoned.world_T_imu[:, :3, 3], margin=25))
    drawing.draw_landmarks(axes, joint.map.landmarks, joint.method, label="landmarks, joint filter", alpha=0.4)
    drawing.draw_position_ellipses(axes, reckoned, "dead_reckoning")
    drawing.draw_trajectory(axes, reckoned.world_T_imu, "dead_reckoning")
    drawing.draw_truth(axes, drive)
    path = joint.trajectory.world_T_imu
    drawing.draw_trajectory(axes, path, joint.method, label="joint filter")
    inset = drawing.draw_inset(axes, truth[-1, :2, 3], 2.0, (0.32, 0.36, 0.36, 0.36), "start and end, magnified (m)")
    drawing.draw_truth(inset, drive)
    drawing.draw_trajectory(inset, path, joint.method)
    drawing.draw_position_ellipses(inset, joint.trajectory, joint.method, count=120)
    driven = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    ends = [np.linalg.norm(T[-1, :3, 3] - truth[-1, :3, 3]) for T in (reckoned.world_T_imu, path)]
    return drawing.finish(figure, f"After {driven:.0f} m dead reckoning is {ends[0]:.0f} m off and the joint filter "
                                  f"{ends[1]:.1f} m")


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


@style.styled
def depth_law(depths, first_order, sampled):
    """Standard deviation of a triangulated depth (m) against depth (m), on logarithmic scales.

    depths, first_order : (n,), m, the formula's line. sampled : dict from a depth to what draws gave.
    """
    figure, axes = drawing.new_figure(height=3.0)
    axes.plot(depths, first_order, color=style.COLOURS["predicted"], label="first order, z² / (f b) √2 σ")
    axes.plot(sampled.keys(), sampled.values(), "o", color=style.COLOURS["measured"],
              label="half the width of the inner 68 % of draws")
    axes.plot(depths, 0.1 * depths, ":", color=style.COLOURS["expected"], label="a tenth of the depth")
    axes.set(xscale="log", yscale="log", xlabel="depth (m)", ylabel="standard deviation of depth (m)")
    near, far = np.interp([10, 40], depths, first_order)
    return drawing.finish(figure, f"Depth is known to {near:.2f} m at 10 m and to {far:.1f} m at 40 m: "
                                  f"4 times the distance, {far / near:.0f} times the error")


@style.styled
def landmarks_of_one_frame(drive, k, sigma_px, reach=60):
    """The landmarks of frame k within `reach` (m), triangulated from the true pose, with their 95 % ellipses."""
    camera, T = drive.camera, drive.true_world_T_imu[k]
    ids, pixels = drive.observed(k)
    in_cam, _ = camera.triangulate(pixels)
    R = (T @ camera.imu_T_cam)[:3, :3]
    covariance = R @ camera.triangulation_covariance(in_cam, sigma_px) @ R.T
    points, true = camera.to_world(T, in_cam), drive.true_landmarks[ids]
    near = np.linalg.norm(points[:, :2] - T[:2, 3], axis=1) < reach
    figure, axes = drawing.new_map(drawing.view_around(true[near], T[None, :3, 3], margin=15))
    drawing.draw_ellipses(axes, points[near], covariance[near], style.COLOURS["mapping"], "95 % of a landmark")
    axes.plot(*points[near, :2].T, ".", color=style.COLOURS["mapping"], label="triangulated")
    axes.plot(*true[near, :2].T, "+", color=style.COLOURS["truth"], label="true landmark")
    axes.plot(*T[:2, 3], "s", color=style.COLOURS["predicted"], label="car, here known exactly")
    sizes = np.sqrt(np.trace(covariance[near], axis1=1, axis2=2))
    return drawing.finish(figure, "One frame's points are uncertain along the line of sight: one sigma is "
                                  f"{sizes.min():.2f} m for the nearest and {sizes.max():.0f} m for the farthest")


@style.styled
def nis_histogram(nis, threshold):
    """NIS of stereo measurements beside the chi-square density of 4 degrees of freedom, and the gate.

    nis : (n,). threshold : the gate's. Values above 20 are not drawn.
    """
    figure, axes = drawing.new_figure(2.2)
    grid = np.linspace(0, 20, 200)
    axes.hist(nis, bins=grid[::5], density=True, color=style.COLOURS["mapping"], alpha=0.35,
              label="innovations of the drive")
    axes.plot(grid, grid / 4 * np.exp(-grid / 2), color=style.COLOURS["expected"], linestyle="--",
              label="chi-square, 4 degrees of freedom")
    axes.axvline(threshold, color=style.COLOURS["rejected"], label="gate")
    axes.set(xlabel="NIS of one stereo measurement", ylabel="density", xlim=(0, 20))
    return drawing.finish(figure, f"Mean NIS {np.mean(nis):.1f}, where an honest filter has 4")


@style.styled
def jacobian_pattern(H):
    """Which entries of the joint Jacobian H (rows, 3n+6) are not zero."""
    figure, axes = drawing.new_figure(3.0)
    axes.grid(False)
    axes.imshow(H != 0, cmap="Greys", aspect="auto", interpolation="nearest",
                extent=(0, H.shape[1], H.shape[0], 0))
    axes.axvline(H.shape[1] - 6, color=style.COLOURS["slam"], linestyle="--",
                 label="landmarks to the left, pose to the right")
    axes.set(xlabel="column: error of the state (three a landmark, then six of the pose)",
             ylabel="row: pixel (four a landmark)")
    return drawing.finish(figure, f"H, black where not zero ({100 * np.mean(H != 0):.0f} %): landmarks share nothing "
                                  "but the pose")


def _image():
    """Figure and axes that are the left camera's image, px; v points down."""
    figure, axes = drawing.new_figure(height=1.75)
    axes.set(xlim=(0, 1241), ylim=(376, 0), aspect="equal", xlabel="u (px)", ylabel="v (px)")
    return figure, axes
