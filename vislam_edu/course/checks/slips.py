"""Slips that can be told from the code or from two calls: then there is nothing to search for in the numbers."""

import ast
import inspect
from types import FunctionType

import numpy as np

from .running import Outcome, answers, tree_of


def clues(exercise, function, outcomes: list[Outcome], i: int, limit: float) -> tuple[str, str]:
    """What an answer's code, and a further call on input i, say: of a slip that explains all, of unused arguments."""
    again, _ = answers(exercise, function, exercise.inputs()[i:i + 1], limit)
    slip = (unlike(outcomes[i], again[0]) if again else "") or other_order(exercise, function)
    return slip, unused(exercise, function)


def other_order(exercise, function) -> str:
    """Arguments of the stub's names in another order, or of another number."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return ""
    names = [one.name for one in parameters if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
    if len(names) < len(list(parameters)) or names == exercise.arguments:
        return ""
    wanted = f"Write def {exercise.name}({', '.join(exercise.arguments)}), as in the stub"
    if sorted(names) == sorted(exercise.arguments):
        return f"Your function takes its arguments in another order, ({', '.join(names)}). {wanted}: it is called so."
    needed = [one for one in parameters if one.default is one.empty]
    return "" if len(needed) <= len(exercise.arguments) <= len(names) else f"{wanted}."


def unused(exercise, function) -> str:
    """Arguments that the student's code never reads, and variables from outside that it reads in their place."""
    tree, reference = tree_of(function), tree_of(exercise.reference)
    if tree is None or not isinstance(function, FunctionType):
        return ""
    read, needed = _read(tree), _read(reference or ast.Module([], []))
    ignored = [name for name, wanted in zip(inspect.signature(function).parameters, exercise.arguments)
               if name not in read and wanted in needed]
    code = function.__code__
    values = {name: function.__globals__.get(name) for name in code.co_names if name in read} | dict(
        zip(code.co_freevars, (cell.cell_contents for cell in function.__closure__ or ())))
    outside = [name for name, value in values.items() if isinstance(value, np.ndarray | int | float | list | tuple)]
    if not ignored:
        return ""
    said = f"Your function never uses {_listed(ignored)}"
    return f"{said}; it reads {_listed(outside)}, which is defined outside it." if outside else f"{said}."


def _read(tree) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}


def _listed(names) -> str:
    return " and ".join(f"`{name}`" for name in names)


def unlike(outcome: Outcome, again: Outcome) -> str:
    """Two calls on the same arguments with different results."""
    if outcome.values is None or again.values is None or all(
            np.array_equal(a, b, equal_nan=True) for a, b in zip(outcome.values, again.values)):
        return ""
    return ("Two calls with the same arguments gave different results: it draws random numbers, or keeps something "
            "from one call to the next, such as a list that is defined outside it.")


def _results(exercise) -> list[str]:
    return [f"The result {name}" for name in exercise.outputs] or ["Your result"]


def unmoved(exercise, outcomes, expected, sames) -> str:
    """The wrong results that are zero, or the same, on every input."""
    said = []
    for k, name in enumerate(_results(exercise)):
        pairs = [(outcome.values[k], should[k]) for outcome, should in zip(outcomes, expected)
                 if outcome.values is not None]
        if all(row[k] for row in sames) or len(pairs) < len(outcomes):
            continue
        first = pairs[0][0]
        if all(not came.any() for came, _ in pairs):
            said.append(f"{name} is zero on every input.")
        elif len(pairs) > 1 and all(np.array_equal(came, first) for came, _ in pairs) and not all(
                np.array_equal(should, pairs[0][1]) for _, should in pairs):
            said.append(f"{name} is the same on every input: it does not depend on the arguments.")
        else:
            return ""
    return " ".join(said)


def cut(exercise, outcomes, expected, sames) -> str:
    """Results that are the right ones without what stands behind the decimal point."""
    for k, name in enumerate(_results(exercise)):
        pairs = [(outcome.values[k], should[k]) for outcome, should, row in zip(outcomes, expected, sames)
                 if outcome.values is not None and not row[k]]
        if pairs and any(came.any() for came, _ in pairs) and all(
                came.shape == should.shape and np.array_equal(came, np.trunc(should)) for came, should in pairs):
            return (f"{name} holds whole numbers: an array of integers (dtype=int) cuts off what stands behind the "
                    "decimal point of what is written into it. Make it with np.zeros(shape), without dtype=int.")
    return ""
