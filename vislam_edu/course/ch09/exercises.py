"""Exercise of notebook 09: what a window of landmarks costs."""

import numpy as np

from ..checks.exercise import exercise


def _tracks(rng):
    for n, frames in ((5, 6), (12, 10), (30, 20)):
        first = rng.integers(0, frames, size=n)
        yield "random", (first, np.minimum(first + rng.integers(0, 6, size=n), frames - 1), frames)


@exercise(chapter=9, cases=_tracks, shows=[np.sum], outputs=("window", "dense"), hints=[
    "Count for each frame the landmarks that are seen (first <= k <= last), and all that have been seen (first <= k).",
    "Add up 3 s (3 n + 6)^2 over the frames, s the landmarks seen: n = s in the window, all so far if none leaves."])
def window_cost(first, last, frames):
    """Multiplications that the updates of a whole drive take, with a window and without.

    first, last : (M,), the first and the last frame in which each landmark is seen; it is seen in all frames between.
    frames : how many frames there are, 0 to frames - 1. In every frame each landmark that is seen gives 3 numbers, and
    an update with m numbers on a state of d numbers takes m d^2 multiplications, with d = 3 n + 6 for n landmarks.
    A window holds exactly the landmarks that are seen, the dense filter all that have been seen so far. Returns the
    sums over all frames, of the window and of the dense filter.
    """
    window, dense = 0, 0
    for k in range(frames):
        seen = np.sum((first <= k) & (k <= last))
        so_far = np.sum(first <= k)
        window = window + 3 * seen * (3 * seen + 6)**2
        dense = dense + 3 * seen * (3 * so_far + 6)**2
    return window, dense


window_cost.slip("pose forgotten", "The state holds the pose too: d = 3 n + 6.", ("3 * seen + 6", "3 * seen"),
    ("3 * so_far + 6", "3 * so_far"))
window_cost.slip("four numbers a landmark", "v_left and v_right carry the same number: three, not four.",
    ("3 * seen * (3 * seen", "4 * seen * (3 * seen"), ("3 * seen * (3 * so_far", "4 * seen * (3 * so_far"))
window_cost.slip("last frame left out", "A landmark is still seen in its last frame: k <= last, not k < last.",
    ("k <= last", "k < last"))
window_cost.slip("m squared times d", """An update with m numbers on a state of d takes m d^2 multiplications, not m^2
    d.""", ("3 * seen * (3 * seen + 6)**2", "(3 * seen)**2 * (3 * seen + 6)"),
    ("3 * seen * (3 * so_far + 6)**2", "(3 * seen)**2 * (3 * so_far + 6)"))
