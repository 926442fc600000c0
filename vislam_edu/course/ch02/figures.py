"""Figures of chapter 02. Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame; each is a Figure."""

import numpy as np
from matplotlib.collections import LineCollection

from ...plots import drawing, style
from ..panels import new_image


@style.styled
def disparities(drive, k):
    """The features of frame k: where the left camera sees each, where the right one does, and a line between."""
    ids, pixels = drive.observed(k)
    disparity = pixels[:, 0] - pixels[:, 2]
    figure, axes = new_image()
    axes.add_collection(LineCollection(list(pixels.reshape(-1, 2, 2)), colors=style.COLOURS["faded"],
                                       label="disparity"))
    axes.plot(*pixels[:, 2:].T, "x", color=style.COLOURS["predicted"], label="right camera")
    axes.plot(*pixels[:, :2].T, "o", color=style.COLOURS["measured"], label="left camera")
    return drawing.finish(figure, f"Frame {k}: {len(ids)} features, disparities from {disparity.min():.0f} px (far) "
                                  f"to {disparity.max():.0f} px (near)")


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
