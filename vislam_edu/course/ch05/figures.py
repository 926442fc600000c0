"""Figures of chapter 05. Poses are world_T_imu, (T, 4, 4); positions in metres in the world frame; each is a Figure."""

import numpy as np

from ...plots import drawing, style


@style.styled
def jacobian_pattern(H):
    """Which entries of the joint Jacobian H (rows, 3n+6) are not zero."""
    figure, axes = drawing.new_figure(3.0)
    axes.grid(False)
    axes.imshow(H != 0, cmap="Greys", aspect="auto", interpolation="nearest", extent=(0, H.shape[1], H.shape[0], 0))
    axes.axvline(H.shape[1] - 6, color=style.COLOURS["slam"], linestyle="--",
                 label="landmarks to the left, pose to the right")
    axes.set(xlabel="column: error of the state (three a landmark, then six of the pose)",
             ylabel="row: pixel (four a landmark)")
    return drawing.finish(figure, f"H, black where not zero ({100 * np.mean(H != 0):.0f} %): landmarks share nothing "
                                  "but the pose")
