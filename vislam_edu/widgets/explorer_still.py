"""The explorer as a still picture, drawn by matplotlib from the same histories: for where no script runs."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from ..drive import Drive
from ..plots import heading, style
from ..plots.style import COLOURS, ellipse_points
from .history import History, all_ids, principal_sigmas

AXES = (("longest axis", COLOURS["predicted"], "-"), ("middle axis", COLOURS["mapping"], "--"),
        ("shortest axis", COLOURS["slam"], ":"))
SIZE = (10.0, 6.0)  # inches at 100 dots per inch
NUMBERED = 24  # landmarks at most that all get their numbers, as in explorer.js; of more only the chosen one


def draw(histories: Sequence[History], drive: Drive, i: int, landmark: int, show: int, quantity: str
         ) -> tuple[bytes, str]:
    """PNG of snapshot i and its alternative text. landmark : id of the chosen one. show : which run, 2 for both."""
    runs = histories if show >= len(histories) else [histories[show]]
    with style.context():
        figure = Figure(figsize=SIZE, dpi=100, layout="constrained")
        top, bottom = np.asarray(figure.subfigures(2, 1, height_ratios=(1.5, 1)))
        matrices = [run for run in runs if run.covariances]
        maps = top.subplots(1, len(runs) + len(matrices), squeeze=False)[0][:len(runs)]
        for axes, run in zip(maps, runs):
            draw_map(axes, drive, all_ids(histories), run, i, landmark)
            axes.set_title(run.name if len(runs) > 1 else "Map from above (m), 95 % ellipses")
        for axes, run in zip(top.axes[len(runs):], matrices):
            draw_matrix(axes, run.covariances[i], run.snapshots[i].ids, run.rows[1])
        panels = [draw_landmark] * any(len(s.ids) for run in runs for s in run.snapshots)
        panels += [draw_series] * bool(runs[0].series)
        for axes, panel in zip(bottom.subplots(1, max(len(panels), 1), squeeze=False)[0], panels):
            panel(axes, runs, i, landmark, quantity)
        figure.draw_without_rendering()  # only now is it known where the numbers of the landmarks stand
        for axes in maps:
            leave_out_covering(axes.texts, str(landmark))
        file = io.BytesIO()
        figure.savefig(file, format="png", **style.PNG)
    words = " ".join(f"{run.name}: {run.snapshots[i].caption}." for run in runs)
    shown = "; ".join(axes.get_title("left") for axes in figure.axes if axes.get_title("left"))
    return file.getvalue(), f"Explorer at {histories[0].snapshots[i].label}. {words} Shown: {shown}."


def draw_map(axes, drive, ids, run, i, landmark):
    """From above: truth (of the landmarks ids), path, landmarks with their 95 % ellipses, the car."""
    if drive.has_true_landmarks:
        axes.plot(*drive.true_landmarks[ids, :2].T, "+", color=COLOURS["faded"])
    if drive.has_truth:
        axes.plot(*drive.true_world_T_imu[:, :2, 3].T, lw=1, color=COLOURS["faded"])
    now, driven = run.snapshots[i], [s for s in run.snapshots[:i] if s.updated]
    path = now.path if now.path is not None else [s.world_T_imu for s in (*driven, now) if s.world_T_imu is not None]
    axes.plot(*np.reshape(path, (-1, 4, 4))[:, :2, 3].T, color=COLOURS["posterior"])
    outlines = ellipse_points(now.landmarks[:, :2], now.landmark_covariance[:, :2, :2])
    for j, place, outline in zip(now.ids, now.landmarks, outlines):
        colour = COLOURS["measured"] if j == landmark else COLOURS["posterior" if now.updated else "prior"]
        axes.plot(*outline.T, color=colour, lw=1.2)
        if len(now.ids) <= NUMBERED or j == landmark:
            axes.annotate(str(j), place[:2], xytext=(3, 3), textcoords="offset points", fontsize=8, color=colour)
    if now.world_T_imu is not None:
        turned = np.degrees(heading(now.world_T_imu)) - 90
        axes.plot(*now.world_T_imu[:2, 3], marker=(3, 0, turned), ms=10, mfc="white", mec="black")
    axes.set_aspect("equal", adjustable="datalim")


def leave_out_covering(numbers, chosen):
    """Hide each number (a Text) that would cover another one; the chosen one stays."""
    taken: list[Bbox] = []
    for number in sorted(numbers, key=lambda number: number.get_text() != chosen):
        box = number.get_window_extent()
        number.set_visible(not any(box.overlaps(other) for other in taken))
        taken += [box] * number.get_visible()


def draw_matrix(axes, P, ids, pose_rows):
    """The correlation of the joint state, blocks with landmark numbers and the pose's rows named."""
    sigma = np.sqrt(np.diag(P))
    with np.errstate(invalid="ignore"):
        axes.imshow(P / np.outer(sigma, sigma), cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
    axes.grid(False)
    axes.axhline(3 * len(ids) - 0.5, color="black", lw=0.8)
    axes.axvline(3 * len(ids) - 0.5, color="black", lw=0.8)
    every = max(1, -(-len(ids) // 14))
    names = [str(j) for j in ids[::every]]
    pose = ["pose"] if len(ids) else list(pose_rows)
    rows = [3 * len(ids) + len(pose_rows) / 2 - 0.5] if len(ids) else list(range(len(P)))
    axes.set_yticks([*(3 * every * np.arange(len(names)) + 1), *rows], [*names, *pose], fontsize=8)
    axes.set_xticks([])
    axes.set_title("Correlation of the state")


def draw_landmark(axes, runs, i, landmark, quantity):
    """Sigma of the chosen landmark along its principal axes through time, of the first run."""
    time = [s.time for s in runs[0].snapshots]
    spread = [s.landmark_covariance[s.ids == landmark] for s in runs[0].snapshots]
    sigmas = np.array([principal_sigmas(P)[0] if len(P) else np.full(3, np.nan) for P in spread])
    for values, (name, colour, line) in zip(sigmas.T, AXES):
        axes.plot(time, values, line, color=colour, label=name)
    axes.axvline(time[i], color=COLOURS["measured"], lw=1)
    axes.set_yscale("log")
    axes.set_title(f"Landmark {landmark}: σ along its axes (m)")
    axes.set_xlabel(runs[0].axis)
    axes.legend()


def draw_series(axes, runs, i, landmark, quantity):
    """The chosen quantity of the runs through time, after the updates (a stair: before them too), with its band."""
    first = runs[0][quantity]
    after = [s.updated or first.stair for s in runs[0].snapshots]
    time = np.array([s.time for s in runs[0].snapshots])
    for run in runs:
        one, colour = run[quantity], COLOURS[run.colour if len(runs) > 1 else "posterior"]
        axes.plot(time[after], one.values[after], color=colour, label=run.name)
        for edge in (one.low, one.high):
            axes.plot(time[after], edge[after], "--", lw=1, color=colour)
    axes.axvline(time[i], color=COLOURS["measured"], lw=1)
    if first.log:
        axes.set_yscale("log")
    unit = f" ({first.unit})" if first.unit else ""
    band = ", dashed: ± 3σ" if "error" in first.name else ": up predicted, down updated" if first.stair else ""
    axes.set_title(f"{first.name[0].upper()}{first.name[1:]}{unit}{band}")
    axes.set_xlabel(runs[0].axis)
    if len(runs) > 1:
        axes.legend()
