"""For teachers: submissions are graded, and the cells are what nbgrader expects."""

import csv
import importlib.util
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat import v4
from whole import WHOLE

import notebooks
from vislam_edu import cli as command_line
from vislam_edu.course.checks import museum
from vislam_edu.course.checks.verdict import NOT_WRITTEN, WRONG
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import cells, grading

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
WRONG_ONES = {name: exercise for name, exercise in EXERCISES.items() if WHOLE or exercise.chapter <= 2}
KERNELSPEC = {"kernelspec": {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}}


def command(*arguments):
    """`python -m vislam_edu exercises` with these arguments; its exit status."""
    return command_line.main(["exercises", *map(str, arguments)])


def write(path, code):
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(v4.new_notebook(cells=code, metadata=KERNELSPEC), path)
    return path


def filled(exercise, answer):
    """The two cells of an exercise, the marked region of the stub replaced by `return answer(...)`."""
    stub, test = cells.pair(exercise)
    region = stub.source[stub.source.index("# BEGIN"):stub.source.index("# END")]
    call = f"return {answer}({', '.join(exercise.arguments)})\n    "
    stub.source = "from vislam_edu.course.exercises import EXERCISES\n\n\n" + stub.source.replace(region, call)
    return [stub, test]


def joined(lists):
    return list(itertools.chain.from_iterable(lists))


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A folder with three notebooks over all exercises: answered, blank, and wrong in a known way; and its report.

    Wrong in two chapters only, unless the long version is asked for: `test_exercises` judges every piece of the museum.
    """
    folder = tmp_path_factory.mktemp("submissions")
    exercises = EXERCISES.values()
    write(folder / "anna" / "right.ipynb",
          joined(filled(e, f"EXERCISES[{e.name!r}].reference") for e in exercises))
    write(folder / "ben" / "stubs.ipynb", joined(cells.pair(e) for e in exercises))
    write(folder / "cleo" / "museum.ipynb",
          joined(filled(e, f"EXERCISES[{e.name!r}].mistakes[-1].function") for e in WRONG_ONES.values()))
    write(folder / ".ipynb_checkpoints" / "right.ipynb", [])
    out = tmp_path_factory.mktemp("report")
    assert command("--report", folder, "--out", out) == 0
    return out


def by_notebook(out, name):
    with open(out / "exercises.csv", encoding="utf-8", newline="") as file:
        return {row["exercise"]: row for row in csv.DictReader(file) if row["notebook"] == name}


def test_a_notebook_filled_from_the_package_is_borrowed(reported):
    found = by_notebook(reported, "anna/right.ipynb")
    assert list(found) == list(EXERCISES)
    assert {row["status"] for row in found.values()} == {grading.BORROWED}


def test_a_notebook_of_stubs_is_not_written_yet(reported):
    found = by_notebook(reported, "ben/stubs.ipynb")
    assert list(found) == list(EXERCISES)
    assert {row["status"] for row in found.values()} == {NOT_WRITTEN}


def test_a_notebook_of_museum_pieces_is_told_each_mistake_by_name(reported):
    found = by_notebook(reported, "cleo/museum.ipynb")
    assert {name: row["mistake"] for name, row in found.items()} == {
        name: exercise.mistakes[-1].name for name, exercise in WRONG_ONES.items()}
    assert {row["status"] for row in found.values()} == {WRONG}


def test_the_report_holds_the_same_in_both_formats(reported):
    content = json.loads((reported / "exercises.json").read_text(encoding="utf-8"))
    assert [entry["notebook"] for entry in content] == ["anna/right.ipynb", "ben/stubs.ipynb", "cleo/museum.ipynb"]
    for entry in content:
        assert entry["problem"] == ""
        rows = by_notebook(reported, entry["notebook"])
        assert {e["exercise"]: (str(e["chapter"]), e["status"], e["mistake"]) for e in entry["exercises"]} == {
            name: (row["chapter"], row["status"], row["mistake"]) for name, row in rows.items()}
    assert content[2]["exercises"][0]["detail"].startswith("so3_hat: wrong, on input ")


HAT = EXERCISES["so3_hat"]


@pytest.mark.parametrize(("name", "words"), [("missing", "no such notebook"), ("", "no notebooks in this folder")])
def test_a_path_without_notebooks_is_named(tmp_path, capsys, name, words):
    assert command("--report", tmp_path / name, "--out", tmp_path / "out") == command_line.BAD_INPUT
    assert words in capsys.readouterr().err


# --- the table and the cells ------------------------------------------------------------------------------


def test_one_command_prints_the_museum(capsys):
    assert command("--museum") == 0
    printed = capsys.readouterr().out
    assert printed == museum.table() + "\n"
    flat = " ".join(printed.split())
    for exercise in EXERCISES.values():
        for mistake in exercise.mistakes:
            assert f"{mistake.name} {mistake.hint}" in flat


def test_stubs_of_a_chapter_are_printed(capsys):
    assert notebooks.main(["--stubs", "3"]) == 0
    printed = capsys.readouterr().out
    for exercise in EXERCISES.values():
        assert (exercise.stub.rstrip() in printed) == (exercise.chapter == 3)


@pytest.mark.parametrize("arguments", [
    [], ["--report", "a", "--limit", "0"], ["--museum", "--report", "1"]], ids=" ".join)
def test_bad_arguments_are_refused(arguments, capsys):
    with pytest.raises(SystemExit) as error:
        command(*arguments)
    assert error.value.code == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("python -m vislam_edu exercises: ")
    assert line.endswith("(--help explains)")


def test_cell_ids_are_unique_and_valid():
    code = joined(cells.pair(exercise) for exercise in EXERCISES.values())
    nbformat.validate(v4.new_notebook(cells=code))
    assert len({cell.id for cell in code}) == len({cell.metadata.nbgrader.grade_id for cell in code}) == len(code)


def test_refreshing_a_notebook_brings_its_exercise_cells_up_to_date(tmp_path, capsys):
    stub, test = cells.pair(HAT)
    helper, text = v4.new_code_cell("def project(x):\n    return x"), v4.new_markdown_cell("check.so3_hat(so3_hat)")
    path = write(tmp_path / "a.ipynb", [v4.new_code_cell("def so3_hat(x):\n    # BEGIN SOLUTION"), helper, text,
                                        v4.new_code_cell("check.so3_hat(so3_hat)"), *cells.pair(EXERCISES["odot"])])
    assert notebooks.main(["--refresh", str(path)]) == 0
    assert "changed so3_hat, check_so3_hat\n" in capsys.readouterr().out
    refreshed = nbformat.read(path, as_version=4).cells
    assert [(cell.source, cell.metadata) for cell in refreshed[:4]] == [
        (cell.source, cell.metadata) for cell in (stub, helper, text, test)]
    before = path.read_bytes()
    assert notebooks.main(["--refresh", str(path)]) == 0
    assert "changed nothing" in capsys.readouterr().out
    assert path.read_bytes() == before


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_exercise_cells_of_the_notebooks_are_those_of_the_registry(path):
    notebook = nbformat.read(path, as_version=4)
    assert cells.refresh(notebook) == [], f"python tools/notebooks.py --refresh {path}"
    called = joined(grading._CALL.findall(cell.source) for cell in notebook.cells if cell.cell_type == "code")
    graded = [cell.metadata.nbgrader.grade_id for cell in notebook.cells if "nbgrader" in cell.metadata]
    assert sorted(graded) == sorted([*called, *(f"check_{name}" for name in called)])


# --- nbgrader ---------------------------------------------------------------------------------------------

needs_nbgrader = pytest.mark.skipif(importlib.util.find_spec("nbgrader") is None,
                                    reason="nbgrader is not installed: python -m pip install nbgrader")


def nbgrader(*arguments, folder):
    """What one nbgrader command printed. It calls programs of its own environment by name: they go onto the path."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run([sys.executable, "-m", "nbgrader", *arguments], cwd=folder, capture_output=True, text=True,
                          timeout=300, env=os.environ | {"PATH": path})
    return done.stdout + done.stderr


@needs_nbgrader
def test_nbgrader_validates_answers_and_refuses_stubs(tmp_path):
    chosen = [EXERCISES[name] for name in ("so3_hat", "projection_jacobian", "joint_update")]
    write(tmp_path / "answers.ipynb", joined(filled(e, f"EXERCISES[{e.name!r}].reference") for e in chosen))
    write(tmp_path / "stubs.ipynb", joined(cells.pair(e) for e in chosen))
    write(tmp_path / "one_wrong.ipynb", joined(filled(e, f"EXERCISES[{e.name!r}].reference") for e in chosen[:2]) +
          filled(chosen[2], "EXERCISES['joint_update'].mistakes[0].function"))
    assert "Success! Your notebook passes all the tests." in nbgrader("validate", "answers.ipynb", folder=tmp_path)
    assert "VALIDATION FAILED ON 3 CELL(S)" in nbgrader("validate", "stubs.ipynb", folder=tmp_path)
    failed = nbgrader("validate", "one_wrong.ipynb", folder=tmp_path)
    assert "VALIDATION FAILED ON 1 CELL(S)" in failed
    assert "interleaved and grouped orders mixed" in failed


@needs_nbgrader
def test_nbgrader_releases_the_stubs_and_grades_what_comes_back(tmp_path):
    (tmp_path / "nbgrader_config.py").write_text('get_config().CourseDirectory.course_id = "slam"\n')
    pairs = [cells.pair(HAT), filled(EXERCISES["odot"], "EXERCISES['odot'].reference")]
    write(tmp_path / "source" / "ex1" / "01.ipynb", joined(pairs))
    assert "SystemExit" not in nbgrader("generate_assignment", "ex1", folder=tmp_path)
    released = nbformat.read(tmp_path / "release" / "ex1" / "01.ipynb", as_version=4)
    assert HAT.statement.splitlines()[0] in released.cells[0].source
    assert "raise NotImplementedError" in released.cells[2].source
    assert "reference" not in released.cells[2].source

    released.cells[2].source = pairs[1][0].source
    write(tmp_path / "submitted" / "anna" / "ex1" / "01.ipynb", [])
    nbformat.write(released, tmp_path / "submitted" / "anna" / "ex1" / "01.ipynb")
    nbgrader("autograde", "ex1", "--create", folder=tmp_path)
    nbgrader("export", folder=tmp_path)
    with open(tmp_path / "grades.csv", encoding="utf-8", newline="") as file:
        [row] = csv.DictReader(file)
    assert (float(row["raw_score"]), float(row["max_score"])) == (1, 2)
