"""Pictures of chapters 08 and 08b."""

import numpy as np

from ...error_state import RightPerturbation
from ...plots import drawing
from ...plots.style import COLOURS, Figure, styled

NAMES = {"gate": "gate, 90 to 99.9 %",
         "sigma_px": "pixel noise, 0.5 to 2 px",
         "sigma_v": "speed noise, 0.25 to 1 m/s",
         "sigma_omega": "gyro noise, 0.025 to 0.1 rad/s",
         "min_disparity": "least disparity, 0.5 to 4 px",
         "walk_v": "walk of the speed, 0.05 to 0.2 m/s",
         "walk_omega": "walk of the turn, 0.015 to 0.06 rad/s"}
LOOKS = ("rejected", "|"), ("measured", "x"), ("accepted", "o")


def sensitivity(arms: dict, title: str) -> Figure:
    """One bar per setting and arm: the drift while that setting is turned through its range and all others stay.

    arms : {name: {setting: [{"value", "drift_percent"}, ...]}}, at most three; of `benchmarks/real_drives.py`.
    """
    figure, axes = drawing.new_figure(height=3.6)
    for (arm, settings), (colour, marker), shift in zip(arms.items(), LOOKS, (0.25, 0, -0.25)):
        for name, rows in settings.items():
            values = [row["drift_percent"] for row in rows]
            y = list(NAMES)[::-1].index(name) + shift
            axes.plot([min(values), max(values)], [y, y], lw=5, alpha=0.4, color=COLOURS[colour], solid_capstyle="butt")
            axes.plot(values, [y] * len(values), marker, ms=5, mew=1.6, color=COLOURS[colour],
                      label=arm if name == "gate" else None)
    axes.set(yticks=range(len(NAMES)), xlabel="KITTI drift (%)", xlim=(0, None))
    axes.set_yticklabels(list(NAMES.values())[::-1])
    axes.set_position((0.33, 0, 0.65, 1))
    return drawing.finish(figure, title)


@styled
def error_and_claims(times: np.ndarray, true: np.ndarray, trajectory, added: np.ndarray) -> Figure:
    """The error of the position along the body's axes through time, and three standard deviations of two claims.

    times (T,) : s. true (T, 4, 4). trajectory : of a filter with the right perturbation. added (T, 6, 6) : what the
    calibration adds to its covariance.
    """
    error = RightPerturbation().pose_difference(true, trajectory.world_T_imu)
    figure = Figure(figsize=(drawing.WIDTH, 2.9), layout="constrained")
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 3), ("forward", "left", "up"))):
        axes.plot(times - times[0], error[:, k], color=COLOURS["truth"], label="error")
        for P, colour, style, label in ((trajectory.covariance, "rejected", "--", "noise alone"),
                                        (trajectory.covariance + added, "posterior", "-.", "and calibration")):
            for side, shown in ((3, f"± 3 σ, {label}"), (-3, None)):
                axes.plot(times - times[0], side * np.sqrt(P[:, k, k]), ls=style, color=COLOURS[colour], label=shown)
        axes.set(title=f"{name} (m)", xlabel="time since start (s)", xlim=(0, times[-1] - times[0]))
    figure.suptitle("A bent lens: noise alone claims too small an error")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
