"""Are two results the same, and if not, how to say so in numbers that read the same on every machine."""

import contextlib

import numpy as np

ROUGH = 1e-4  # relative tolerance where the answer came in float32, which holds 7 digits
_SHOWN = 16  # a matrix with more entries is not printed whole


def differs(exercise, outcome, expected) -> str:
    """Why an outcome is not the expected list of arrays, in words; "" if it is."""
    names = exercise.outputs or ("",)
    for name, came, should in zip(names, outcome.values, expected):
        if came.shape != should.shape:
            return _shapes(exercise, name, came, should)
    tolerance = exercise.tolerance if outcome.precise else max(exercise.tolerance, ROUGH)
    compared = zip(names, canonical(exercise, outcome.values), canonical(exercise, expected))
    return next((_numbers(name, came, should) for name, came, should in compared
                 if not close(came, should, tolerance)), "")


def canonical(exercise, values):
    """What of a result is compared: all of it, unless the exercise leaves a part to taste."""
    return exercise.canonical(values) if exercise.canonical else values


def close(came, should, tolerance) -> bool:
    """Same shape, and every entry within tolerance times the largest; NaN and infinity are alike."""
    if came.shape != should.shape:
        return False
    finite = np.isfinite(should)
    if (finite != np.isfinite(came)).any():
        return False
    scale = np.abs(should[finite]).max(initial=0.0) or 1.0
    return bool(np.all(np.abs(came[finite] - should[finite]) <= tolerance * scale))


def same(exercise, outcome, values) -> list[bool]:
    """For each result, whether that of an outcome is the same as these values."""
    if outcome.values is None:
        return [False] * len(values)
    tolerance = exercise.tolerance if outcome.precise else ROUGH
    came, should = outcome.values, values
    if all(a.shape == np.shape(b) for a, b in zip(came, should)):
        with contextlib.suppress(ValueError, IndexError):  # made for results of the right shape
            came, should = canonical(exercise, came), canonical(exercise, should)
    return [a.shape == np.shape(b) and close(a, np.asarray(b), tolerance) for a, b in zip(came, should)]


def _shapes(exercise, name, came, should) -> str:
    text = f"{f'The result {name}' if name else 'The result'} has shape {came.shape}; it should be {should.shape}"
    if came.shape == should.shape[::-1] and close(came.T, should, exercise.tolerance):
        return text + ". The numbers are right, but transposed."
    if came.size == should.size > 1 and close(came.reshape(should.shape), should, exercise.tolerance):
        return text + ". The numbers are right: a column where a flat vector is wanted, or the reverse?"
    if came.shape[1:] == should.shape != came.shape[:-1] and not exercise.outputs:
        return text + f". Are these {len(came)} results, of which only one is asked for?"
    if came.ndim > should.ndim:
        return text + ". Has a column (n, 1) met a row (n,) and spread to a table? A flat vector is (n,)."
    return text


def _numbers(name, came, should) -> str:
    of = f" of {name}" if name else ""
    digits = 4
    if not np.isfinite(came).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(came))[0])
        worst = f"not a finite number at {list(where)}{of}" if where else f"not a finite number{of}"
    else:
        error = np.abs(came - should)
        # The first of those that are the largest but for rounding, which may fall otherwise on another machine.
        where = tuple(int(i) for i in np.argwhere(error >= (1 - 1e-6) * error.max())[0])
        # As many digits as it takes to see the difference.
        digits = max(4, 2 + int(np.ceil(-np.log10(error.max() / (np.abs(should).max(initial=0.0) or 1.0)))))
        worst = f"largest difference{of} {number(error[where])}" + (f", at {list(where)}" if where else "")
        if should.size > _SHOWN:
            worst += (f": {number(rounded(came, digits)[where], digits)} where "
                      f"{number(rounded(should, digits)[where], digits)} should be")
    if should.size > _SHOWN:
        return worst
    return f"came out{of}\n{block(came, digits)}\nshould be\n{block(should, digits)}\n{worst}"


# --- numbers as text --------------------------------------------------------------------------------------

def number(value, digits=4) -> str:
    return f"{value + 0.0:.{digits}g}"


def rounded(values, digits=4):
    """To so many digits of the largest entry: what rounding has left behind, on this machine or another, becomes 0."""
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    if largest == 0.0:
        return values
    step = 10.0 ** (np.floor(np.log10(largest)) - digits + 1)
    return np.round(values / step) * step


def block(values, digits=4) -> str:
    """An array, rounded and indented."""
    texts = np.vectorize(number, otypes=[object])(rounded(values, digits), digits)
    if values.ndim < 2:
        return "  " + (f"[{', '.join(texts)}]" if values.ndim else str(texts))
    width = max((len(text) for text in texts.flat), default=0)
    rows = texts.reshape(-1, values.shape[-1])
    return "\n".join("  [" + "  ".join(text.rjust(width) for text in row) + "]" for row in rows)


def argument(name, value) -> str:
    """One argument of a call: short ones whole, long ones by their shape."""
    if isinstance(value, (bool, int, float)):
        return f"  {name} = {value:.4g}"
    if not isinstance(value, np.ndarray):
        return f"  {name}: {type(value).__name__}"
    if value.dtype == bool and value.size <= 6:
        return f"  {name} = {value.tolist()}"
    if value.ndim == 1 and value.size <= 6:
        return f"  {name} = {block(value.astype(float)).strip()}"
    if value.ndim == 2 and 0 < value.size <= _SHOWN:
        return f"  {name} =\n" + "\n".join("  " + line for line in block(value.astype(float)).splitlines())
    return f"  {name}: array of shape {value.shape}"
