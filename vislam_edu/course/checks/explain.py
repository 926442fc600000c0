"""Why an answer is wrong: what would turn the right answer into it, without a list of mistakes.

Candidates are the museum's pieces, mutants of a plain answer, and the reference with changed arguments or with a
changed result; then a piece with changed arguments. A candidate explains a result when it gives the same numbers on
every input. Several results (a mean and a covariance, say) may have explanations of their own.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from . import mutants, transforms
from .comparing import ROUGH, canonical, close
from .exercise import Exercise
from .running import Outcome, outcome_of, within

LIMIT = 1.5  # s, for the whole search
SHOWN = 3  # explanations that fit alike and are listed


class _TimeIsUp(Exception):
    """The search ends here, with what it has found."""


@dataclass
class Search:
    """The candidates found so far: for each wrong result the words of those that give the same numbers."""

    exercise: Exercise
    cases: list
    outcomes: list[Outcome]
    expected: list
    wrong: list[int] = field(default_factory=list)  # which results come out wrong on some input
    probe: int = 0  # the input on which candidates are tried first
    found: dict[int, list[str]] = field(default_factory=dict)
    joint: list[str] = field(default_factory=list)  # explain all results, the right ones included
    level: list[tuple[str, Callable, list]] = field(default_factory=list)  # words, function, values on the probe
    end: float = field(default_factory=lambda: time.monotonic() + LIMIT)

    def __post_init__(self):
        wrong = [i for i, (outcome, should) in enumerate(zip(self.outcomes, self.expected))
                 if not all(self._same(i, should))]
        self.probe = next((i for i in wrong if self.outcomes[i].values is not None), wrong[0] if wrong else 0)
        self.wrong = [k for k in range(len(self.expected[0]))
                      if any(not self._same(i, self.expected[i])[k] for i in wrong)]
        self.found = {k: [] for k in self.wrong}

    def _same(self, i, values) -> list[bool]:
        """For each result of input i, whether the student's is the same as these values."""
        return same(self.exercise, self.outcomes[i], values)

    def offer(self, words: str, function: Callable, keep: bool = False) -> None:
        """Try a candidate, first on the probe and, where it fits, on all inputs."""
        self._watch()
        outcome = outcome_of(self.exercise, function, self.cases[self.probe][1])
        if keep and outcome.values is not None:
            self.level.append((words, function, outcome.values))
        if outcome.values is None and not self._alike(self.probe, outcome):
            return
        fits = [True] * len(self.expected[0]) if outcome.values is None else self._same(self.probe, outcome.values)
        if any(fits[k] for k in self.wrong):
            self._confirm(words, function, fits)

    def _watch(self) -> None:
        if time.monotonic() > self.end:
            raise _TimeIsUp

    def _alike(self, i, outcome) -> bool:
        error = self.outcomes[i].error
        if error is None or isinstance(error, TypeError | NameError):
            return False
        return type(error) is type(outcome.error) and str(error) == str(outcome.error)  # one type has many causes

    def _confirm(self, words, function, fits) -> None:
        for i, (_, arguments) in enumerate(self.cases[:len(self.outcomes)]):
            outcome = outcome_of(self.exercise, function, arguments)
            if outcome.values is None or self.outcomes[i].values is None:
                fits = [fit and self._alike(i, outcome) for fit in fits]
            else:
                fits = [fit and now for fit, now in zip(fits, self._same(i, outcome.values))]
        if all(fits) and words not in self.joint:
            self.joint.append(words)
        for k in self.wrong:
            if fits[k] and words not in self.found[k]:
                self.found[k].append(words)

    @property
    def done(self) -> bool:
        return bool(self.joint) or (bool(self.wrong) and all(self.found.values()))

    def run(self, simple: bool) -> None:
        """The levels, the simplest first; ends with the first that explains everything."""
        for level in (self._mutants, self._arguments, self._results, self._two)[:1 if simple else 4]:
            level()
            if self.done:
                return

    def _mutants(self) -> None:
        for words, function, _ in mutants.mutants(self.exercise.name):
            self.offer(words, function, keep=True)

    def _arguments(self) -> None:
        for words, change in transforms.argument_changes(self.exercise.arguments, self.cases[self.probe][1]):
            for answer in self.exercise.answers:
                self.offer(words, _after(answer, change), keep=True)

    def _results(self) -> None:
        """The right result changed, or equal to an argument; then wrong results changed."""
        shown = self.outcomes[self.probe].values
        names = self.exercise.arguments
        outputs = self.exercise.outputs
        for i, argument in enumerate(self.cases[self.probe][1]):
            if isinstance(argument, np.ndarray):
                for k in self.wrong:
                    if shown is not None and argument.shape == shown[k].shape:
                        self.offer(f"when `{names[i]}` is returned as it came", self._with(
                            self.exercise.reference, k, lambda result, arguments, i=i: arguments[i]))
                        for sign, words in ((1, "added to"), (-1, "subtracted from")):
                            self.offer(f"with `{names[i]}` {words} the result", self._with(
                                self.exercise.reference, k, lambda result, arguments, i=i, sign=sign:
                                result + sign * arguments[i]))
        self._factors()
        for k, other in ((k, other) for k in self.wrong for other in range(len(self.expected[0])) if k != other):
            self.offer(f"with {outputs[other]} returned in place of {outputs[k]}", self._exchanged(k, other))
        reference = ("", self.exercise.reference, self.expected[self.probe])
        pieces = [(f"with this mistake: {piece.name}", piece.function, outcome.values)
                  for piece in self.exercise.mistakes
                  for outcome in [outcome_of(self.exercise, piece.function, self.cases[self.probe][1])]
                  if outcome.values is not None]
        for words, function, values in [reference, *pieces, *self.level]:
            if words and self.done:
                return
            self._changed_result(words, function, values, shown)

    def _changed_result(self, words, function, values, shown) -> None:
        self._watch()
        if shown is None or len(values) != len(shown):
            return
        for k in self.wrong:
            for further, change in transforms.result_changes(np.asarray(values[k])):
                try:
                    value = np.asarray(change(values[k]))
                except (ValueError, IndexError, np.linalg.LinAlgError):
                    continue
                if value.shape == shown[k].shape and close(shown[k], value, self._tolerance(self.probe)):
                    name = f" ({self.exercise.outputs[k]})" if self.exercise.outputs else ""
                    self.offer(" and ".join(filter(None, [words, further])) + name, self._with(
                        function, k, lambda result, arguments, change=change: change(np.asarray(result, float))))

    def _factors(self) -> None:
        """The right result times a number, or times a power of an argument."""
        shown, should = self.outcomes[self.probe].values, self.expected[self.probe]
        if shown is None:
            return
        for k in self.wrong:
            if shown[k].shape != should[k].shape or not np.abs(should[k]).max(initial=0.0) > 0.0:
                continue
            where = np.unravel_index(np.argmax(np.abs(np.nan_to_num(should[k]))), should[k].shape)
            ratio = float(shown[k][where] / should[k][where])
            self.offer(f"with the result multiplied by {ratio:.4g}", self._with(
                self.exercise.reference, k, lambda result, arguments, ratio=ratio: ratio * np.asarray(result)))
            for i, argument in enumerate(self.cases[self.probe][1]):
                if isinstance(argument, int | float) and not isinstance(argument, bool):
                    for power in (-2, -1, -0.5, 0.5, 1, 2):
                        words = f"with the result multiplied by `{self.exercise.arguments[i]}` ** {power}"
                        self.offer(words, self._with(
                            self.exercise.reference, k, lambda result, arguments, i=i, power=power:
                            float(arguments[i])**power * np.asarray(result)))

    def _two(self) -> None:
        changes = list(transforms.argument_changes(self.exercise.arguments, self.cases[self.probe][1]))
        pieces = [(f"with this mistake: {piece.name}", piece.function) for piece in self.exercise.mistakes]
        for words, function in pieces:
            for further, change in changes:
                self.offer(f"{words}; and {further}", _after(function, change))

    def _tolerance(self, i) -> float:
        return self.exercise.tolerance if self.outcomes[i].precise else ROUGH

    def _with(self, function, k, change):
        """The function with result number k changed."""
        def changed(*arguments):
            result = function(*arguments)
            if not self.exercise.outputs:
                return change(result, arguments)
            return tuple(change(part, arguments) if i == k else part for i, part in enumerate(result))
        return changed

    def _exchanged(self, k, other):
        def changed(*arguments):
            parts = list(self.exercise.reference(*arguments))
            parts[k], parts[other] = parts[other], parts[k]
            return tuple(parts)
        return changed


def _after(function, change):
    return lambda *arguments: function(*change(arguments))


def same(exercise, outcome, values) -> list[bool]:
    """For each result, whether the outcome's is the same as these values."""
    if outcome.values is None:
        return [False] * len(values)
    tolerance = exercise.tolerance if outcome.precise else ROUGH
    came, should = outcome.values, values
    if all(a.shape == np.shape(b) for a, b in zip(came, should)):
        with contextlib.suppress(ValueError, IndexError):  # made for results of the right shape
            came, should = canonical(exercise, came), canonical(exercise, should)
    return [a.shape == np.shape(b) and close(a, np.asarray(b), tolerance) for a, b in zip(came, should)]


def explain(exercise, cases, outcomes, expected, simple=False) -> list[str]:
    """Words for what gives an answer's numbers, each finishing "your result is what one gets ..."; [] if not found.

    simple : only one change in the plain answer.
    """
    search = Search(exercise, cases, outcomes, expected)

    def work():
        with np.errstate(all="ignore"), contextlib.suppress(_TimeIsUp):
            search.run(simple)

    if search.wrong:
        within(work, LIMIT + 0.3)  # should one candidate never come back
    if search.joint:
        return search.joint[:SHOWN]
    if search.wrong and all(search.found.values()):
        return [";\n  ".join(f"{exercise.outputs[k] if exercise.outputs else 'the result'} as one gets "
                             f"{search.found[k][0]}" for k in search.wrong)]
    return []
