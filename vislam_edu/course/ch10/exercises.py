"""Exercise of notebook 10: a symptom that needs no ground truth."""

import numpy as np

from ..checks.exercise import exercise


def _innovations(rng):
    for n, memory in ((50, 0.0), (120, 0.7), (200, -0.4)):
        values = rng.normal(size=n)
        for k in range(1, n):
            values[k] += memory * values[k - 1]
        yield "random", (values + 0.3,)


@exercise(chapter=10, cases=_innovations, shows=[np.corrcoef], outputs=("correlation", "bound"), hints=[
    "Subtract the mean, multiply each value with the one before it, and add up.",
    "e = e - e.mean(); sum(e[1:] * e[:-1]) / sum(e**2); the bound is 1.96 / sqrt(n)."])
def whiteness(innovations):
    """Correlation of one component of the innovation with itself one frame earlier, and how large chance makes it.

    A filter whose model is right has used up what it could predict: its innovations are white, each independent of the
    one before. innovations : (n,), one normalised component, frame after frame. Returns the correlation, sum of
    e_k e_{k-1} divided by the sum of e_k^2 with e the innovations less their mean, and the bound 1.96 / sqrt(n), which
    95 % of white sequences stay below in size.
    """
    e = innovations - np.mean(innovations)
    correlation = np.sum(e[1:] * e[:-1]) / np.sum(e**2)
    return correlation, 1.96 / np.sqrt(len(e))


whiteness.slip("mean not subtracted", "Subtract the mean first, or a constant offset looks like a correlation.",
    (" - np.mean(innovations)", ""))
whiteness.slip("not divided", "Divide by the sum of squares: a correlation has no unit and lies between -1 and 1.",
    (" / np.sum(e**2)", ""))
whiteness.slip("root of n forgotten", "The scatter of a mean of n numbers falls with the root of n.",
    ("np.sqrt(len(e))", "len(e)"))
