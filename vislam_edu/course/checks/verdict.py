"""The verdict on an answer: right, not written yet, or wrong, and then why."""

import inspect
import textwrap
from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

from . import museum, right_parts, slips, surroundings
from .comparing import argument, differs, same
from .exercise import Exercise, short
from .explain import VAGUE, explain
from .picture import Picture, picture_of
from .running import LIMIT, Outcome, answers, copied, error_message, read, written

RIGHT, NOT_WRITTEN, WRONG = "right", "not written yet", "wrong"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a check found.

    status : RIGHT, NOT_WRITTEN or WRONG. text : what the student reads. mistake : its name in the museum where
    it was recognised, else words for what gives the same numbers, else "". located : what of the result is right,
    or what its numbers look like, is said. failing : the arguments of the first input that came out wrong, else None.
    picture : of its result there, where a result has one. more : lines of a plain answer, for a second failure.
    """

    exercise: str
    status: str
    text: str
    mistake: str = ""
    failing: tuple | None = None
    located: bool = False
    picture: Picture | None = None
    more: str = ""

    @property
    def right(self) -> bool:
        return self.status == RIGHT


def judge(exercise: Exercise, function, limit=LIMIT) -> Verdict:
    """Put an answer to all inputs of its exercise. limit : s of CPU time, for all of them together."""
    name = exercise.name
    if not callable(function):
        return Verdict(name, WRONG, f"{name}: give the function itself, without calling it: check.{name}({name})")
    return concluded(exercise, attempt(exercise, function, limit), limit)


@dataclass(frozen=True, eq=False)
class Attempt:
    """What an answer did: all that a verdict needs, and nothing of the answer itself.

    outcomes, ended : see `running.answers`. is_written : more than a stub. rebound : names of what it changed.
    slip, unused : see `slips.clues`.
    """

    outcomes: list[Outcome]
    ended: str
    is_written: bool
    rebound: list[str]
    slip: str = ""
    unused: str = ""


def attempt(exercise: Exercise, function, limit: float = LIMIT) -> Attempt:
    """Put an answer to all inputs of its exercise. limit : s of CPU time, for all of them together."""
    rebound = surroundings.restored()
    cases = exercise.inputs()
    outcomes, ended = answers(exercise, function, cases, limit)
    rebound += surroundings.restored()  # before anything of ours is called again
    own = inspect.unwrap(function)  # the grader watches it from outside
    made = Attempt(outcomes, ended, written(own), rebound)
    if any(outcome.blank for outcome in outcomes):
        return made
    reasons = map(_reason, [exercise] * len(cases), outcomes, _expected(exercise, cases))
    first = next((i for i, reason in enumerate(reasons) if reason), None)
    if first is None:
        return made
    slip, unused = slips.clues(exercise, own, outcomes, first, limit)
    return replace(made, rebound=rebound + surroundings.restored(), slip=slip, unused=unused)


def _expected(exercise, cases) -> list:
    return [read(exercise.expected(*map(copied, arguments)), exercise.outputs)[0] for _, arguments in cases]


def concluded(exercise: Exercise, made: Attempt, limit: float = LIMIT) -> Verdict:
    """The verdict on an attempt. limit : s, that it had."""
    verdict = _judged(exercise, made, limit)
    if made.rebound:
        names = ", ".join(sorted({*made.rebound})[:4])
        verdict = replace(verdict, text=f"{verdict.text}\nYour code has changed {names}: put back, so that other "
                                        "checks work.")
    return verdict


def _judged(exercise: Exercise, made: Attempt, limit) -> Verdict:
    name, outcomes, ended = exercise.name, made.outcomes, made.ended
    cases = exercise.inputs()
    expected = _expected(exercise, cases)
    if any(outcome.blank for outcome in outcomes):
        return _blank(exercise, made.is_written, outcomes)

    reasons = [_reason(exercise, outcome, should) for outcome, should in zip(outcomes, expected)]
    failing = [i for i, reason in enumerate(reasons) if reason]
    if len(outcomes) < len(cases) and not failing:  # it ran out of time, or ended the thread that asked it
        return _too_slow(exercise, cases[len(outcomes)], ended, limit)
    if not failing:
        rough = "" if all(outcome.precise for outcome in outcomes) else \
            "\n  (Your numbers have fewer than 64 bits and were compared to 1e-4; a filter needs float64.)"
        return Verdict(name, RIGHT, f"{name}: right, on {_tried(cases)}, "
                                    f"to {short(exercise.tolerance)} of the largest entry{rough}{_remarks(outcomes)}")
    return _wrong(exercise, made, cases, expected, reasons)


def _reason(exercise, outcome, expected) -> str:
    if outcome.error is not None:
        return error_message(outcome.error)
    reason = differs(exercise, outcome, expected)
    if outcome.changed:
        changed = f"our function changes its argument {' and '.join(outcome.changed)}: work on a copy"
        return f"{reason}\nand y{changed}" if reason else f"Y{changed}"
    return reason


def _wrong(exercise, made, cases, expected, reasons) -> Verdict:
    outcomes = made.outcomes
    first = next(i for i, reason in enumerate(reasons) if reason)
    label, arguments = cases[first]
    sames = [same(exercise, outcome, should) for outcome, should in zip(outcomes, expected)]
    reason, look = reasons[first], ""
    if exercise.first and outcomes[first].values is not None and not outcomes[first].changed:
        reason, look = exercise.first(arguments, outcomes[first].values, expected[first])
    found = _causes(exercise, made, cases, expected, sames, look)
    lines = [f"{exercise.name}: wrong, on input {first + 1} of {len(cases)} ({label})",
             *(argument(*pair) for pair in zip(exercise.arguments, arguments)), reason, *found.said,
             _remarks(outcomes).strip(), f"To try this input: {exercise.name}(*check.{exercise.name}.failing)"]
    more = f"In a plain answer these are the lines (- as in yours, + right):\n{textwrap.indent(found.lines, '  ')}"
    return Verdict(exercise.name, WRONG, "\n".join(filter(None, lines)), found.mistake,
                   tuple(map(copied, arguments)), located=found.located or outcomes[first].error is not None,
                   picture=picture_of(exercise, outcomes[first].values or [], expected[first]),
                   more=more if found.lines else "")


class _Causes(NamedTuple):
    """What is said about the cause; the rest as in Verdict. lines : of a plain answer, as a diff."""

    said: list[str]
    mistake: str = ""
    located: bool = False
    lines: str = ""


def _causes(exercise, made, cases, expected, sames, look) -> _Causes:
    outcomes, slip, unused = made.outcomes, made.slip, made.unused
    if slip:
        return _Causes([slip], slip)
    pieces, guess = museum.recognise(exercise, cases, outcomes, expected)
    slip = slips.unmoved(exercise, outcomes, expected, sames) or slips.cut(exercise, outcomes, expected, sames)
    if slip and not pieces:
        return _Causes([slip, unused], " ".join(filter(None, [slip, unused])))
    explanations = [] if look and pieces else explain(exercise, cases, outcomes, expected, simple=bool(pieces or look))
    where, looks = ([look], []) if look else right_parts.remarks(exercise, cases, outcomes, expected, sames)
    said = [f"Most likely: {piece.name}. {piece.hint}" for piece in pieces]
    if pieces and (others := [words for one in explanations[:1] for words in one.words if not VAGUE.search(words)]):
        said.append(f"The same numbers come out {', or '.join(others[:2])}.")
    elif explanations and not pieces:
        said += [f"Your result is what one gets {_together(explanations)}.", unused, *where]
    elif not pieces:
        said += [unused, *([f"Perhaps: {guess.name}. {guess.hint}"] if guess else []), *where, *looks]
    named = [piece.name for piece in [*pieces, *([] if explanations else [guess])] if piece]
    named += ["; ".join(explanation.words[0] for explanation in explanations)] if explanations else [unused]
    lines = [piece.lines() for piece in pieces] + [explanation.lines for explanation in explanations]
    return _Causes(said, named[0], bool(where or looks), next(filter(None, lines), ""))


def _together(explanations) -> str:
    """Words for the explanations of all results together, or for one of each wrong result."""
    if len(explanations) == 1:
        return ", or ".join(explanations[0].words)
    results: dict[str, list[str]] = {}
    for one in explanations:
        results.setdefault(one.words[0].removesuffix(f" (in {one.result})"), []).append(one.result)
    return " and ".join(f"{words} (in {' and '.join(names)})" for words, names in results.items())


def _remarks(outcomes) -> str:
    found = dict.fromkeys(remark for outcome in outcomes for remark in outcome.remarks)
    return "".join(f"\n  {remark}" for remark in found)


def _blank(exercise, is_written, outcomes) -> Verdict:
    n, last, status, text = len(outcomes), outcomes[-1], NOT_WRITTEN, "not written yet"
    if last.calls:
        text = f"it calls {last.calls}, which is not written yet"
    elif is_written and last.nothing:
        status, text = WRONG, f"your function returned nothing on input {n}: is `return` missing?"
    elif is_written and n == 1:
        text = "the line `raise NotImplementedError` is still there, and nothing below it is run: delete it"
    elif n > 1:
        text = f"not written yet for every input: input {n} gave None or NotImplementedError"
    return Verdict(exercise.name, status, f"{exercise.name}: {text}")


def _too_slow(exercise, case, ended, limit) -> Verdict:
    label, arguments = case
    still = "\nIt could not be stopped and still runs: restart the kernel." if ended == "running" else ""
    return Verdict(exercise.name, WRONG, "\n".join([
        f"{exercise.name}: wrong, still no answer after {limit:g} s of computing, on the input ({label})",
        *(argument(*pair) for pair in zip(exercise.arguments, arguments)),
        f"Does a loop never end, or does it wait for something?{still}"]), failing=tuple(map(copied, arguments)))


def _tried(cases) -> str:
    labels = Counter(label for label, _ in cases)
    return f"{len(cases)} inputs ({'; '.join(f'{n} {label}' if n > 1 else label for label, n in labels.items())})"
