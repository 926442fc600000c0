"""Figures of chapter 07 that are more than one line of matplotlib; each returns a Figure."""

import numpy as np

from ...plots import drawing, style, two_digits


@style.styled
def ranks(ranks, n):
    """Rank of the rows that the first frames have given, frame by frame. ranks : {name: (F,)}. n : landmarks."""
    figure, axes = drawing.new_figure(2.4)
    looks = (("faded", "-", 7), ("slam", "--", 1.6), ("invariant", "-", 1.6))
    for (name, rank), (colour, line, width) in zip(ranks.items(), looks):
        frames = np.arange(1, len(rank) + 1)
        axes.plot(frames, rank, color=style.COLOURS[colour], linestyle=line, linewidth=width, label=name)
    for level, words in ((3 * n, "3n: six directions remain unseen"), (3 * n + 6, "3n + 6: everything is seen")):
        axes.axhline(level, color=style.COLOURS["expected"], linewidth=0.8)
        axes.annotate(words, (frames[-1], level), xytext=(0, 5), textcoords="offset points", ha="right", fontsize=9)
    axes.set(xlabel="frames stacked", xticks=frames, ylabel="rank of the rows", ylim=(3 * n - 1, 3 * n + 7.5))
    full = {name: 1 + int(np.argmax(rank == 3 * n + 6)) for name, rank in ranks.items() if max(rank) == 3 * n + 6}
    found = "; ".join(f"{name}: full rank after {frame} frames" for name, frame in full.items())
    return drawing.finish(figure, found or "The rank stays at 3n")


@style.styled
def regimes(study, names):
    """Mean NEES of the pose in each regime. study : of `summary.json`'s regimes. names : {filter: words}."""
    figure, axes = drawing.new_figure(4.0)
    for name, marker, colour in zip(names, "os^", ("batch", "invariant", "slam")):
        nees = [figures["filters"][name]["nees_pose"] for figures in study.values()]
        axes.plot(nees, range(len(study)), marker, ms=5, color=style.COLOURS[colour], label=names[name])
    axes.axvline(6, color=style.COLOURS["expected"], linewidth=0.8)
    axes.set(xscale="log", xlabel="mean NEES of the pose; line: 6, which is right", ylim=(len(study) - 0.5, -0.5))
    axes.set_yticks(range(len(study)), [name.replace("_", " ") for name in study], fontsize=9)
    box = axes.get_position()
    axes.set_position((0.17, box.y0, box.x1 - 0.17, box.height))  # room for the names
    worst = {words: max(figures["filters"][name]["nees_pose"] for figures in study.values())
             for name, words in names.items()}
    return drawing.finish(figure, "Largest mean NEES: " + "; ".join(f"{words} {two_digits(most)}"
                                                                    for words, most in worst.items()))
