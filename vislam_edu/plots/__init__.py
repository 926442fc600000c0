"""Still pictures: the colours of the series, maps and errors, the report's own figures.

Here lives what draws with matplotlib onto axes or returns a Figure. What moves lives in `widgets`.
"""

from .drawing import (
    TWO_SIDED_95,
    WIDTH,
    draw_ellipses,
    draw_inset,
    draw_landmarks,
    draw_position_ellipses,
    draw_trajectory,
    draw_truth,
    finish,
    heading,
    heading_band,
    heading_error,
    heading_sigma,
    inside,
    new_figure,
    new_map,
    plane_sigma,
    position_covariance,
    position_outlines,
    trajectories,
    view_around,
    view_with_outlines,
)
from .text import on_a_page, show_source, table, two_digits

__all__ = ["TWO_SIDED_95", "WIDTH", "draw_ellipses", "draw_inset", "draw_landmarks", "draw_position_ellipses",
           "draw_trajectory", "draw_truth", "finish", "heading", "heading_band", "heading_error", "heading_sigma",
           "inside", "new_figure", "new_map", "on_a_page", "plane_sigma", "position_covariance", "position_outlines",
           "show_source", "table", "trajectories", "two_digits", "view_around", "view_with_outlines"]
