"""The two notebook cells of an exercise, with the metadata by which nbgrader knows them.

The stub is a solution cell: `nbgrader generate_assignment` keeps its signature and docstring and empties what
stands between the marks. The check is a locked test cell worth a point; under nbgrader it raises when it is not
passed.
"""

import re
import warnings
from pathlib import Path
from typing import Any

from ...recordings.files import shown
from ..checks.exercise import Exercise
from ..exercises import EXERCISES
from . import submission

POINTS = 1

_MARK = "BEGIN SOLUTION"
_STUB_OR_CHECK = re.compile(r"^(?:def (\w+)\(|(?:from vislam_edu\.course\.exercises import check\s+)?check\.(\w+)\()")


def pair(exercise: Exercise) -> list:
    """The stub cell and the check cell as notebook nodes, their ids made of the exercise's name."""
    from nbformat import v4

    name = exercise.name
    test = f"from vislam_edu.course.exercises import check\n\ncheck.{name}({name})"
    common = {"schema_version": 3, "task": False}
    return [
        v4.new_code_cell(exercise.stub.rstrip(), id=name.replace("_", "-"), metadata={"nbgrader": common | {
            "grade": False, "grade_id": name, "locked": False, "solution": True}}),
        v4.new_code_cell(test, id="check-" + name.replace("_", "-"), metadata={"nbgrader": common | {
            "grade": True, "grade_id": f"check_{name}", "locked": True, "points": POINTS, "solution": False}}),
    ]


def read(path: Path) -> tuple[str, Any]:
    """The text of a notebook file and the notebook. Raises OSError, and ValueError for no valid one of version 4."""
    import nbformat

    text = submission.read(path)
    submission.code_cells(text)  # what is no notebook at all gets a sentence of ours
    try:
        with warnings.catch_warnings(action="ignore"):  # about cells without ids
            notebook = nbformat.reader.reads(text)
            nbformat.validate(notebook)
    except Exception as error:  # nbformat raises what its parsers raise
        raise ValueError(f"not a valid notebook ({shown(getattr(error, 'message', error))})") from None
    return text, notebook


def refresh(notebook) -> list[str]:
    """Bring the exercise cells of a notebook up to date, in place: their text and nbgrader's metadata.

    For authors; an answer in a stub cell is lost. A stub is a cell that begins with the function's `def` and holds
    nbgrader's mark; a check begins with its call. Returns the grade ids of the cells that changed.
    """
    changed = []
    for cell in notebook.cells:
        found = _STUB_OR_CHECK.match(cell.source)
        if found is None or cell.cell_type != "code" or (found[1] and _MARK not in cell.source):
            continue
        exercise = EXERCISES.get(found[1] or found[2])
        if exercise:
            wanted = pair(exercise)[0 if found[1] else 1]
            if (cell.source, cell.metadata.get("nbgrader")) != (wanted.source, wanted.metadata.nbgrader):
                cell.source, cell.metadata["nbgrader"] = wanted.source, wanted.metadata.nbgrader
                changed.append(wanted.metadata.nbgrader.grade_id)
    return changed
