"""The verdict on an answer: right, not written yet, or wrong, and then why."""

from collections import Counter
from dataclasses import dataclass

from . import museum
from .comparing import argument, differs
from .exercise import Exercise, short
from .running import LIMIT, answers, arrays, copied, error_message

RIGHT, NOT_WRITTEN, WRONG = "right", "not written yet", "wrong"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a check found.

    status : RIGHT, NOT_WRITTEN or WRONG. text : what the student reads. mistake : its name in the museum where
    it was recognised, else "". failing : the arguments of the first input that came out wrong, else None.
    """

    exercise: str
    status: str
    text: str
    mistake: str = ""
    failing: tuple | None = None

    @property
    def right(self) -> bool:
        return self.status == RIGHT


def judge(exercise: Exercise, function, limit=LIMIT) -> Verdict:
    """Put an answer to all inputs of its exercise. limit : s, for all of them together."""
    name = exercise.name
    if not callable(function):
        return Verdict(name, WRONG, f"{name}: give the function itself, without calling it: check.{name}({name})")
    cases = exercise.inputs()
    expected = [arrays(exercise.expected(*map(copied, arguments)), exercise.outputs)[0] for _, arguments in cases]
    outcomes, ended = answers(exercise, function, cases, limit)
    if any(outcome.blank for outcome in outcomes):
        return _blank(exercise, outcomes)

    reasons = [_reason(exercise, outcome, should) for outcome, should in zip(outcomes, expected)]
    failing = [i for i, reason in enumerate(reasons) if reason]
    if ended and not failing:
        return _too_slow(exercise, cases[len(outcomes)], ended, limit)
    if not failing:
        rough = "" if all(outcome.precise for outcome in outcomes) else \
            "\n  (Your numbers have fewer than 64 bits and were compared to 1e-4; a filter needs float64.)"
        return Verdict(name, RIGHT, f"{name}: right, on {_tried(cases)}, "
                                    f"to {short(exercise.tolerance)} of the largest entry{rough}")
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
    mistake, sure = museum.recognise(exercise, cases, outcomes, expected)
    if mistake:
        lines.append(f"{'Most likely' if sure else 'Perhaps'}: {mistake.name}. {mistake.hint}")
    lines.append(f"To try this input: {exercise.name}(*check.{exercise.name}.failing)")
    return Verdict(exercise.name, WRONG, "\n".join(lines), mistake.name if mistake else "",
                   tuple(map(copied, arguments)))


def _blank(exercise, outcomes) -> Verdict:
    if outcomes[-1].calls:
        return Verdict(exercise.name, NOT_WRITTEN,
                       f"{exercise.name}: it calls {outcomes[-1].calls}, which is not written yet")
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
