"""What of a wrong answer is right: which results, which inputs, which entries; and what its numbers look like."""

from collections import Counter

import numpy as np

from .comparing import close


def remarks(exercise, cases, outcomes, expected, sames) -> tuple[list[str], list[str]]:
    """Sentences about a wrong answer: where it is wrong, and what its numbers look like.

    sames[i][k] says whether result k of input i is right.
    """
    if all(map(all, sames)):
        return [], []
    where, looks = [_inputs(cases, sames)], []
    names = exercise.outputs or ("your result",)
    always = [all(row[k] for row in sames) for k in range(len(names))]
    if any(always):
        where.append("; ".join(f"{word}: {', '.join(name for name, is_right in zip(names, always) if is_right == kind)}"
                               for word, kind in (("Right", True), ("wrong", False))) + ".")
    for k, name in enumerate(names):
        pairs = [(outcome.values[k], should[k]) for outcome, should, row in zip(outcomes, expected, sames)
                 if outcome.values is not None and not row[k]]
        pairs = [(a, b) for a, b in pairs if a.shape == b.shape and a.size]
        if pairs and not always[k]:
            where += _entries(name, pairs, exercise.tolerance)
            looks += _looks(f"The result {name}" if exercise.outputs else "Your result", pairs, exercise.tolerance)
    return [remark for remark in where if remark], looks


def _inputs(cases, sames) -> str:
    """Which inputs are right, by their labels."""
    right = Counter(label for (label, _), row in zip(cases, sames) if all(row))
    wrong = Counter(label for (label, _), row in zip(cases, sames) if not all(row))
    if not right:
        return ""
    return f"Right on these inputs: {_listed(right, wrong)}. Wrong on these: {_listed(wrong, right)}."


def _listed(some, others) -> str:
    return ", ".join(f'{n} of {n + others[label]} "{label}"' if others[label] else f'{n} "{label}"' if n > 1 else
                     f'"{label}"' for label, n in some.items())


def _entries(name, pairs, tolerance) -> list[str]:
    """What the wrong entries of a result have in common on all inputs on which it is wrong."""
    if any(not np.isfinite(a).all() for a, _ in pairs):
        return []
    if all(close(np.abs(a), np.abs(b), tolerance) for a, b in pairs):
        return [f"In {name} only signs are wrong{_where(pairs, tolerance)}."]
    if all(close(np.sort(a, axis=None), np.sort(b, axis=None), tolerance) for a, b in pairs):
        return [f"In {name} all numbers are right, but some stand in the wrong place."]
    where = _where(pairs, tolerance)
    return [f"In {name} what is wrong lies{where}; all else is right{_kind(pairs, tolerance)}."] if where else []


def _looks(name, pairs, tolerance) -> list[str]:
    """What the wrong numbers look like."""
    found = []

    def every(test) -> bool:
        return all(test(came, should) for came, should in pairs)

    def like(a, b) -> bool:
        return close(a, b, tolerance)

    if every(lambda a, b: not np.isfinite(a).all()):
        return [f"{name} is not finite: something is divided by zero, or a root of a negative number is taken."]
    if every(lambda a, b: not a.any()):
        return [f"{name} is zero everywhere."]
    first = pairs[0][1]
    if first.ndim == 2 and first.shape[0] == first.shape[1] > 1:
        if every(lambda a, b: like(b, b.T)) and every(lambda a, b: not like(a, a.T)):
            found.append(f"{name} should be symmetric and is not: is a factor or its transpose missing on one side?")
        elif every(lambda a, b: like(b, b.T) and _positive(b) and like(a, a.T) and not _positive(a)):
            found.append(f"{name} is no covariance: it has a negative variance in some direction.")
        elif every(lambda a, b: _rank(a) < _rank(b)):
            found.append(f"{name} has rank {_rank(pairs[0][0])} where {_rank(first)} is right.")
        if every(lambda a, b: _is_rotation(b[:3, :3])) and len(first) in (3, 4):
            broken = every(lambda a, b: not _is_rotation(a[:3, :3]))
            found += [f"{name} holds no rotation: R^T R is not the identity."] if broken else []
    ratios = [float(np.linalg.norm(a) / np.linalg.norm(b)) for a, b in pairs if np.any(b) and np.isfinite(a).all()]
    if ratios and (min(ratios) > 1.05 or max(ratios) < 0.95):
        size = "too large" if min(ratios) > 1 else "too small"
        least, most = (f"{x:.0f}" if x >= 1000 else f"{x:.3g}" for x in (min(ratios), max(ratios)))
        spread = f"{least} to {most}" if max(ratios) > 1.01 * min(ratios) else least
        found.append(f"{name} is {size} on every input that is wrong: its size is {spread} times the right one.")
    return found


def _kind(pairs, tolerance) -> str:
    """What stands where the wrong entries are."""
    parts = [(a[wrong_entries(a, b, tolerance)], b[wrong_entries(a, b, tolerance)]) for a, b in pairs]
    sizes = [tolerance * np.abs(b).max(initial=0.0) for _, b in pairs]
    if all(np.abs(a).max() <= size for (a, _), size in zip(parts, sizes)):
        return ". There your result is zero"
    if all(close(-a, b, tolerance) for a, b in parts):
        return ". There the sign is reversed"
    if all(np.abs(b).max() <= size for (_, b), size in zip(parts, sizes)):
        return ". There the right result is zero"
    return ""


def wrong_entries(came: np.ndarray, should: np.ndarray, tolerance: float) -> np.ndarray:
    """Where two arrays of one shape differ by more than tolerance times the largest entry."""
    scale = np.abs(should[np.isfinite(should)]).max(initial=0.0) or 1.0
    with np.errstate(invalid="ignore"):  # inf - inf, of a point without disparity
        return ~(np.abs(came - should) <= tolerance * scale)


def _where(pairs, tolerance) -> str:
    """In words, the block, rows, columns or diagonal that holds every wrong entry; "" if no such part is found."""
    if pairs[0][1].ndim == 0 or len({b.ndim for _, b in pairs}) > 1:
        return ""
    masks = [wrong_entries(a, b, tolerance) for a, b in pairs]
    if not all(mask.any() for mask in masks):  # what differs lies in a part that is not compared
        return ""
    words = []
    names = [("entries", "entry")] if pairs[0][1].ndim == 1 else [("columns", "column"), ("rows", "row")]
    for axis in range(-len(names), 0):
        words += _range(masks, [b for _, b in pairs], axis, *names[-1 - axis])
    if words:
        return f" in {', '.join(words)}"
    if pairs[0][1].ndim == 2 and all(b.shape[0] == b.shape[1] > 1 for _, b in pairs):
        off = [mask & ~np.eye(len(mask), dtype=bool) for mask in masks]
        if not any(mask.any() for mask in off):
            return " on the diagonal"
        if not any(mask.diagonal().any() for mask in masks):
            above, below = (any(part(mask).any() for mask in masks) for part in (np.triu, np.tril))
            return " off the diagonal" + (", above it" if not below else "" if above else ", below it")
    return ""


def _range(masks, should, axis, what, single) -> list[str]:
    """The indices along an axis with a wrong entry, counted from the start or, where lengths differ, from the end."""
    lengths = [mask.shape[axis] for mask in masks]
    hit = [np.flatnonzero(mask.any(axis=tuple(i for i in range(mask.ndim) if i != mask.ndim + axis))) for mask in masks]
    first, last = min(h.min() for h in hit), max(h.max() for h in hit)
    if len(set(lengths)) > 1:
        back = max(n - h.min() for n, h in zip(lengths, hit))
        if back < max(lengths) and all(h.min() >= n - back for n, h in zip(lengths, hit)) and back <= 6:
            return [f"the last {back} {what}" if back > 1 else f"the last {single}"]
        if all(h.max() < n - 6 for n, h in zip(lengths, hit)):
            return [f"the {what} before the last 6"]
        return []
    others = [np.delete(b, np.s_[first:last + 1], axis).ravel() for b in should]
    if all(len(np.unique(values)) <= 2 and np.array_equal(values, others[0]) for values in others):
        return []  # all the rest is always the same, such as the last row of a pose: nothing could be wrong there
    return [f"{what} {first} to {last}" if last > first else f"{single} {first}"]


def _positive(matrix) -> bool:
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    return bool(values.min() > -1e-9 * np.abs(values).max())  # what rounding leaves of a zero is no mistake


def _rank(matrix) -> int:
    return int(np.linalg.matrix_rank(matrix, rtol=1e-8))


def _is_rotation(R) -> bool:
    return R.shape == (3, 3) and bool(np.isfinite(R).all()) and np.allclose(R.T @ R, np.eye(3), atol=1e-6)
