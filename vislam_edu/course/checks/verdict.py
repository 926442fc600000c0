"""The verdict on an answer: right, not written yet, or wrong, and then why."""

from collections import Counter
from dataclasses import dataclass, replace

from . import museum, right_parts, surroundings
from .comparing import argument, differs
from .exercise import Exercise, short
from .explain import explain, same
from .picture import Picture, picture_of
from .running import LIMIT, answers, arrays, copied, error_message, written

RIGHT, NOT_WRITTEN, WRONG = "right", "not written yet", "wrong"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a check found.

    status : RIGHT, NOT_WRITTEN or WRONG. text : what the student reads. mistake : its name in the museum where
    it was recognised, else words for what gives the same numbers, else "". located : what of the result is right,
    or what its numbers look like, is said. failing : the arguments of the first input that came out wrong, else None.
    picture : of its result there, where a result has one.
    """

    exercise: str
    status: str
    text: str
    mistake: str = ""
    failing: tuple | None = None
    located: bool = False
    picture: Picture | None = None

    @property
    def right(self) -> bool:
        return self.status == RIGHT


def judge(exercise: Exercise, function, limit=LIMIT) -> Verdict:
    """Put an answer to all inputs of its exercise. limit : s, for all of them together."""
    name = exercise.name
    if not callable(function):
        return Verdict(name, WRONG, f"{name}: give the function itself, without calling it: check.{name}({name})")
    rebound = surroundings.restored()
    verdict = _judged(exercise, function, limit, rebound)
    if rebound:
        changed = f"Your code has changed {', '.join(sorted({*rebound})[:4])}: put back, so that other checks work."
        verdict = replace(verdict, text=f"{verdict.text}\n{changed}")
    return verdict


def _judged(exercise: Exercise, function, limit, rebound: list[str]) -> Verdict:
    name = exercise.name
    cases = exercise.inputs()
    expected = [arrays(exercise.expected(*map(copied, arguments)), exercise.outputs)[0] for _, arguments in cases]
    outcomes, ended = answers(exercise, function, cases, limit)
    rebound += surroundings.restored()  # before anything of ours is called again
    if any(outcome.blank for outcome in outcomes):
        return _blank(exercise, function, outcomes)

    reasons = [_reason(exercise, outcome, should) for outcome, should in zip(outcomes, expected)]
    failing = [i for i, reason in enumerate(reasons) if reason]
    if ended and not failing:
        return _too_slow(exercise, cases[len(outcomes)], ended, limit)
    if not failing:
        rough = "" if all(outcome.precise for outcome in outcomes) else \
            "\n  (Your numbers have fewer than 64 bits and were compared to 1e-4; a filter needs float64.)"
        return Verdict(name, RIGHT, f"{name}: right, on {_tried(cases)}, "
                                    f"to {short(exercise.tolerance)} of the largest entry{rough}{_remarks(outcomes)}")
    return _wrong(exercise, cases, outcomes, expected, reasons)


def _reason(exercise, outcome, expected) -> str:
    if outcome.error is not None:
        return error_message(outcome.error)
    reason = differs(exercise, outcome, expected)
    if outcome.changed:
        changed = f"your function changes its argument {' and '.join(outcome.changed)}: work on a copy"
        return f"{reason}\nand {changed}" if reason else changed
    return reason


def _wrong(exercise, cases, outcomes, expected, reasons) -> Verdict:
    first = next(i for i, reason in enumerate(reasons) if reason)
    label, arguments = cases[first]
    lines = [f"{exercise.name}: wrong, on input {first + 1} of {len(cases)} ({label})"]
    lines += [argument(*pair) for pair in zip(exercise.arguments, arguments)]
    lines.append(reasons[first])
    pieces, guess = museum.recognise(exercise, cases, outcomes, expected)
    explanations = explain(exercise, cases, outcomes, expected, simple=bool(pieces))
    sames = [same(exercise, outcome, should) for outcome, should in zip(outcomes, expected)]
    where = right_parts.remarks(exercise, cases, outcomes, expected, sames)
    lines += [f"Most likely: {piece.name}. {piece.hint}" for piece in pieces]
    if pieces and explanations:
        lines.append("The same numbers come out " + ", or ".join(explanations[:2]) + ".")
    elif explanations:
        lines.append("Your result is what one gets " + ",\n  or ".join(explanations) + ".")
    elif not pieces:
        lines += [f"Perhaps: {guess.name}. {guess.hint}"] if guess else []
        lines += where
    lines += [_remarks(outcomes).strip()] if _remarks(outcomes) else []
    lines.append(f"To try this input: {exercise.name}(*check.{exercise.name}.failing)")
    mistake = next((piece.name for piece in [*pieces, *([] if explanations else [guess])] if piece), "")
    return Verdict(exercise.name, WRONG, "\n".join(lines), mistake or "; ".join(explanations[:1]),
                   tuple(map(copied, arguments)), located=bool(where) or outcomes[first].error is not None,
                   picture=picture_of(exercise, outcomes[first].values or [], expected[first]))


def _remarks(outcomes) -> str:
    found = dict.fromkeys(remark for outcome in outcomes for remark in outcome.remarks)
    return "".join(f"\n  {remark}" for remark in found)


def _blank(exercise, function, outcomes) -> Verdict:
    if outcomes[-1].calls:
        return Verdict(exercise.name, NOT_WRITTEN,
                       f"{exercise.name}: it calls {outcomes[-1].calls}, which is not written yet")
    if written(function) and outcomes[-1].nothing:
        return Verdict(exercise.name, WRONG, f"{exercise.name}: your function returned nothing on input "
                                             f"{len(outcomes)}: is `return` missing?")
    if written(function) and len(outcomes) == 1:
        return Verdict(exercise.name, NOT_WRITTEN, f"{exercise.name}: the line `raise NotImplementedError` is still "
                                                   "there, and nothing below it is run: delete it")
    if len(outcomes) == 1:
        return Verdict(exercise.name, NOT_WRITTEN, f"{exercise.name}: not written yet")
    return Verdict(exercise.name, NOT_WRITTEN, f"{exercise.name}: not written yet for every input: input "
                                               f"{len(outcomes)} gave None or NotImplementedError")


def _too_slow(exercise, case, ended, limit) -> Verdict:
    label, arguments = case
    still = "" if ended == "stopped" else "\nIt could not be stopped and still runs: restart the kernel."
    return Verdict(exercise.name, WRONG, "\n".join([
        f"{exercise.name}: wrong, still no answer after {limit:g} s, on the input ({label})",
        *(argument(*pair) for pair in zip(exercise.arguments, arguments)),
        f"Does a loop never end?{still}"]), failing=tuple(map(copied, arguments)))


def _tried(cases) -> str:
    labels = Counter(label for label, _ in cases)
    return f"{len(cases)} inputs ({'; '.join(f'{n} {label}' if n > 1 else label for label, n in labels.items())})"
