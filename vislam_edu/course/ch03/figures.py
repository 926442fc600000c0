"""Figures of chapter 03. Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame; each is a Figure."""

import numpy as np

from ...plots import drawing, style


@style.styled
def nis_histogram(nis, threshold):
    """NIS of stereo measurements beside the chi-square density of 4 degrees of freedom, and the gate.

    nis : (n,). threshold : the gate's. Values above 20 are not drawn.
    """
    figure, axes = drawing.new_figure(2.2)
    grid = np.linspace(0, 20, 200)
    axes.hist(nis, bins=grid[::5], density=True, color=style.COLOURS["mapping"], alpha=0.35,
              label="innovations of the drive")
    axes.plot(grid, grid / 4 * np.exp(-grid / 2), color=style.COLOURS["expected"], linestyle="--",
              label="chi-square, 4 degrees of freedom")
    axes.axvline(threshold, color=style.COLOURS["rejected"], label="gate")
    axes.set(xlabel="NIS of one stereo measurement", ylabel="density", xlim=(0, 20))
    return drawing.finish(figure, f"Mean NIS {np.mean(nis):.1f}, where an honest filter has 4")
