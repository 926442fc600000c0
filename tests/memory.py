"""How much memory a call needs. The system's own figure will not do: a process inherits its parent's peak."""

import tracemalloc


def peak(function):
    """Bytes that the call held at its worst, above what was there before."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
