"""Figures of chapter 00. Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame; each is a Figure."""

import numpy as np
from matplotlib.collections import LineCollection

from ... import se3
from ...plots import drawing, style
from ..panels import new_image


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
    figure, axes = new_image()
    label = f"the last {drive.times[k] - drive.times[k - frames]:.1f} s"
    axes.add_collection(LineCollection(tracks, colors=style.COLOURS["prior"], label=label))
    axes.plot(*pixels[:, :2].T, ".", color=style.COLOURS["measured"], label=f"feature in frame {k}, left camera")
    return drawing.finish(figure, f"Frame {k}: {len(ids)} features move away from the point the car drives towards")


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
