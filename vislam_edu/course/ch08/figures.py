"""Pictures of chapter 08."""

from ...plots import drawing
from ...plots.style import COLOURS, Figure

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
