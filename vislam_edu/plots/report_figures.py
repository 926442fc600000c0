"""The report's figures 1 to 7; `FIGURES` draws all of them from a `pipeline.Result`.

Figures 8 to 14 are the same seven for another recording, figures 15 to 20 are 5 to 7 for other noise: run the
pipeline again and draw its result. Each function takes what it draws (a Drive, Trajectories, `MapBelief`s, a
`pipeline.Mapped`, a `pipeline.Slam`) and returns a Figure whose title says what was found.
"""

import numpy as np

from . import drawing, style

MARGIN = 30.0  # m of map around the path
ELLIPSES = 60  # at most as many landmarks get an ellipse: all of them would hide each other


@style.styled
def initial_trajectory(drive, dead_reckoning):
    """Figure 1: the IMU alone."""
    driven = np.linalg.norm(np.diff(dead_reckoning.world_T_imu[:, :3, 3], axis=0), axis=-1).sum()
    title = f"Dead reckoning over {driven:.0f} m in {drive.duration:.0f} s"
    error = _final_error(drive, dead_reckoning)
    title += "" if error is None else f" ends {error:.1f} m from the truth and"
    title += f" claims an error below {_final_claim(dead_reckoning):.1f} m (95 %{_label(drive)})"
    return drawing.trajectories(drive, {"dead_reckoning": dead_reckoning}, title)


@style.styled
def initial_landmarks(drive, dead_reckoning, initial):
    """Figure 2: each landmark where its first good stereo view puts it, seen from the dead-reckoned pose."""
    found = np.count_nonzero(initial.seen)
    title = f"{found} of {drive.n_landmarks} landmarks triangulated at first sight from dead reckoning"
    return _one_map(drive, initial, "dead_reckoning", dead_reckoning, "dead_reckoning", title)


@style.styled
def mapped_landmarks(drive, dead_reckoning, mapped):
    """Figure 3: the landmark EKF on dead-reckoned poses, which it assumes to be true."""
    share = 100 * mapped.contradicting / max(1, mapped.measurements)
    title = (f"Mapping EKF on dead-reckoned poses: {share:.0f} % of {mapped.measurements} measurements "
             "contradict them (a 99 % gate would keep these out)")
    return _one_map(drive, mapped.map, "mapping", dead_reckoning, "dead_reckoning", title)


@style.styled
def initial_and_mapped_landmarks(drive, dead_reckoning, initial, mapped):
    """Figure 4: what the landmark EKF changed."""
    title = (f"The mapping EKF moves a landmark by {_median_move(initial, mapped.map):.1f} m "
             "(median); the path stays as it was")
    maps = {"dead_reckoning": initial, "mapping": mapped.map}
    return _several_maps(drive, maps, {"dead_reckoning": dead_reckoning}, title)


@style.styled
def slam_landmarks(drive, slam):
    """Figure 5: landmarks and path of the joint filter."""
    title = (f"SLAM places {np.count_nonzero(slam.map.seen)} landmarks; its gate keeps "
             f"{100 * slam.rejected_share:.1f} % of {slam.measurements} measurements out")
    return _one_map(drive, slam.map, slam.method, slam.trajectory, slam.method, title)


@style.styled
def both_trajectories(drive, dead_reckoning, slam):
    """Figure 6: the path without and with the cameras."""
    estimates = {"dead_reckoning": dead_reckoning, slam.method: slam.trajectory}
    before, after = _final_error(drive, dead_reckoning), _final_error(drive, slam.trajectory)
    if before is None:
        apart = np.subtract(*[t.world_T_imu[-1, :3, 3] for t in estimates.values()])
        title = f"SLAM ends {np.linalg.norm(apart):.1f} m from where dead reckoning does"
    else:
        title = f"SLAM ends {after:.1f} m from the truth, dead reckoning {before:.1f} m"
    title += f"; SLAM claims an error below {_final_claim(slam.trajectory):.1f} m (95 %{_label(drive)})"
    return drawing.trajectories(drive, estimates, title)


@style.styled
def all_landmarks(drive, dead_reckoning, initial, mapped, slam):
    """Figure 7: the three maps together."""
    moved = _median_move(mapped.map, slam.map)
    title = f"SLAM puts a landmark {moved:.1f} m (median) from where the mapping EKF had it"
    method = slam.method
    maps = {"dead_reckoning": initial, "mapping": mapped.map, method: slam.map}
    paths = {"dead_reckoning": dead_reckoning, method: slam.trajectory}
    return _several_maps(drive, maps, paths, title)


@style.styled
def batch(result, world_T_imu):
    """Dead reckoning, the filter and the batch estimate (T, 4, 4) on one map. result : `pipeline.Result`."""
    method = result.slam.method
    paths = {"dead_reckoning": result.dead_reckoning.world_T_imu, method: result.slam.trajectory.world_T_imu,
             "batch": world_T_imu}
    figure, axes = drawing.new_map(_view(result.drive, *paths.values()))
    drawing.draw_truth(axes, result.drive)
    for name, poses in paths.items():
        drawing.draw_trajectory(axes, poses, name)
    apart = np.linalg.norm(world_T_imu[:, :3, 3] - result.slam.trajectory.world_T_imu[:, :3, 3], axis=-1)
    return drawing.finish(figure, f"The batch estimate and the filter are {apart.mean():.2f} m apart on average")


FIGURES = {  # name of the file: the figure of a `pipeline.Result`
    "fig1_initial_trajectory": lambda r: initial_trajectory(r.drive, r.dead_reckoning),
    "fig2_initial_landmarks": lambda r: initial_landmarks(r.drive, r.dead_reckoning, r.initial),
    "fig3_mapped_landmarks": lambda r: mapped_landmarks(r.drive, r.dead_reckoning, r.mapped),
    "fig4_initial_and_mapped_landmarks":
        lambda r: initial_and_mapped_landmarks(r.drive, r.dead_reckoning, r.initial, r.mapped),
    "fig5_slam_landmarks": lambda r: slam_landmarks(r.drive, r.slam),
    "fig6_initial_and_slam_trajectory": lambda r: both_trajectories(r.drive, r.dead_reckoning, r.slam),
    "fig7_all_landmarks": lambda r: all_landmarks(r.drive, r.dead_reckoning, r.initial, r.mapped, r.slam),
}


def _one_map(drive, belief, method, trajectory, path, title):
    """A map with its path and ellipses, the truth beside it; its title ends with how wrong the map is.

    method, path : keys of `style.COLOURS` for the map and for the path.
    """
    view = _view(drive, trajectory.world_T_imu)
    figure, axes = drawing.new_map(view)
    _draw_landmarks(axes, view, belief, method)
    _draw_some_ellipses(axes, view, belief, method)
    drawing.draw_truth(axes, drive)
    drawing.draw_trajectory(axes, trajectory.world_T_imu, path, label=f"path, {style.LABELS[path]}")
    return drawing.finish(figure, title + _landmark_error(drive, belief))


def _several_maps(drive, maps, paths, title):
    """Maps over each other, later ones in smaller dots so that the earlier ones show, and the paths.

    A magnified inset has an arrow from each landmark of the last map but one to that of the last.
    """
    view = _view(drive, *(trajectory.world_T_imu for trajectory in paths.values()))
    figure, axes = drawing.new_map(view)
    for size, (method, belief) in zip((5, 3, 2.5), maps.items()):
        _draw_landmarks(axes, view, belief, method, markersize=size)
    drawing.draw_truth(axes, drive)
    for method, trajectory in paths.items():
        drawing.draw_trajectory(axes, trajectory.world_T_imu, method, label=f"path, {style.LABELS[method]}")
    before, after = list(maps)[-2:]
    drawn = [belief.landmarks[belief.seen, :2] for belief in maps.values()]
    drawn += [trajectory.world_T_imu[:, :2, 3] for trajectory in paths.values()]
    _draw_moves(axes, view, maps[before], maps[after], style.COLOURS[after], np.concatenate(drawn))
    return drawing.finish(figure, title)


def _draw_moves(axes, view, before, after, colour, covered):
    """An inset around the landmark whose move is the median one, with an arrow for each landmark's move.

    Moves so long that the inset would magnify nothing are drawn on the map, of some landmarks. covered : (n, 2), m, of
    which the inset hides as little as it can.
    """
    both = np.flatnonzero(before.seen & after.seen)
    both = both[drawing.inside(view, before.landmarks[both]) & drawing.inside(view, after.landmarks[both])]
    if not len(both):
        return
    start, move = before.landmarks[both, :2], (after.landmarks - before.landmarks)[both, :2]
    length = np.linalg.norm(move, axis=-1)
    middle = np.argsort(length)[len(length) // 2]
    half = max(6.0, 1.2 * length[middle])
    if half < (view[1] - view[0]) / 8:
        centre = start[middle] + move[middle] / 2
        axes = drawing.draw_inset(axes, centre, half, _emptiest(view, covered), "moves seen from above (m)")
        shown, width, label = np.linalg.norm(start + move / 2 - centre, ord=np.inf, axis=-1) < half, 0.012, None
    else:
        every, which = _some_of(both)
        shown, width, label = slice(None, None, every), 0.003, f"moves of {which}"
    axes.quiver(*start[shown].T, *move[shown].T, angles="xy", scale_units="xy", scale=1, width=width, color=colour,
                label=label)


def _emptiest(view, points):
    """Of nine places for an inset, (x, y, width, height) as shares of the axes, the one that covers fewest points."""
    x0, x1, y0, y1 = view
    x, y = (points - [x0, y0]).T / [[x1 - x0], [y1 - y0]]
    places = [(left, low, 0.36, 0.36) for left in (0.33, 0.1, 0.62) for low in (0.33, 0.1, 0.56)]

    def hidden(place):  # with the numbers beside it and the title above
        return np.count_nonzero((np.abs(x - place[0] - 0.18) < 0.2) & (np.abs(y - place[1] - 0.2) < 0.24))

    return min(places, key=hidden)


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
    (every, which), longest = _some_of(shown), (view[1] - view[0]) / 10
    shown = shown[::every]
    outlines = style.ellipse_points(np.zeros(2), belief.covariance[shown, :2, :2])
    shown = shown[2 * np.linalg.norm(outlines, axis=-1).max(axis=-1) <= longest]
    label = f"95 % of {which}, if under {longest:.0f} m long"
    drawing.draw_ellipses(axes, belief.landmarks[shown], belief.covariance[shown], style.COLOURS[method], label)


def _some_of(landmarks):
    """The step from one landmark to the next that is drawn with more than a dot, and which those are, in words."""
    every = max(1, -(-len(landmarks) // ELLIPSES))
    return every, f"one landmark in {every}" if every > 1 else "each landmark"


def _view(drive, *paths):
    """The map around these paths (T, 4, 4) and the true one."""
    truth = [drive.true_world_T_imu] if drive.has_truth else []
    return drawing.view_around(*[T[:, :3, 3] for T in (*paths, *truth)], margin=MARGIN)


def _final_error(drive, trajectory):
    """Distance, m, from the truth at the last frame that has one; None without truth."""
    if not drive.has_truth:
        return None
    error = np.linalg.norm(trajectory.world_T_imu[:, :3, 3] - drive.true_world_T_imu[:, :3, 3], axis=-1)
    return error[np.isfinite(error)][-1]


def _label(drive):
    """What a covariance of a real drive leaves out; a simulated one, whose landmarks are known, has nothing of it."""
    return ", without calibration error" if drive.truth_landmarks is None else ""


def _final_claim(trajectory):
    """Longest semi-axis, m, of the 95 % ellipse on the ground at the last frame."""
    ground = drawing.position_covariance(trajectory)[-1, :2, :2]
    outline = style.ellipse_points(np.zeros(2), ground, n=181)
    return np.linalg.norm(outline, axis=-1).max()


def _landmark_error(drive, belief):
    """End of a title: how far the landmarks are from the truth; nothing where it is not known."""
    if not drive.has_true_landmarks:
        return ""
    error = np.linalg.norm(drive.true_landmarks - belief.landmarks, axis=-1)[belief.seen]
    error = error[np.isfinite(error)]
    return f"; {np.median(error):.2f} m from the truth (median)" if error.size else ""


def _median_move(before, after):
    both = before.seen & after.seen
    if not both.any():
        return 0.0
    return np.median(np.linalg.norm(after.landmarks[both] - before.landmarks[both], axis=-1))
