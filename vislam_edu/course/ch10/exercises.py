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
whiteness.slip("np.corrcoef", """Nearly the same number, but another definition: np.corrcoef subtracts a mean from each
    of the two pieces and divides by the squares of each. Here one mean and one sum of squares, of the whole sequence,
    are asked for.""", ("np.sum(e[1:] * e[:-1]) / np.sum(e**2)", "np.corrcoef(e[1:], e[:-1])[0, 1]"))
whiteness.slip("lag zero", "Each value is multiplied by the one before it, not by itself: e[1:] * e[:-1].",
    ("e[1:] * e[:-1]", "e * e"))
whiteness.slip("lag two", "One frame earlier: e[1:] * e[:-1].", ("e[1:] * e[:-1]", "e[2:] * e[:-2]"))
whiteness.slip("last value multiplied by the first", """np.roll brings the last value to the front. There are n - 1
    products: e[1:] * e[:-1].""", ("e[1:] * e[:-1]", "e * np.roll(e, 1)"))
whiteness.slip("means in place of sums", """There are n - 1 products and n squares, so the ratio of the means is not the
    ratio of the sums.""", ("np.sum(e[1:] * e[:-1]) / np.sum(e**2)", "np.mean(e[1:] * e[:-1]) / np.mean(e**2)"))
whiteness.slip("squares of n - 1 values", "All n squares are in the sum below.", ("np.sum(e**2)", "np.sum(e[1:]**2)"))
whiteness.slip("divided by the variance", """Divide the sum of products by the sum of squares, which is n times the
    variance.""", ("np.sum(e**2)", "np.var(e)"))
whiteness.slip("divided by the standard deviation", "Divide by the sum of squares: a correlation has no unit.",
    ("np.sum(e**2)", "np.std(e)"))
whiteness.slip("size of the correlation", "The correlation has a sign; compare its size with the bound afterwards.",
    ("return correlation", "return np.abs(correlation)"))
whiteness.slip("bound of 90 %", "1.645 leaves 90 % of white sequences below; 1.96 leaves 95 %.", ("1.96", "1.645"))
whiteness.slip("bound of 99 %", "2.576 leaves 99 % of white sequences below; 1.96 leaves 95 %.", ("1.96", "2.576"))
whiteness.slip("n - 1 for n", "The bound is 1.96 / sqrt(n), n the number of innovations.", ("len(e)", "len(e) - 1"))
