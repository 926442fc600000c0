"""The mistake museum: the wrong versions that people really write, and how one is recognised.

A wrong answer is held against each wrong version of its exercise on the same inputs. The one that gives the same
numbers made, in all likelihood, the same mistake.
"""

import textwrap

import numpy as np

from .comparing import differs, same
from .exercise import EXERCISES
from .running import Outcome, outcome_of


def recognise(exercise, cases, outcomes, expected):
    """The pieces that give an answer's numbers on every input, and else a guess: (list of Mistake, Mistake or None).

    expected : the right results. The guess is the piece that explains most of the inputs that came out wrong, if it
    explains the first of them, which the student is shown, and at least half of all.
    """
    wrong = [i for i, (outcome, should) in enumerate(zip(outcomes, expected))
             if outcome.values is None or differs(exercise, outcome, should)]
    pieces, best, most = [], None, 0

    def fits(mistake, i) -> bool:
        with np.errstate(all="ignore"):
            return _same(exercise, outcomes[i], outcome_of(exercise, mistake.function, cases[i][1]))

    for mistake in [*exercise.mistakes, *exercise.inherited] if wrong else ():
        if not fits(mistake, wrong[0]):
            continue
        found = [fits(mistake, i) for i in range(len(outcomes))]
        explained = sum(found[i] for i in wrong)
        if all(found):
            pieces.append(mistake)
        elif explained > most and 2 * explained >= len(wrong):
            best, most = mistake, explained
    return pieces, None if pieces else best


def _same(exercise, outcome, piece: Outcome) -> bool:
    if isinstance(outcome.error, ZeroDivisionError):  # Python's numbers raise where numpy's turn to NaN
        return piece.values is not None and not all(np.isfinite(value).all() for value in piece.values)
    if outcome.values is None or piece.values is None:
        return type(outcome.error) is type(piece.error) and outcome.values is piece.values
    return all(same(exercise, outcome, piece.values))


def table(width=110) -> str:
    """Every exercise, its mistakes and what the student reads, as text."""
    lines = []
    for exercise in EXERCISES.values():
        lines.append(f"{exercise.chapter:02d}  {exercise.name}")
        for mistake in exercise.mistakes:
            lines.append(f"      {mistake.name}")
            lines += textwrap.wrap(mistake.hint, width, initial_indent=" " * 10, subsequent_indent=" " * 10)
    count = sum(len(exercise.mistakes) for exercise in EXERCISES.values())
    return "\n".join([*lines, f"{len(EXERCISES)} exercises, {count} mistakes"])
