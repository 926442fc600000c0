"""The clinic: a patient with an unlabelled fault, tests to order, and an answer that is scored.

    patient = clinic.Patient(student=1234, number=1, level=1)
    patient.order("numbers")
    print(patient.sheet())
    print(patient.answer("predicted covariance", "factor", evidence="predict"))

A patient is a filter or a recording with one fault, sometimes two, sometimes none (`patients`). The tests, and what
healthy patients read in them, are in `clinic_tests`. Whoever reads the source can look the answer up: an examination
(`examination`) takes a secret key, and shows readings only.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from ...belief import Step
from ...plots.text import on_a_page
from . import clinic_tests
from .clinic_tests import CLEARED_TOGETHER, TESTS, Readings, bands, outside, read
from .patients import FAULTS, HEALTHY, KINDS, PIECES, Build, Drawn, draw, stream

BUDGETS = {1: 11, 2: 8, 3: 12}
SUSPECTS = {1: 6}  # at level 1 so many pieces are named; otherwise all are
HINT_PRICE = 2
FRESH = 6  # seeds on which evidence has to hold again
SEPARATES_P, SEPARATES_SIGMAS = 0.001, 3.0
WORSE = 1.5  # times the healthy RMSE that a cured patient may have, beyond the scatter of the healthy ones


class BudgetError(ValueError):
    """A test, or a hint, that costs more than is left."""


@dataclass(frozen=True)
class Score:
    """What an answer scored: out of 10 the sum of five parts; `remarks` says why.

    diffs : of each fault that is an edit of the package's code, the wrong lines (-) and the right ones (+).
    """

    piece: float
    kind: float
    evidence: float
    cure: float
    thrift: float
    truth: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...] = ()
    diffs: tuple[str, ...] = ()

    @property
    def total(self) -> float:
        return self.piece + self.kind + self.evidence + self.cure + self.thrift

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {getattr(self, name):.3g} of {most}" for name, most in
                          (("piece", 2), ("kind", 1), ("evidence", 3), ("cure", 3), ("thrift", 1)))
        truth = "; ".join(f"{piece}: {kind}" for piece, kind in self.truth)
        return "\n".join([f"{self.total:.3g} of 10 ({parts})", f"It was {truth}.", *self.diffs, *self.remarks])


class Patient:
    """One patient: order tests, read the sheet, answer once. recording : its `Drive`, right or wrong.

    student : number or name. number : of the patient, from 1. level : 1 one fault, six suspects; 2 healthy is possible,
    a smaller budget; 3 also two faults, and recordings. key : secret of an examination, "" for practice.
    """

    def __init__(self, student: int | str, number: int, level: int, key: str = "") -> None:
        drawn = draw(student, number, level, key)
        self.student, self.number, self.level = student, number, level
        self.budget = BUDGETS[level]
        self.readings: dict[str, Readings] = {}
        self.score: Score | None = None
        rng = stream(key, "suspects", student, number, level)
        self.suspects = _suspects(drawn, level, rng)

        # In closures: no attribute of the patient says what it has.
        def examine(name: str, fresh: int = 0) -> Readings:
            return read(name, drawn.build, drawn.seed + 1000 * fresh)

        def judge(findings, evidence, cure) -> Score:
            return _score(self, drawn, examine, findings, evidence, cure)

        def steps() -> Iterable[Step]:
            return clinic_tests.steps(drawn.build, clinic_tests.base_drive(drawn.seed), drawn.seed)

        def hint() -> str:
            seen_by = FAULTS[drawn.faults[0]].seen_by
            return f"order {' or '.join(map(repr, seen_by))}" if seen_by else "three tests without a finding say much"

        self._examine, self._judge, self._steps, self._hint = examine, judge, steps, hint
        # Without its history, which says what was planted.
        self.recording = drawn.build.recording(clinic_tests.base_drive(drawn.seed)).replace(history=())

    def order(self, *names: str) -> None:
        """Order tests, by their names in `TESTS`. Raises BudgetError when too little is left, ValueError for a name."""
        for name in names:
            if name not in TESTS:
                raise ValueError(f"there is no test {name!r}: {', '.join(TESTS)}")
            if name not in self.readings:
                self._pay(TESTS[name].price, f"the test {name!r}")
                self.readings[name] = self._examine(name)

    def steps(self) -> Iterable[Step]:
        """The filter's `Step`s over its recording, for `Explorer(patient.steps(), patient.recording)`; costs 1."""
        self._pay(1, "the steps of a drive")
        return self._steps()

    def hint(self) -> str:
        """Names a test that separates this patient from healthy ones; costs `HINT_PRICE`."""
        self._pay(HINT_PRICE, "a hint")
        return self._hint()

    def _pay(self, price: int, what: str) -> None:
        if price > self.budget:
            raise BudgetError(f"{what} costs {price}, and {self.budget} is left")
        self.budget -= price

    def abnormal(self, name: str) -> list[str]:
        """The readings of an ordered test that are outside their bands."""
        return outside(name, self.readings[name])

    @property
    def left(self) -> list[str]:
        """The suspects that no ordered test has cleared; "nothing" only while no reading is outside its band."""
        clean = {name for name in self.readings if not self.abnormal(name)}
        cleared = {piece for name in clean for piece in TESTS[name].clears}
        cleared |= {piece for piece, tests in CLEARED_TOGETHER.items() if clean.issuperset(tests)}
        if len(clean) < len(self.readings):
            cleared.add(HEALTHY)
        return [piece for piece in self.suspects if piece not in cleared]

    def sheet(self) -> str:
        """The lab sheet: each reading against the band of healthy patients, the suspects left, and the budget."""
        lines = [f"patient {self.number} of level {self.level}", f"{'':52}{'reads':>9}   healthy"]
        for name, readings in self.readings.items():
            lines.append(f"{name}: {TESTS[name].text}")
            for key, value in readings.items():
                low, high = bands()[name][key].limits
                mark = "" if low <= value <= high else "   <"
                lines.append(f"  {key:50}{_number(value):>9}   {_number(low)} to {_number(high)}{mark}")
        return "\n".join([*lines, on_a_page(f"suspects left: {', '.join(self.left)}"), f"budget left: {self.budget}"])

    def answer(self, piece: str | tuple[str, ...], kind: str | tuple[str, ...], evidence: str | tuple[str, ...] = "",
               cure: Mapping[str, Any] | None = None) -> Score:
        """Answer, once. piece, kind : of `PIECES` and `KINDS`; for two faults tuples of two, and so for evidence.

        evidence : the name of an ordered test that shows the fault; for "nothing" all ordered tests count.
        cure : {seam of `Build`: what is to stand there}; by default the package's own for each piece named rightly.
        Raises ValueError for a second answer or an unknown word.
        """
        if self.score is not None:
            raise ValueError("this patient has been answered")
        pieces, kinds, tests = _tuple(piece), _tuple(kind), _tuple(evidence)
        unknown = [w for w in pieces if w not in PIECES] + [w for w in kinds if w not in KINDS]
        if unknown or len(pieces) != len(kinds):
            raise ValueError(f"pieces are {', '.join(PIECES)}; kinds are {', '.join(KINDS)}; got {pieces} and {kinds}")
        tests = tests + ("",) * (len(pieces) - len(tests))
        self.score = self._judge(tuple(zip(pieces, kinds)), tests, cure)
        return self.score

    def __repr__(self) -> str:
        return f"Patient({self.student!r}, {self.number}, level {self.level})"


def _tuple(value) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else tuple(value)


def _number(value) -> str:
    return "> 100000" if value > 1e5 else f"{value:.3g}"


def _suspects(drawn: Drawn, level: int, rng) -> list[str]:
    """What may be wrong: at level 1 six pieces, the right one among them; else everything."""
    if level not in SUSPECTS:
        return list(PIECES)
    named = {piece for name in drawn.faults for piece, _ in FAULTS[name].answers}
    others = [piece for piece in PIECES if piece not in named]
    chosen = named | set(rng.choice(others, SUSPECTS[level] - len(named), replace=False).tolist())
    return [piece for piece in PIECES if piece in chosen]


# --- scoring --------------------------------------------------------------------------------------------------

def separates(name: str, key: str, readings: list[float]) -> bool:
    """Whether readings differ from those of healthy patients: Welch p < 0.001, means 3 pooled deviations apart.

    Where neither scatters, a difference outside the band counts.
    """
    band, logs = bands()[name][key], np.log(readings)
    if all(band.holds(value) for value in readings):
        return False
    sigma = float(logs.std(ddof=1))
    pooled = max(((sigma**2 + band.sigma**2) / 2) ** 0.5, clinic_tests.FLOOR / clinic_tests.WIDTH)
    p = stats.ttest_ind_from_stats(logs.mean(), max(sigma, 1e-3), len(logs), band.mean, max(band.sigma, 1e-3),
                                   band.runs, equal_var=False).pvalue
    return bool(p < SEPARATES_P and abs(logs.mean() - band.mean) > SEPARATES_SIGMAS * pooled)


def evident(name: str, examine: Callable[[str, int], Readings]) -> bool:
    """Whether a test separates a patient from healthy ones on fresh seeds, in any of its readings."""
    fresh = [examine(name, i) for i in range(1, FRESH + 1)]
    return any(separates(name, key, [one[key] for one in fresh]) for key in fresh[0])


def _score(patient: Patient, drawn: Drawn, examine, findings, evidence, cure) -> Score:
    truth = tuple((FAULTS[name].piece, FAULTS[name].kind) for name in drawn.faults)
    if drawn.healthy:
        return _score_healthy(patient, truth, findings)
    remarks = []
    found, kinds, proofs = 0, 0, 0
    for name in drawn.faults:
        pieces = [piece for piece, _ in FAULTS[name].answers]
        named = [finding for finding in findings if finding[0] in pieces]
        found += bool(named)
        kinds += any(finding in FAULTS[name].answers for finding in named)
    for test, (piece, _) in zip(evidence, findings):
        if not test:
            continue
        if not any(piece == right for name in drawn.faults for right, _ in FAULTS[name].answers):
            remarks.append(f"It was not {piece!r}, so {test!r} is no evidence of it.")
        elif test not in patient.readings:
            remarks.append(f"{test!r} was not ordered: no evidence.")
        elif not evident(test, examine):
            remarks.append(f"{test!r} does not separate this patient on fresh seeds: no evidence.")
        else:
            proofs += 1
    n = max(len(drawn.faults), len(findings))
    if cure is None:
        cure = _undone(drawn, [piece for piece, _ in findings])
    cured = _cure(drawn, cure, [test for test in evidence if test in patient.readings], remarks) if found else 0
    thrift = found == n and patient.budget >= 1
    return Score(2 * found / n, kinds / n, 3 * min(proofs, n) / n, cured, float(thrift), truth, tuple(remarks),
                 tuple(seam.diff for seam in vars(drawn.build).values() if hasattr(seam, "diff")))


def _score_healthy(patient, truth, findings) -> Score:
    """"Nothing" needs three tests without a finding, one of them a bench."""
    right = findings == ((HEALTHY, HEALTHY),)
    tests = [name for name in patient.readings if not patient.abnormal(name)]
    proved = right and len(tests) >= 3 and any(TESTS[name].bench for name in tests)
    remarks = () if proved or not right else ("Healthy is an answer that needs three tests, one of them a bench.",)
    return Score(2.0 * right, 1.0 * right, 3.0 * proved, 3.0 * proved, float(proved and patient.budget >= 1), truth,
                 remarks)


def _undone(drawn: Drawn, pieces: list[str]) -> dict[str, Any]:
    """A cure: the package's own at the seams of those faults that one of the pieces names."""
    named = [FAULTS[name] for name in drawn.faults if any(piece in pieces for piece, _ in FAULTS[name].answers)]
    return {seam: getattr(Build(), seam) for fault in named for seam in fault.changes(1.0)}


def _cure(drawn: Drawn, cure: Mapping[str, Any], evidence: list[str], remarks: list[str]) -> float:
    """3 points: every bench in its bands; the evidence back in its band; RMSE and sigma no worse than healthy."""
    build = replace(drawn.build, **cure)
    seed = drawn.seed + 77
    benches = not any(outside(name, read(name, build, seed)) for name, test in TESTS.items() if test.bench)
    back = bool(evidence) and not any(outside(name, read(name, build, seed)) for name in evidence)
    rmse, sigma = _rmse_and_sigma(build, seed)
    healthy = _rmse_and_sigma(Build(), seed)
    no_worse = rmse <= WORSE * healthy[0] and healthy[1] / WORSE <= sigma <= WORSE * healthy[1]
    for right, remark in ((benches, "After the cure a bench is still outside its band."),
                          (back, "The evidence did not return to its band, or there was none."),
                          (no_worse, "After the cure RMSE or sigma is not that of a healthy patient.")):
        if not right:
            remarks.append(remark)
    return float(benches + back + no_worse)


def _rmse_and_sigma(build: Build, seed: int) -> tuple[float, float]:
    """m: RMSE of the position, and its mean standard deviation as the filter states it."""
    drive = clinic_tests.base_drive(seed)
    run = clinic_tests.driven(build, drive, seed)
    if run.problem:
        return np.inf, np.inf
    variances = np.trace(run.covariance[:, :3, :3], axis1=1, axis2=2)
    return float(clinic_tests.numbers_of(run, drive)["RMSE"]), float(np.sqrt(max(np.mean(variances), 0)))
