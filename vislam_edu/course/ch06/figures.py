"""Figures of chapters 06 and 07: NEES against its bands, and the rank of what a filter sees; each returns a Figure."""

import numpy as np
from scipy.stats import chi2

from ... import metrics
from ...plots import drawing, style

LOOKS = (("report", ":"), ("slam", "--"), ("measured", "-."), ("invariant", "-"))


@style.styled
def mean_nees_densities(dof, numbers_of_runs):
    """Density of the mean NEES of an honest filter over so many runs, its 95 % shaded. dof : of one NEES."""
    figure, axes = drawing.new_figure(2.6)
    x = np.linspace(0.01, 3 * dof, 600)
    for runs, colour in zip(numbers_of_runs, ("faded", "report", "invariant")):
        low, high = metrics.chi2_band(dof, runs, probability=0.95)
        density = runs * chi2.pdf(runs * x, dof * runs)
        axes.plot(x, density, color=style.COLOURS[colour], label="one run" if runs == 1 else f"mean of {runs} runs")
        inside = (low < x) & (x < high)
        axes.fill_between(x[inside], density[inside], color=style.COLOURS[colour], alpha=0.25, linewidth=0)
    axes.set(xlabel="mean NEES of an honest filter", ylabel="probability density", xlim=(0, x[-1]), ylim=(0, None))
    return drawing.finish(figure, f"The mean over {runs} runs lies between {low:.1f} and {high:.1f} in 95 % of all "
                                  "cases (shaded)")


@style.styled
def nees_of_runs(times, nees):
    """NEES of the best and the worst run of one filter, and the mean over the runs, each with its 95 % band.

    times : (T,), s. nees : (n, T), of a pose.
    """
    one, many = (metrics.chi2_band(6, runs, 0.95) for runs in (1, len(nees)))
    shares = 100 * np.mean((one[0] < nees) & (nees < one[1]), axis=1)
    mean, worst = nees.mean(axis=0), np.argmin(shares)
    figure, axes = drawing.new_figure(2.8)
    for run, line in ((worst, "--"), (np.argmax(shares), ":")):
        axes.plot(times - times[0], nees[run], color=style.COLOURS["dead_reckoning"], linestyle=line,
                  label=f"run {run} alone")
    axes.axhspan(*one, color=style.COLOURS["faded"], alpha=0.35, linewidth=0, label="95 % band of one run")
    axes.plot(times - times[0], mean, color=style.COLOURS["invariant"], label=f"mean of {len(nees)} runs")
    axes.axhspan(*many, color=style.COLOURS["accepted"], alpha=0.3, linewidth=0, label="95 % band of the mean")
    axes.set(xlabel="time since start (s)", xlim=(0, times[-1] - times[0]), ylabel="NEES of the pose, honest: 6",
             ylim=(0, 20))
    in_band = 100 * np.mean((many[0] < mean) & (mean < many[1]))
    return drawing.finish(figure, f"The mean over the runs is inside its band in {in_band:.0f} % of the frames, run "
                                  f"{worst} alone in {shares[worst]:.0f} %")


@style.styled
def mean_nees_of_filters(times, means, runs):
    """Mean NEES of the pose through time for at most four filters. times : (T,), s. means : {name: (T,)}."""
    low, high = metrics.chi2_band(6, runs, 0.95)
    figure, axes = drawing.new_figure(2.8)
    for (name, mean), (colour, line) in zip(means.items(), LOOKS):
        axes.plot(times - times[0], mean, color=style.COLOURS[colour], linestyle=line, label=name)
    axes.axhspan(low, high, color=style.COLOURS["accepted"], alpha=0.25, linewidth=0,
                 label=f"95 % band of {runs} drives")
    axes.set(xlabel="time since start (s)", xlim=(0, times[-1] - times[0]), ylabel="mean NEES of the pose",
             yscale="log")
    inside = [name for name, mean in means.items() if np.mean((low < mean) & (mean < high)) > 0.9]
    return drawing.finish(figure, f"Inside the band in more than 90 % of the frames: {'; '.join(inside) or 'none'}")
