"""The exercises from the shell: submissions graded, the museum as a table, stubs for authors.

    python -m vislam_edu exercises --report submissions --out results
    python -m vislam_edu exercises --museum
    python -m vislam_edu exercises --stubs 3
"""

import csv
import dataclasses
import json
from collections import Counter
from pathlib import Path

from ..recordings.files import replacing
from . import cells, grading
from .exercise import EXERCISES
from .verdict import NOT_WRITTEN, RIGHT, WRONG

_COLUMNS = (RIGHT, WRONG, NOT_WRITTEN, grading.NO_VERDICT)


def stubs(chapter) -> str:
    """The cells of a chapter's exercises as text."""
    chosen = [exercise for exercise in EXERCISES.values() if exercise.chapter == chapter]
    return "\n\n\n".join(text for exercise in chosen for text in cells.source(exercise))


def refresh(path: Path) -> list[str]:
    """Bring the exercise cells of a notebook file up to date; returns the grade ids of those that changed."""
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    changed = cells.refresh(notebook)
    if changed:
        with replacing(path) as file:
            file.write((nbformat.writes(notebook) + "\n").encode())
    return changed


# --- submissions ------------------------------------------------------------------------------------------

def graded(path: Path, limit=grading.LIMIT) -> list[grading.Submission]:
    """Run the notebooks at a path one after the other, with a progress bar. limit : s, for each."""
    from tqdm import tqdm

    root = path if path.is_dir() else path.parent
    return [grading.grade(file, file.relative_to(root).as_posix(), limit)
            for file in tqdm(grading.notebooks(path), unit="notebook", leave=False, disable=None)]


def table(submissions) -> str:
    """Counts for each notebook, and below it what is not right."""
    width = max(len(submission.name) for submission in submissions)
    lines = [" " * width + "".join(f"{column:>17}" for column in _COLUMNS)]
    for submission in submissions:
        counts = Counter(result.status for result in submission.results)
        lines.append(submission.name.ljust(width) + "".join(f"{counts[column]:>17}" for column in _COLUMNS))
        if submission.problem:
            lines.append(f"    {submission.problem}")
        for result in submission.results:
            if result.status != RIGHT:
                lines.append(f"    {result.exercise}: {result.status}" + _why(result))
    return "\n".join(lines)


def _why(result) -> str:
    if result.mistake:
        return f": {result.mistake}"
    return f" ({result.detail})" if result.status == grading.NO_VERDICT and result.detail else ""


def write(submissions, folder: Path) -> None:
    """exercises.csv, one row for each exercise of each notebook, and exercises.json with the same in full.

    Where a notebook holds a capstone, capstone.csv has one row for each drive that its filter was judged on.
    """
    fields = ["notebook", "chapter", "exercise", "status", "mistake"]
    with open(folder / "exercises.csv", "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(fields)
        for submission in submissions:
            if submission.problem:
                rows.writerow([submission.name, "", "", submission.problem, ""])
            rows.writerows([submission.name, result.chapter, result.exercise, result.status, result.mistake]
                           for result in submission.results)
    scores = [{"notebook": submission.name} | row for submission in submissions for result in submission.results
              if result.score for row in result.score["drives"]]
    if scores:
        with open(folder / "capstone.csv", "w", newline="", encoding="utf-8") as file:
            table_of_scores = csv.DictWriter(file, list(scores[0]))
            table_of_scores.writeheader()
            table_of_scores.writerows(scores)
    content = [{"notebook": submission.name, "problem": submission.problem,
                "exercises": [{"chapter": result.chapter} | dataclasses.asdict(result)
                              for result in submission.results]} for submission in submissions]
    text = json.dumps(content, indent=2, ensure_ascii=False)
    (folder / "exercises.json").write_text(text + "\n", encoding="utf-8")
