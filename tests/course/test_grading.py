"""Submissions that misbehave: each ends in its own row, none in a traceback, a hang or the loss of other grades."""

import csv
import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import hostile
import pytest
from hostile import RIGHT_HAT, notebook

from vislam_edu import cli
from vislam_edu.course.checks.verdict import RIGHT, WRONG
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import collecting, grading, report, sandbox

posix = pytest.mark.skipif(os.name != "posix", reason="process groups and limits are those of POSIX")

# Some of each kind; `python tests/hostile.py` puts all of them, the weekly workflow too.
HAND_IN = [
    "forges the record", "a pipe for a record", "takes memory", "writes much", "a large integer", "a result that exits",
    "leaves a daemon", "ends its parent", "ends itself", "a row of signs", "a surrogate in a cell",
    "shadows with a folder", "\x1b[31mred", "=HYPERLINK(\"x\")", "is a pipe", "is a device", "leads nowhere", "nested"]


def statuses(entry):
    return {result["exercise"]: result["status"] for result in entry["exercises"]
            if result["status"] != grading.MISSING}


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """Hostile submissions, graded by one command; entries of exercises.json by student, folders, what was printed."""
    hostile.handed_in(folder := tmp_path_factory.mktemp("class"), HAND_IN)
    entries, printed = hostile.report(folder, out := tmp_path_factory.mktemp("grades"), 200)
    return entries, folder, out, printed


pytestmark = posix


@pytest.mark.parametrize("student", [*HAND_IN, "a good one"])
def test_what_goes_wrong_in_a_submission_stands_in_its_row_and_costs_nothing_else(graded, student):
    assert hostile.problem_of(student, graded[0]) == ""


def test_every_submission_has_its_row_and_nothing_is_left(graded):
    entries, folder, out, printed = graded
    assert len(entries) == len(list(folder.iterdir()))
    assert statuses(entries["not ? utf-8"]) == {"so3_hat": RIGHT}
    assert hostile.left_behind(folder, out, printed) == []


def test_lines_without_the_signature_are_nobodys(graded):
    assert statuses(graded[0]["forges the record"]) == {"so3_hat": RIGHT}
    assert graded[0]["forges the record"]["notes"] == ["its code has sys.argv"]


def test_a_formula_is_text_in_every_csv_file(graded):
    for name in ("exercises.csv", "matrix.csv"):
        with open(graded[2] / name, encoding="utf-8", newline="") as file:
            fields = [field for row in csv.reader(file) for field in row]
        assert any("HYPERLINK" in field for field in fields)
        assert not any(field.startswith(("=", "+", "-", "@")) for field in fields)


def test_the_matrix_has_a_row_for_each_student_and_a_column_for_each_exercise(graded):
    with open(graded[2] / "matrix.csv", encoding="utf-8", newline="") as file:
        rows = {row["student"]: row for row in csv.DictReader(file)}
    assert len(rows) == len(graded[0])
    first = rows["a good one"]
    assert list(first)[1:] == [name for name, exercise in EXERCISES.items() if exercise.chapter == 1]
    assert first["so3_hat"] == RIGHT
    assert {first[name] for name in list(first)[2:]} == {grading.MISSING}


def test_each_student_gets_feedback(graded):
    files = list((graded[2] / "feedback").iterdir())
    assert len(files) == len(graded[0])
    text = (graded[2] / "feedback" / "forges_the_record.md").read_text(encoding="utf-8")
    assert "### so3_hat: right" in text
    assert "### se3_hat: missing\n\nThe notebook has no cell that checks this exercise." in text


def test_the_summary_counts_exercises_and_mistakes(tmp_path):
    def of(student, status, mistake=""):
        return grading.Submission(f"{student}/a.ipynb", [grading.Result("odot", status, mistake)])

    found = report.summary([of("a", WRONG, "sign"), of("b", WRONG, "sign"), of("c", WRONG, "other"), of("d", RIGHT)])
    assert [line.split() for line in found.splitlines()[1:]] == [
        ["odot", "1", "0", "3", "0", "0", "0"], [], ["most", "frequent", "mistakes"], ["2", "odot:", "sign"],
        ["1", "odot:", "other"]]


def test_markup_in_feedback_is_text():
    result = grading.Result("odot", WRONG, "", "````\n<script>")
    text = report.feedback("<b>[a](b)", [grading.Submission("a", [result])])
    assert text.startswith("# \\<b\\>\\[a\\]\\(b\\)\n")
    assert "\n`````text\n````\n<script>\n`````" in text


# --- one at a time ----------------------------------------------------------------------------------------


def test_a_notebook_that_never_ends_is_stopped_with_its_children(tmp_path, monkeypatch):
    code = ("import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)'])\n"
            "open('child', 'w')\n" + hostile.STUBBORN)
    path = notebook(tmp_path, [RIGHT_HAT, code])
    # The limit is over once the child is there, however long the machine takes for that.
    monkeypatch.setattr(grading, "time", SimpleNamespace(
        monotonic=lambda: time.monotonic() + 1000 * bool((tmp_path / "child").exists())))
    found = grading.grade(grading.read(path, "a"), limit=900)
    assert found.problem == "stopped after 900 s"
    assert found.results[0] == grading.Result("so3_hat", RIGHT, "", found.results[0].detail)
    assert hostile.running_in(tmp_path) == []


def test_a_broken_cell_costs_only_its_own_exercise_and_secrets_stay_out(tmp_path, monkeypatch):
    monkeypatch.setenv("TOKEN", "secret")
    curious = "import os\ndef adjoint(T):\n    raise ValueError(os.environ.get('TOKEN'))\n"
    path = notebook(tmp_path, ["def odot(point)\n    return 1", RIGHT_HAT, "check.odot(odot)",
                               curious + "check.adjoint(adjoint)"])
    found = {result.exercise: result for result in grading.grade(grading.read(path, "a")).results}
    assert (found["so3_hat"].status, found["adjoint"].status) == (RIGHT, WRONG)
    assert "ValueError: None" in found["adjoint"].detail
    assert (found["odot"].status, found["odot"].detail) == (grading.NO_VERDICT, "NameError: name 'odot' is not defined")


def test_a_deleted_check_is_missing_also_where_all_were_deleted(tmp_path):
    expected = [name for name, exercise in EXERCISES.items() if exercise.chapter == 3]
    path = notebook(tmp_path, ["pass"], "03_landmark_ekf.ipynb")
    assert [(r.exercise, r.status) for r in grading.grade(grading.read(path, "a")).results] == [
        (name, grading.MISSING) for name in expected]
    path = notebook(tmp_path, [EXERCISES[expected[0]].stub], "renamed.ipynb")
    assert [r.exercise for r in grading.grade(grading.read(path, "a")).results] == expected


def test_a_relative_search_path_does_not_let_the_submission_shadow_the_package(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([".", os.environ.get("PYTHONPATH", "")]))
    notebook(tmp_path, [RIGHT_HAT])
    (tmp_path / "vislam_edu.py").write_text("raise SystemExit")
    monkeypatch.chdir(tmp_path.parent)
    assert grading.grade(grading.read(tmp_path / "a.ipynb", "a")).results[0].status == RIGHT


# --- interrupted ------------------------------------------------------------------------------------------


def count(path):
    return sum("submission" in line for line in path.read_text().splitlines()) if path.exists() else 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_goes_on_where_it_was(number, tmp_path):
    folder, out = tmp_path / "class", tmp_path / "out"
    notebook(folder / "a", [RIGHT_HAT, "open('ran', 'a').write('x')"])
    waits = "import os, time\nif not os.path.exists('../go'): time.sleep(1000)"
    notebook(folder / "b", [waits, RIGHT_HAT])
    command = [sys.executable, "-m", "vislam_edu", "exercises", "--report", folder, "--out", out]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True,
                               preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    deadline = time.monotonic() + 60
    while count(out / collecting.KEPT) < 1:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.02)
    time.sleep(0.3)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    if number != signal.SIGKILL:
        assert process.returncode == 130
        assert err.splitlines()[-1].startswith("interrupted; 1 of 2 notebooks are graded, and kept in ")
        assert "Traceback" not in err
    (folder / "go").touch()
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert (folder / "a" / "ran").read_text() == "x"  # once
    entries = json.loads((out / "exercises.json").read_text())
    assert [statuses(entry) for entry in entries] == [{"so3_hat": RIGHT}] * 2
    assert not (out / collecting.KEPT).exists()


def kept(out, **events):
    out.mkdir()
    with open(out / collecting.KEPT, "w") as file:
        file.writelines(json.dumps(line) + "\n" for line in events["lines"])
        file.write('{"notebook": "a')


def test_who_ended_the_grader_twice_is_not_tried_again(tmp_path, monkeypatch):
    path = notebook(tmp_path / "class", [RIGHT_HAT])
    digest = grading.read(path, "a.ipynb").digest
    monkeypatch.setattr(grading, "grade", lambda notebook, *_: grading.Submission(notebook.name))
    started, stopped = ({"notebook": "a.ipynb", "digest": digest, word: True} for word in ("started", "stopped"))
    for number, (lines, tried) in enumerate([
            ([started], True), ([started, started], False), ([started, stopped, started, stopped], True),
            ([started | {"digest": "before it was handed in anew"}] * 2, True)]):
        kept(tmp_path / str(number), lines=lines)
        [found] = collecting.graded(path, tmp_path / str(number))
        assert found.problem.startswith("not graded: twice") is not tried


# --- the sandbox ------------------------------------------------------------------------------------------


def test_a_sandbox_has_no_network_and_cannot_write_to_the_submissions():
    folder, scratch, hidden = Path("/class/anna"), Path("/tmp/x"), Path("/class")
    given = (["-c", "pass"], folder, scratch, hidden, {"A": "b"}, "name")
    bwrap = sandbox.Sandbox("bwrap").command(*given)
    text = " ".join(bwrap)
    assert "--unshare-all" in bwrap  # with the network; loopback is up in there
    assert "--share-net" not in bwrap
    assert text.index("--ro-bind / /") < text.index("--tmpfs /class") < text.index("--ro-bind /class/anna /class/anna")
    assert [bwrap[i:i + 3] for i, word in enumerate(bwrap) if word == "--bind"] == [["--bind", "/tmp/x", "/tmp/x"]]
    assert bwrap[-4:] == ["--", sys.executable, "-c", "pass"]
    for program in ("podman", "docker"):
        command = sandbox.Sandbox(program, "course").command(*given)
        assert command[command.index("--network") + 1] == "none"
        assert "type=bind,source=/class/anna,target=/class/anna,readonly" in command
        assert "--read-only" in command
        assert command[-4:] == ["course", "python", "-c", "pass"]
        assert ("--userns=keep-id" in command) == (program == "podman")


def program(folder, name, script):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod((folder / name).stat().st_mode | stat.S_IXUSR)


def test_without_a_sandbox_the_request_is_refused_in_one_line(tmp_path, monkeypatch, capsys):
    notebook(tmp_path / "class", [RIGHT_HAT])
    program(tmp_path / "bin", "docker", "echo 'Cannot connect to the Docker daemon' >&2; exit 1")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    words = ["exercises", "--report", str(tmp_path / "class"), "--out", str(tmp_path / "out"), "--sandbox"]
    assert cli.main(words) == cli.BAD_INPUT
    assert capsys.readouterr().err == (
        "vislam_edu: exercises --sandbox: no sandbox works here (bwrap is not installed; podman is not installed; "
        "docker: Cannot connect to the Docker daemon)\n")
    assert not (tmp_path / "out").exists()


def test_submissions_run_in_the_sandbox_that_works(tmp_path, monkeypatch, capsys):
    """With stand-ins that write down how they are called, then run what they are given."""
    notebook(tmp_path / "class" / "anna", [RIGHT_HAT])
    monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path / "bin"), os.environ["PATH"]]))
    program(tmp_path / "bin", "bwrap", "echo 'no namespaces' >&2; exit 1")
    program(tmp_path / "bin", "podman", f'echo "$@" >> {tmp_path}/calls; [ "$1" = rm ] && exit 0\n'
                                        'while [ "$1" != vislam_edu ]; do shift; done; shift; exec "$@"')
    words = ["exercises", "--report", str(tmp_path / "class"), "--out", str(tmp_path / "out"), "--sandbox"]
    assert cli.main(words) == 0
    assert statuses(json.loads((tmp_path / "out" / "exercises.json").read_text())[0]) == {"so3_hat": RIGHT}
    calls = (tmp_path / "calls").read_text()
    assert calls.count("--network none") == 2  # the trial and the notebook
    assert calls.count("\nrm --force vislam_edu-") == 1
    capsys.readouterr()


def test_a_sandbox_that_fails_later_is_a_row(tmp_path, monkeypatch):
    path = notebook(tmp_path / "class", [RIGHT_HAT])
    program(tmp_path / "bin", "bwrap", "echo 'no such image' >&2; exit 1")
    monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path / "bin"), os.environ["PATH"]]))
    found = grading.grade(grading.read(path, "a"), sandbox=sandbox.Sandbox("bwrap"))
    assert found.problem == "could not be run: no such image"


def test_nothing_is_right_in_notebook_13_as_it_is_shipped(tmp_path):
    shipped = Path(__file__).parents[2] / "notebooks" / "13_your_own_filter.ipynb"
    assert cli.main(["exercises", "--report", str(shipped), "--out", str(tmp_path)]) == 0
    [entry] = json.loads((tmp_path / "exercises.json").read_text(encoding="utf-8"))
    assert len(entry["exercises"]) == len([one for one in EXERCISES.values() if one.chapter == 13])
    assert {result["status"] for result in entry["exercises"]} == {grading.NOT_WRITTEN}
