"""The explorer as a still picture, drawn by matplotlib from the same packed data: for where no script runs."""

import io
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from ..plots import style
from ..plots.style import COLOURS, ellipse_points
from .packing import ONE, get

AXES = (("longest axis", COLOURS["predicted"], "-"), ("middle axis", COLOURS["mapping"], "--"),
        ("shortest axis", COLOURS["slam"], ":"))
SIZE = (10.0, 6.0)  # inches at 100 dots per inch
NUMBERED = 24  # landmarks at most that all get their numbers, as in explorer.js; of more only the chosen one


class Run:
    """One run of an explorer, unpacked: its arrays by name, with the rows of one snapshot at hand."""

    def __init__(self, run: dict[str, Any], data: bytes):
        self.name, self.role, self.rows, self.captions = run["name"], run["role"], run["rows"], run["captions"]
        self.born, self.retired, self._run, self._data = run["born"], run["retired"], run, data
        self.time, self.first, self.ids = self["time"], self["first"], self["ids"]
        self.landmark, self.block, self.axes = (self[key].reshape(-1, 3) for key in ("landmark", "block", "axes"))
        self.pose = self["pose"].reshape(-1, 4)
        self.series = [{**s, **{key: get(data, s[key]) for key in ("values", "low", "high")}} for s in run["series"]]

    def __contains__(self, key):
        return key in self._run

    def __getitem__(self, key):
        return get(self._data, self._run[key])

    def of(self, i: int) -> slice:
        """Rows of the landmarks of snapshot i."""
        return slice(self.first[i], self.first[i + 1])

    def ellipses(self, i: int) -> np.ndarray:
        """(n, 2, 2) m^2, covariance of the landmarks of snapshot i on the ground."""
        return self.block[self.of(i)][:, [0, 1, 1, 2]].reshape(-1, 2, 2)

    def covariance(self, i: int) -> np.ndarray:
        """(d, d), the joint covariance of snapshot i."""
        sizes = 3 * np.diff(self.first) + len(self.rows[1])
        d, a, b = sizes[i], sizes[:i].sum(), (sizes[:i] * (sizes[:i] + 1) // 2).sum()
        sigma = self["sigma"][a:a + d].astype(float)
        R = np.zeros((d, d))
        R[np.triu_indices(d)] = self["correlation"][b:b + d * (d + 1) // 2] / ONE
        return (R + np.triu(R, 1).T) * np.outer(sigma, sigma)

    def sigmas(self, landmark: int) -> np.ndarray:
        """(snapshots, 3) m: sigma of a landmark along its principal axes, NaN where it is not in the state."""
        found = np.full((len(self.time), 3), np.nan)
        for i in range(len(self.time)):
            at = np.flatnonzero(self.ids[self.of(i)] == landmark)
            found[i] = self.axes[self.of(i)][at[0]] if len(at) else np.nan
        return found


def draw(header: dict[str, Any], data: bytes, i: int, landmark: int, show: int) -> tuple[bytes, str]:
    """PNG of snapshot i and its alternative text. landmark : id of the chosen one. show : which run, 2 for both."""
    every = [Run(run, data) for run in header["runs"]]
    runs = every if show >= len(every) else [every[show]]
    with style.context():
        figure = Figure(figsize=SIZE, dpi=100, layout="constrained")
        top, bottom = np.asarray(figure.subfigures(2, 1, height_ratios=(1.5, 1)))
        matrix = [run for run in runs if "sigma" in run]
        maps = top.subplots(1, len(runs) + len(matrix), squeeze=False)[0][:len(runs)]
        for axes, run in zip(maps, runs):
            draw_map(axes, header, data, run, i, landmark, len(runs) > 1)
        for axes, run in zip(top.axes[len(runs):], matrix):
            draw_matrix(axes, run, i, landmark)
        panels = [draw_landmark] * any(run.first[-1] > 0 for run in runs) + [draw_series] * bool(runs[0].series)
        for axes, panel in zip(bottom.subplots(1, max(len(panels), 1), squeeze=False)[0], panels):
            panel(axes, header, runs, i, landmark)
        figure.draw_without_rendering()  # only now is it known where the numbers of the landmarks stand
        for axes in maps:
            leave_out_covering(axes.texts, str(landmark))
        file = io.BytesIO()
        figure.savefig(file, format="png", **style.PNG)
    words = " ".join(f"{run.name}: {run.captions[i]}." for run in runs)
    shown = "; ".join(axes.get_title("left") for axes in figure.axes if axes.get_title("left"))
    return file.getvalue(), f"Explorer at {header['labels'][i]}. {words} Shown: {shown}."


def draw_map(axes, header, data, run, i, landmark, several):
    """From above: truth, path, landmarks with their 95 % ellipses, the car."""
    if "landmark" in header["truth"]:
        axes.plot(*get(data, header["truth"]["landmark"]).reshape(-1, 2).T, "+", color=COLOURS["faded"])
    if "path" in header["truth"]:
        axes.plot(*get(data, header["truth"]["path"]).reshape(-1, 2).T, lw=1, color=COLOURS["faded"])
    path = run.pose[[j for j in range(i + 1) if header["updated"][j] or j == i]]
    if "path" in run:
        path = run["path"].reshape(-1, 2)[slice(*run["path_first"][i:i + 2])]
    axes.plot(*path[:, :2].T, color=COLOURS["posterior"])
    ids, places = run.ids[run.of(i)], run.landmark[run.of(i)]
    for j, place, outline in zip(ids, places, ellipse_points(places[:, :2], run.ellipses(i))):
        colour = COLOURS["measured"] if j == landmark else COLOURS["posterior" if header["updated"][i] else "prior"]
        axes.plot(*outline.T, color=colour, lw=1.2)
        if len(ids) <= NUMBERED or j == landmark:
            axes.annotate(str(j), place[:2], xytext=(3, 3), textcoords="offset points", fontsize=8, color=colour)
    if np.isfinite(run.pose[i, 0]):
        axes.plot(*run.pose[i, :2], marker=(3, 0, np.degrees(run.pose[i, 3]) - 90), ms=10, mfc="white", mec="black")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(run.name if several else "Map from above (m), 95 % ellipses")


def leave_out_covering(numbers, chosen):
    """Hide each number (a Text) that would cover another one; the chosen one stays."""
    taken: list[Bbox] = []
    for number in sorted(numbers, key=lambda number: number.get_text() != chosen):
        box = number.get_window_extent()
        number.set_visible(not any(box.overlaps(other) for other in taken))
        taken += [box] * number.get_visible()


def draw_matrix(axes, run, i, landmark):
    """The correlation of the joint state, blocks with landmark numbers and the pose's rows named."""
    P = run.covariance(i)
    sigma = np.sqrt(np.diag(P))
    ids, d = run.ids[run.of(i)], len(P)
    with np.errstate(invalid="ignore"):
        axes.imshow(P / np.outer(sigma, sigma), cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
    axes.grid(False)
    axes.axhline(3 * len(ids) - 0.5, color="black", lw=0.8)
    axes.axvline(3 * len(ids) - 0.5, color="black", lw=0.8)
    every = max(1, -(-len(ids) // 14))
    names = [str(j) for j in ids[::every]]
    pose = ["pose"] if len(ids) else list(run.rows[1])
    rows = [3 * len(ids) + len(run.rows[1]) / 2 - 0.5] if len(ids) else list(range(d))
    axes.set_yticks([*(3 * every * np.arange(len(names)) + 1), *rows], [*names, *pose], fontsize=8)
    axes.set_xticks([])
    axes.set_title("Correlation of the state")


def draw_landmark(axes, header, runs, i, landmark):
    """Sigma of the chosen landmark along its principal axes through time, of the first run."""
    sigmas = runs[0].sigmas(landmark)
    for values, (name, colour, line) in zip(sigmas.T, AXES):
        axes.plot(runs[0].time, values, line, color=colour, label=name)
    axes.axvline(runs[0].time[i], color=COLOURS["measured"], lw=1)
    axes.set_yscale("log")
    axes.set_title(f"Landmark {landmark}: σ along its axes (m)")
    axes.set_xlabel(header["axis"])
    axes.legend()


def draw_series(axes, header, runs, i, landmark):
    """The first quantity of the runs through time, after the updates, with its band."""
    after = np.array(header["updated"], bool)
    at = [one["name"] for one in runs[0].series].index(header["quantity"])
    first = runs[0].series[at]
    for run in runs:
        one, colour = run.series[at], COLOURS[run.role if len(runs) > 1 else "posterior"]
        axes.plot(run.time[after], one["values"][after], color=colour, label=run.name)
        for edge in (one["low"], one["high"]):
            axes.plot(run.time[after], edge[after], "--", lw=1, color=colour)
    axes.axvline(runs[0].time[i], color=COLOURS["measured"], lw=1)
    if first["log"]:
        axes.set_yscale("log")
    unit = f" ({first['unit']})" if first["unit"] else ""
    band = ", dashed: ± 3σ" if "error" in first["name"] else ""
    axes.set_title(f"{first['name'][0].upper()}{first['name'][1:]}{unit}{band}")
    axes.set_xlabel(header["axis"])
    if len(runs) > 1:
        axes.legend()
