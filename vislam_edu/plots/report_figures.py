"""The report's figures 1 to 7, drawn from a `pipeline.Result`.

Figures 8 to 14 are the same seven for another recording, figures 15 to 20 are 5 to 7 for other noise: run the
pipeline again and draw its result. Each function returns a Figure whose title says what was found.
"""

import numpy as np

from . import drawing, style

MARGIN = 30.0  # m of map around the path
ELLIPSES = 60  # at most as many landmarks get an ellipse: all of them would hide each other


@style.styled
def initial_trajectory(result):
    """Figure 1: the IMU alone."""
    estimate = result.dead_reckoning
    driven = np.linalg.norm(np.diff(estimate.world_T_imu[:, :3, 3], axis=0), axis=-1).sum()
    title = f"Dead reckoning over {driven:.0f} m in {result.drive.duration:.0f} s"
    error = _final_error(result, estimate)
    title += "" if error is None else f" ends {error:.1f} m from the truth and"
    title += f" claims an error below {_final_claim(estimate):.1f} m (95 %)"
    return drawing.trajectories(result.drive, {"dead_reckoning": estimate}, title)


@style.styled
def initial_landmarks(result):
    """Figure 2: each landmark where its first good stereo view puts it, seen from the dead-reckoned pose."""
    found = np.count_nonzero(result.initial.seen)
    title = f"{found} of {result.drive.n_landmarks} landmarks triangulated at first sight from dead reckoning"
    return _one_map(result, result.initial, "dead_reckoning", "dead_reckoning", title)


@style.styled
def mapped_landmarks(result):
    """Figure 3: the landmark EKF on dead-reckoned poses, which it takes for the truth."""
    mapped = result.mapped
    share = 100 * mapped.contradicting / max(1, mapped.measurements)
    title = (f"Mapping EKF on dead-reckoned poses: {share:.0f} % of {mapped.measurements} measurements "
             "contradict them (a 99 % gate would keep these out)")
    return _one_map(result, mapped.map, "mapping", "dead_reckoning", title)


@style.styled
def initial_and_mapped_landmarks(result):
    """Figure 4: what the landmark EKF changed."""
    title = (f"The mapping EKF moves a landmark by {_median_move(result.initial, result.mapped.map):.1f} m "
             "(median); the path stays as it was")
    maps = {"dead_reckoning": result.initial, "mapping": result.mapped.map}
    return _several_maps(result, maps, {"dead_reckoning": result.dead_reckoning}, title)


@style.styled
def slam_landmarks(result):
    """Figure 5: landmarks and path of the joint filter."""
    title = (f"SLAM places {np.count_nonzero(result.slam.map.seen)} landmarks; its gate keeps "
             f"{100 * result.slam.rejected_share:.1f} % of {result.slam.measurements} measurements out")
    return _one_map(result, result.slam.map, result.slam.method, result.slam.method, title)


@style.styled
def both_trajectories(result):
    """Figure 6: the path before and after the cameras are heard."""
    estimates = {"dead_reckoning": result.dead_reckoning, result.slam.method: result.slam.trajectory}
    before, after = _final_error(result, result.dead_reckoning), _final_error(result, result.slam.trajectory)
    if before is None:
        apart = np.subtract(*[t.world_T_imu[-1, :3, 3] for t in estimates.values()])
        title = f"SLAM ends {np.linalg.norm(apart):.1f} m from where dead reckoning does"
    else:
        title = f"SLAM ends {after:.1f} m from the truth, dead reckoning {before:.1f} m"
    title += f"; SLAM claims an error below {_final_claim(result.slam.trajectory):.1f} m (95 %)"
    return drawing.trajectories(result.drive, estimates, title)


@style.styled
def all_landmarks(result):
    """Figure 7: the three maps together."""
    moved = _median_move(result.mapped.map, result.slam.map)
    title = f"SLAM puts a landmark {moved:.1f} m (median) from where the mapping EKF had it"
    method = result.slam.method
    maps = {"dead_reckoning": result.initial, "mapping": result.mapped.map, method: result.slam.map}
    paths = {"dead_reckoning": result.dead_reckoning, method: result.slam.trajectory}
    return _several_maps(result, maps, paths, title)


FIGURES = {
    "fig1_initial_trajectory": initial_trajectory,
    "fig2_initial_landmarks": initial_landmarks,
    "fig3_mapped_landmarks": mapped_landmarks,
    "fig4_initial_and_mapped_landmarks": initial_and_mapped_landmarks,
    "fig5_slam_landmarks": slam_landmarks,
    "fig6_initial_and_slam_trajectory": both_trajectories,
    "fig7_all_landmarks": all_landmarks,
}


def _one_map(result, belief, method, path, title):
    """A map with its path and ellipses, the truth beside it; its title ends with how wrong the map is."""
    trajectory = result.dead_reckoning if path == "dead_reckoning" else result.slam.trajectory
    view = _view(result, trajectory)
    figure, axes = drawing.new_map(view)
    _draw_landmarks(axes, view, belief, method)
    _draw_some_ellipses(axes, view, belief, method)
    drawing.draw_truth(axes, result.drive)
    drawing.draw_trajectory(axes, trajectory.world_T_imu, path, label=f"path, {style.LABELS[path]}")
    return drawing.finish(figure, title + _landmark_error(result, belief))


def _several_maps(result, maps, paths, title):
    """Maps over each other, later ones in smaller dots so that the earlier ones show, and the paths."""
    view = _view(result, *paths.values())
    figure, axes = drawing.new_map(view)
    for size, (method, belief) in zip((5, 3, 2.5), maps.items()):
        _draw_landmarks(axes, view, belief, method, markersize=size)
    drawing.draw_truth(axes, result.drive)
    for method, trajectory in paths.items():
        drawing.draw_trajectory(axes, trajectory.world_T_imu, method, label=f"path, {style.LABELS[method]}")
    return drawing.finish(figure, title)


def _draw_landmarks(axes, view, belief, method, **looks):
    """All landmarks of a map; how many fall outside the view is said in the legend."""
    points = belief.landmarks[belief.seen]
    outside = np.count_nonzero(~drawing.inside(view, points))
    label = f"landmarks, {style.LABELS[method]} ({outside} outside)"
    drawing.draw_landmarks(axes, points, method, label=label, **looks)


def _draw_some_ellipses(axes, view, belief, method):
    """Every n-th landmark in the view gets its ellipse, unless that is longer than a tenth of the map.

    Such a one says that the landmark is far away, and on the map it is a line across everything else.
    """
    shown = np.flatnonzero(belief.seen)
    shown = shown[drawing.inside(view, belief.landmarks[shown])]
    every, longest = max(1, -(-len(shown) // ELLIPSES)), (view[1] - view[0]) / 10
    shown = shown[::every]
    outlines = style.ellipse_points(np.zeros(2), belief.covariance[shown, :2, :2])
    shown = shown[2 * np.linalg.norm(outlines, axis=-1).max(axis=-1) <= longest]
    which = f"one landmark in {every}" if every > 1 else "each landmark"
    label = f"95 % of {which}, if under {longest:.0f} m long"
    drawing.draw_ellipses(axes, belief.landmarks[shown], belief.covariance[shown], style.COLOURS[method], label)


def _view(result, *trajectories):
    """The map around these paths and the true one."""
    poses = [t.world_T_imu for t in trajectories]
    if result.drive.true_world_T_imu is not None:
        poses.append(result.drive.true_world_T_imu)
    return drawing.view_around(*[T[:, :3, 3] for T in poses], margin=MARGIN)


def _final_error(result, trajectory):
    """Distance, m, from the truth at the last frame that has one; None without truth."""
    truth = result.drive.true_world_T_imu
    if truth is None:
        return None
    error = np.linalg.norm(trajectory.world_T_imu[:, :3, 3] - truth[:, :3, 3], axis=-1)
    return error[np.isfinite(error)][-1]


def _final_claim(trajectory):
    """Longest semi-axis, m, of the 95 % ellipse on the ground at the last frame."""
    ground = drawing.position_covariance(trajectory)[-1, :2, :2]
    outline = style.ellipse_points(np.zeros(2), ground, n=181)
    return np.linalg.norm(outline, axis=-1).max()


def _landmark_error(result, belief):
    """End of a title: how far the landmarks are from the truth; nothing where it is not known."""
    truth = result.drive.true_landmarks
    if truth is None:
        return ""
    error = np.linalg.norm(truth - belief.landmarks, axis=-1)[belief.seen]
    return f"; {np.nanmedian(error):.2f} m from the truth (median)"


def _median_move(before, after):
    both = before.seen & after.seen
    if not both.any():
        return 0.0
    return np.median(np.linalg.norm(after.landmarks[both] - before.landmarks[both], axis=-1))
