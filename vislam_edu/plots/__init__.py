"""Still pictures: the colours of the series, maps and errors, the report's own figures.

Here lives what draws with matplotlib onto axes or returns a Figure. What moves lives in `widgets`.
"""

from .drawing import *  # noqa: F403 (each file's __all__ says what stands here too)
from .text import *  # noqa: F403
