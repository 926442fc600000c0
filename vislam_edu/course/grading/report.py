"""What graded submissions are reported as: tables, a summary, feedback for each student.

    python -m vislam_edu exercises --report submissions --out results
"""

import dataclasses
import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from ...recordings.files import shown, write_csv, write_text
from ..checks.verdict import NOT_WRITTEN, RIGHT, WRONG
from ..exercises import EXERCISES
from . import borrowing, grading
from .grading import Result, Submission
from .points import file_name

_COLUMNS = (RIGHT, grading.BORROWED, WRONG, NOT_WRITTEN, grading.NO_VERDICT, grading.MISSING)
_FAILED = (WRONG, grading.BORROWED, grading.NO_VERDICT)
_FREQUENT = 10  # mistakes that the summary names
_EQUAL = 2  # equal answers of two students that the summary names; one alone can be chance


def table(submissions: Sequence[Submission]) -> str:
    """Counts for each notebook, and below it what is not right."""
    names = [shown(submission.name) for submission in submissions]
    width = max(map(len, names))
    lines = [" " * width + "".join(f"{column:>17}" for column in _COLUMNS)]
    for name, submission in zip(names, submissions):
        counts = Counter(result.status for result in submission.results)
        lines.append(name.ljust(width) + "".join(f"{counts[column]:>17}" for column in _COLUMNS))
        if submission.problem:
            lines.append(f"    {submission.problem}")
        for result in submission.results:
            if result.status != RIGHT:
                lines.append(f"    {result.exercise}: {result.status}" + _why(result))
    return "\n".join(lines)


def _why(result: Result) -> str:
    if result.mistake:
        return f": {result.mistake}"
    return f" ({result.detail})" if result.status == grading.NO_VERDICT and result.detail else ""


def summary(submissions: Sequence[Submission]) -> str:
    """For the class: how often each exercise came out how, most failures first; frequent mistakes; what to read."""
    counts: dict[str, Counter] = defaultdict(Counter)
    mistakes: Counter = Counter()
    for result in _all_results(submissions):
        counts[result.exercise][result.status] += 1
        if result.status == WRONG and result.mistake:
            mistakes[result.exercise, result.mistake] += 1
    lines = [f"{'exercise':30}" + "".join(f"{column:>17}" for column in _COLUMNS)]
    lines += [f"{name:30}" + "".join(f"{counts[name][column]:>17}" for column in _COLUMNS)
              for name in sorted(counts, key=lambda name: (
                  -sum(counts[name][status] for status in _FAILED), list(EXERCISES).index(name)))]
    lines += ["", "most frequent mistakes"] if mistakes else []
    lines += [f"{count:5}  {name}: {mistake}" for (name, mistake), count in mistakes.most_common(_FREQUENT)]
    reasons = read_these(submissions)
    lines += ["", "read these"] if reasons else []
    lines += [f"  {shown(name)}: {reason}" for name, reason in reasons]
    return "\n".join(lines)


def read_these(submissions: Iterable[Submission]) -> list[tuple[str, str]]:
    """(student or notebook, why a teacher should look at it)."""
    submissions = list(submissions)
    found = [(submission.name, f"{result.exercise} is borrowed: {result.mistake}") for submission in submissions
             for result in submission.results if result.status == grading.BORROWED]
    found += [(submission.name, note) for submission in submissions for note in submission.notes]
    return found + [(f"{one} and {other}", f"the same code in {len(equal)} of {both}: {', '.join(equal)}")
                    for one, other, equal, both in _similar(submissions) if len(equal) >= _EQUAL]


def _similar(submissions: Iterable[Submission]) -> list[tuple[str, str, list[str], int]]:
    answers: dict[str, dict[str, str]] = defaultdict(dict)
    for submission in submissions:
        answers[submission.student] |= submission.forms
    return borrowing.pairs(answers)


def _all_results(submissions: Iterable[Submission]) -> list[Result]:
    return [result for submission in submissions for result in submission.results]


def write(submissions: Sequence[Submission], folder: Path) -> None:
    """Write what a teacher and the students get into a folder.

    exercises.csv : one row for each exercise of each notebook; exercises.json : the same in full. matrix.csv : a row
    for each student and a column for each exercise. similar.csv : pairs of students with the same code. summary.txt :
    see `summary`. feedback/STUDENT.md : what the checks printed. Where a notebook holds a capstone, capstone.csv has
    one row for each drive that its filter was judged on.
    """
    rows: list[list] = []
    for submission in submissions:
        if submission.problem:
            rows.append([submission.name, "", "", submission.problem, ""])
        rows += [[submission.name, result.chapter, result.exercise, result.status, result.mistake]
                 for result in submission.results]
    write_csv(folder / "exercises.csv", ["notebook", "chapter", "exercise", "status", "mistake"], rows)
    scores = [{"notebook": submission.name} | row for submission in submissions for result in submission.results
              if result.score for row in result.score["drives"]]
    if scores:
        columns = list(dict.fromkeys(key for score in scores for key in score))
        write_csv(folder / "capstone.csv", columns, ([score.get(key) for key in columns] for score in scores))
    content = [{"notebook": shown(submission.name), "problem": submission.problem, "notes": submission.notes,
                "exercises": [{"chapter": result.chapter} | dataclasses.asdict(result)
                              for result in submission.results]} for submission in submissions]
    write_text(folder / "exercises.json", json.dumps(content, indent=2, ensure_ascii=False) + "\n")
    write_text(folder / "summary.txt", summary(submissions) + "\n")

    students: dict[str, list[Submission]] = defaultdict(list)
    for submission in submissions:
        students[submission.student].append(submission)
    found = {result.exercise for result in _all_results(submissions)}
    columns = [name for name in EXERCISES if name in found]
    write_csv(folder / "matrix.csv", ["student", *columns], (
        [student, *({result.exercise: result.status for result in _all_results(own)}.get(name, "") for name in columns)]
        for student, own in students.items()))
    write_csv(folder / "similar.csv", ["student", "other", "equal", "both wrote", "exercises"], (
        [one, other, len(equal), both, " ".join(equal)] for one, other, equal, both in _similar(submissions)))
    (folder / "feedback").mkdir(exist_ok=True)
    used: set[str] = set()
    for student, own in students.items():
        name = file_name(student)
        while name.lower() in used:  # two names may differ in what a file name cannot hold
            name += "_"
        used.add(name.lower())
        write_text(folder / "feedback" / f"{name}.md", feedback(student, own) + "\n")


def feedback(student: str, submissions: Iterable[Submission]) -> str:
    """What a student gets back, as Markdown: each exercise with its status and what the check printed."""
    lines = [f"# {_escaped(student)}"]
    for submission in submissions:
        lines += ["", f"## {_escaped(submission.name)}"]
        if submission.problem:
            lines += ["", f"The notebook did not run to its end: {_escaped(submission.problem)}."]
        for result in submission.results:
            lines += ["", f"### {result.exercise}: {result.status}"]
            if result.status == grading.MISSING:
                lines += ["", "The notebook has no cell that checks this exercise."]
            elif result.detail and result.status != RIGHT:
                fence = "`" * max(3, 1 + max(map(len, re.findall("`+", result.detail)), default=0))
                lines += ["", f"{fence}text", result.detail, fence]
            if result.score:
                lines += ["", "| drive | ATE (m) | agreed filter | NEES | agreed filter | verdict |", 6 * "|---" + "|"]
                lines += [f"| {row['drive']} | " + " | ".join(
                    "" if row[key] is None else f"{row[key]:.2f}" for key in (
                        "mine_ate", "agreed_ate", "mine_nees", "agreed_nees"))
                    + f" | {_escaped(row['problem'] or 'like the agreed filter, or better')} |"
                    for row in result.score["drives"]]
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Text in which Markdown and HTML see nothing but text."""
    return re.sub(r"([\\`*_{}\[\]()#+!|<>&])", r"\\\1", shown(text))
