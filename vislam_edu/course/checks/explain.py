"""Why an answer is wrong: what would turn the right answer into it, without a list of mistakes.

Candidates are mutants of a plain answer, and the reference with changed arguments or with a changed result; then two
changes, one of them a piece of the museum. A candidate explains a result when it gives the same numbers on every
input. Several results (a mean and a covariance, say) may have explanations of their own.
"""

import contextlib
import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from . import mutants, transforms
from .comparing import ROUGH, close, same
from .edit import wrong_source
from .exercise import Exercise, Mistake
from .running import Outcome, outcome_of, within

CANDIDATES = 2500  # tried at most; counted, so that a verdict does not depend on how busy the machine is
LIMIT = 30.0  # s of CPU time, the last resort: the longest search takes 3 s
SHOWN = 3  # explanations that fit alike and are listed
VAGUE = re.compile("a part(?! of)|one variable|a number|another number")  # words that do not say where
_COMMON = 2  # kinds of mutants up to this one are tried together with a second mistake


class Explanation(NamedTuple):
    """words : one or more, each finishing "your result is what one gets ...". lines : of a plain answer, as a diff.

    result : which one of several results it explains, "" for all.
    """

    words: list[str]
    lines: str
    result: str = ""


class _TimeIsUp(Exception):
    """The search ends here, with what it has found."""


class Candidate(NamedTuple):
    """A wrong function, words for it, and the lines of a plain answer that it changes, as a diff."""

    words: str
    function: Callable
    lines: Callable[[], str] = str


@dataclass
class Search:
    """The candidates found so far: for each wrong result those that give the same numbers, by their words."""

    exercise: Exercise
    cases: list
    outcomes: list[Outcome]
    expected: list
    wrong: list[int] = field(default_factory=list)  # which results come out wrong on some input
    probe: int = 0  # the input on which candidates are tried first
    found: dict[int, dict[str, Candidate]] = field(default_factory=dict)
    settled: set[int] = field(default_factory=set)  # results explained by a simpler level
    joint: dict[str, Candidate] = field(default_factory=dict)  # explain all results, the right ones included
    level: list[tuple[Candidate, list]] = field(default_factory=list)  # candidates and their values on the probe
    left: int = field(default_factory=lambda: CANDIDATES)

    def __post_init__(self):
        wrong = [i for i, (outcome, should) in enumerate(zip(self.outcomes, self.expected))
                 if not all(self._same(i, should))]
        self.probe = next((i for i in wrong if self.outcomes[i].values is not None), wrong[0] if wrong else 0)
        self.wrong = [k for k in range(len(self.expected[0]))
                      if any(not self._same(i, self.expected[i])[k] for i in wrong)]
        self.found = {k: {} for k in self.wrong}

    def _same(self, i, values) -> list[bool]:
        """For each result of input i, whether the student's is the same as these values."""
        return same(self.exercise, self.outcomes[i], values)

    def offer(self, words: str, function: Callable, lines: Callable[[], str] = str, keep: bool = False) -> None:
        """Try a candidate, first on the probe and, where it fits, on all inputs."""
        self.left -= 1
        if self.left < 0:
            raise _TimeIsUp
        candidate = Candidate(words, function, lines)
        outcome = outcome_of(self.exercise, function, self.cases[self.probe][1])
        if keep and outcome.values is not None:
            self.level.append((candidate, outcome.values))
        if any(self._fits(self.probe, outcome)[k] for k in self.wrong):
            self._confirm(candidate)

    def _fits(self, i, outcome) -> list[bool]:
        """For each result of input i, whether the student's is that of a candidate, or raised the same error."""
        error = self.outcomes[i].error
        if outcome.values is not None and error is None:
            return self._same(i, outcome.values)
        alike = error is not None and not isinstance(error, TypeError | NameError) and (
            type(error) is type(outcome.error) and str(error) == str(outcome.error))  # one type has many causes
        return [alike] * len(self.expected[0])

    def _confirm(self, candidate) -> None:
        fits = [True] * len(self.expected[0])
        for i, (_, arguments) in enumerate(self.cases[:len(self.outcomes)]):
            now = self._fits(i, outcome_of(self.exercise, candidate.function, arguments))
            fits = [fit and fits_now for fit, fits_now in zip(fits, now)]
            if not any(fits[k] for k in self.wrong):
                return
        if all(fits):
            self.joint.setdefault(candidate.words, candidate)
        for k in self.wrong:
            if fits[k] and k not in self.settled:
                self.found[k].setdefault(candidate.words, candidate)

    @property
    def done(self) -> bool:
        return bool(self.joint) or (bool(self.wrong) and all(self.found.values()))

    def run(self, simple: bool) -> None:
        """The levels, the simplest first; ends with the first that explains everything."""
        for level in (self._mutants, self._arguments, self._results, self._two)[:1 if simple else 4]:
            level()
            self.settled = {k for k in self.wrong if self.found[k]}
            if self.done:
                return

    def _mutants(self) -> None:
        for mutant in mutants.of_exercise(self.exercise):
            self.offer(mutant.words, mutant.function, mutant.lines, keep=True)

    def _arguments(self) -> None:
        for words, change in transforms.argument_changes(self.exercise.arguments, self.cases[self.probe][1]):
            for answer in self.exercise.answers:
                self.offer(words, _after(answer, change), keep=True)

    def _results(self) -> None:
        """The right result changed, or equal to an argument; a usual mistake in one result; wrong results changed."""
        shown = self.outcomes[self.probe].values
        names = self.exercise.arguments
        outputs = self.exercise.outputs
        reference = self.exercise.reference
        for i, argument in enumerate(self.cases[self.probe][1]):
            for k in self.wrong:
                if shown is not None and isinstance(argument, np.ndarray) and argument.shape == shown[k].shape:
                    for words, change in (("when {} is returned as it came", lambda result, argument: argument),
                                          ("with {} added to the result", np.add),
                                          ("with {} subtracted from the result", np.subtract)):
                        self.offer(words.format(f"`{names[i]}`"), self._with(
                            reference, k, lambda result, arguments, i=i, change=change: change(result, arguments[i])))
        self._factors()
        for k, other in ((k, other) for k in self.wrong for other in range(len(self.expected[0])) if k != other):
            self.offer(f"with {outputs[other]} returned in place of {outputs[k]}", self._exchanged(k, other))
        pieces = [(_piece(mistake), outcome.values) for mistake in self.exercise.mistakes
                  for outcome in [outcome_of(self.exercise, mistake.function, self.cases[self.probe][1])]
                  if outcome.values is not None]
        for piece, _ in pieces:
            self.offer(*piece)
        for candidate, values in [(Candidate("", self.exercise.reference), self.expected[self.probe]), *pieces,
                                  *self.level]:
            if candidate.words and self.done:
                return
            self._changed_result(candidate, values, shown)

    def _changed_result(self, candidate, values, shown) -> None:
        if shown is None or len(values) != len(shown):
            return
        tolerance = self.exercise.tolerance if self.outcomes[self.probe].precise else ROUGH
        for k in self.wrong:
            before = np.asarray(values[k])
            for further, change in transforms.result_changes(before):
                try:
                    value = np.asarray(change(values[k]))
                except (ValueError, IndexError, np.linalg.LinAlgError):
                    continue
                # A second change that changes nothing is no part of an explanation.
                if value.shape == shown[k].shape and close(shown[k], value, tolerance) and not close(
                        before, value, tolerance):
                    name = f" (in {self.exercise.outputs[k]})" if self.exercise.outputs else ""
                    self.offer(", and ".join(filter(None, [candidate.words, further])) + name, self._with(
                        candidate.function, k, lambda result, arguments, change=change: change(
                            np.asarray(result, float))), candidate.lines)

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
        """Two mistakes at once, of which one at least is a usual one."""
        pieces = self.exercise.mistakes
        for one, other in itertools.combinations(pieces, 2):
            with contextlib.suppress(ValueError, SyntaxError):  # both edits may concern the same text
                both = Mistake(f"{one.name}, and: {other.name}", "", one.base, one.edits + other.edits)
                self.offer(f"with these two mistakes: {both.name}", both.function, both.lines)
        for piece in pieces:
            for further, change in transforms.argument_changes(self.exercise.arguments, self.cases[self.probe][1]):
                self.offer(f"{_piece(piece).words}, and {further}", _after(piece.function, change), _piece(piece).lines)
        for piece in pieces:
            source = wrong_source(piece.base, *piece.edits)
            for mutant in mutants.of_source(source, piece.base, self.exercise.statement):
                if mutant.kind <= _COMMON:
                    self.offer(f"{_piece(piece).words}, and {mutant.words}", mutant.function, _both(piece, mutant))
        common = [mutant for mutant in mutants.of_exercise(self.exercise) if mutant.kind < _COMMON]
        for mutant in mutants.pairs(common):
            self.offer(mutant.words, mutant.function, mutant.lines)

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


def _both(piece: Mistake, mutant: mutants.Mutant) -> Callable[[], str]:
    return lambda: f"{piece.lines()}\n{mutant.lines()}"


def _piece(mistake: Mistake) -> Candidate:
    return Candidate(f"with this mistake: {mistake.name}", mistake.function, mistake.lines)


def explain(exercise, cases, outcomes, expected, simple=False) -> list[Explanation]:
    """What gives an answer's numbers: one explanation of all results, or one for each wrong result; [] if not found.

    simple : only one change in the plain answer.
    """
    search = Search(exercise, cases, outcomes, expected)

    def work():
        with np.errstate(all="ignore"), contextlib.suppress(_TimeIsUp):
            search.run(simple)

    if search.wrong:
        within(work, LIMIT)
    if search.joint:
        return [_explanation(search.joint)]
    if not all(search.found.values()):
        return []
    names = exercise.outputs or ("",)
    return [_explanation(found, names[k]) for k, found in search.found.items()]


def _explanation(found: dict[str, Candidate], result: str = "") -> Explanation:
    """Those first that say which part it is."""
    best = sorted(found.values(), key=lambda one: (
        bool(VAGUE.search(one.words)), not re.search("`|mistake", one.words)))
    return Explanation([candidate.words for candidate in best[:SHOWN]], best[0].lines(), result)
