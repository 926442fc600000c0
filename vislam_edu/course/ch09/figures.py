"""Figures of chapter 09: how many landmarks a filter carries, and what the backward pass changes; each a Figure."""

import numpy as np

from ...plots import drawing, style


@style.styled
def landmarks_carried(times, window, dense):
    """Landmarks in the state of the window's filter and of the filter that drops nothing. times : (T,), s."""
    figure, axes = drawing.new_figure(2.6)
    axes.plot(times - times[0], dense, color=style.COLOURS["report"], linestyle="--", label="dense filter: all so far")
    axes.plot(times - times[0], window, color=style.COLOURS["slam"], label="window")
    axes.set(xlabel="time since start (s)", xlim=(0, times[-1] - times[0]), ylabel="landmarks in the state",
             ylim=(0, None))
    return drawing.finish(figure, f"At the end the window holds {window[-1]} landmarks, the dense filter {dense[-1]}")


@style.styled
def before_and_after(truth, before, after):
    """The six landmarks whose ellipse shrinks most: each estimate with its 95 % ellipse around the true landmark.

    truth : (M, 3), m. before, after : MapBelief, of the same landmarks.
    """
    sizes = [np.sqrt(np.trace(estimate.covariance, axis1=1, axis2=2)) for estimate in (before, after)]
    ratio = sizes[1] / sizes[0]
    figure = style.Figure(figsize=(drawing.WIDTH, 5.2), layout="constrained")
    estimates = (("measured", before, "o", "before"), ("smoother", after, "D", "after the backward pass"))
    for axes, j in zip(figure.subplots(2, 3).ravel(), np.argsort(ratio)[:6]):
        axes.plot(0, 0, "+", color=style.COLOURS["truth"], ms=11, mew=1.8, zorder=4, label="true landmark")
        for name, estimate, marker, label in estimates:
            off, colour = (estimate.landmarks[j] - truth[j])[:2], style.COLOURS[name]
            axes.plot(*off, marker, color=colour)
            outline = style.ellipse_points(off, estimate.covariance[j, :2, :2])
            axes.plot(*outline.T, color=colour, label=f"95 %, {label}")
        axes.set(title=f"landmark {j}: -{1 - ratio[j]:.0%}", aspect="equal", adjustable="datalim", xlabel="x (m)",
                 ylabel="y (m)")
        axes.margins(0.15)
    figure.suptitle(f"Standard deviations shrink by {1 - np.median(ratio):.0%} (median), these six by more",
                    x=0.01, ha="left", fontsize=11)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
