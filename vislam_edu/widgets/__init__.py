"""Interactive pictures: the explorer of a filter's history, panels of sliders, and the pictures that these show.

Here lives everything that reacts. A widget works without a browser too, so that a test can move it.
"""

from .explorer import BOTH, Explorer
from .history import PathBelief
from .panel import Panel

__all__ = ["BOTH", "Explorer", "Panel", "PathBelief"]
