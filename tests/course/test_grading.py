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

import pytest

from vislam_edu import cli
from vislam_edu.course.checks.verdict import RIGHT, WRONG
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import cells, collecting, grading, report, sandbox, submission

HAT = """import numpy as np
def so3_hat(omega):
    x, y, z = omega
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
"""
CHECK_HAT = "from vislam_edu.course.exercises import check\ncheck.so3_hat(so3_hat)"
RIGHT_HAT = HAT + CHECK_HAT
posix = pytest.mark.skipif(os.name != "posix", reason="process groups and limits are those of POSIX")
linux = pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux")

DAEMON = """
import os, subprocess, sys, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open("daemon.pid", "w").write(str(os.getpid()))
        time.sleep(1000)
    os._exit(0)
while not os.path.exists("daemon.pid"):
    time.sleep(0.01)
"""
RECORD = "import os, sys; path = sys.argv[2] + '/record'\n"
FORGED = RECORD + r"""
with open(path, "a") as file:
    file.write('{"exercise": "odot", "status": "right", "outcomes": null}\n')
    file.write('0' * 64 + ' {"exercise": "adjoint", "outcomes": []}\n[' + "[" * 100000 + "\n3\n")
"""
CODE = {  # student: cells before the check of so3_hat
    "a good one": "1 + 1",
    "forges the record": FORGED,
    "a surrogate in a cell": "'\ud800'",
    "garbage on every file": "import os\nfor i in range(3, 20):\n    try: os.write(i, b'x' * 1000)\n"
                             "    except OSError: pass",
    "ends its parent": "import os; os.kill(os.getppid(), 9)",
    "ends itself": "import os; os.kill(os.getpid(), 9)",
    "exits": "import sys; sys.exit(3)",
    "takes memory": "import numpy as np\nx = np.ones(10**9)",
    "takes memory bit by bit": "import numpy as np\nx = []\nwhile True: x.append(np.zeros(1 << 23))",
    "writes much": "open('large', 'wb').write(bytes(1 << 28))",
    "prints much": "print('x' * 10**8)",
    "leaves a daemon": DAEMON,
    "leaves a thread": "import threading, time\nthreading.Thread(target=time.sleep, args=(1000,)).start()",
    "an error without words": "class Mute(Exception):\n    def __str__(self): raise self\nraise Mute",
    "shadows with a folder": "import vislam_edu; assert 'shadow' not in vislam_edu.__file__",
    "shadows with a module": "import vislam_edu; assert 'shadow' not in vislam_edu.__file__",
    "=HYPERLINK(\"x\")": "1",
}
RECORD_MADE = {  # what it puts in the place of the record, in a cell after the check
    "a pipe for a record": "os.unlink(path); os.mkfifo(path)",
    "a device for a record": "os.unlink(path); os.symlink('/dev/zero', path)",
    "a folder for a record": "os.unlink(path); os.mkdir(path)",
    "a large record": "open(path, 'a').write('x' * (50_000_000 + 1))",
    "no utf-8 in a record": r"open(path, 'ab').write(b'\xff\n')",
}
TEXT = {  # student: the notebook file
    "no json": "no notebook",
    "empty": "{}",
    "cells are a number": '{"cells": 3, "nbformat": 4}',
    "a source is a number": '{"cells": [{"cell_type": "code", "source": 3}], "nbformat": 4, "nbformat_minor": 5}',
    "a cell is a number": '{"cells": [3], "nbformat": 4, "nbformat_minor": 5}',
    "nested": '{"cells": ' + "[" * 100_000,
    "of version 3": '{"worksheets": [], "nbformat": 3, "nbformat_minor": 0}',
}


def notebook(folder, sources, name="a.ipynb"):
    folder.mkdir(parents=True, exist_ok=True)
    content = {"cells": [{"cell_type": "code", "source": source} for source in sources], "nbformat": 4,
               "nbformat_minor": 5, "metadata": {}}
    (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return folder / name


def statuses(entry):
    return {result["exercise"]: result["status"] for result in entry["exercises"]
            if result["status"] != grading.MISSING}


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """All hostile submissions, graded by one command; entries of exercises.json by student, and the folders."""
    folder, out = tmp_path_factory.mktemp("class"), tmp_path_factory.mktemp("grades")
    for student, source in CODE.items():
        notebook(folder / student, [source, RIGHT_HAT])
    for student, source in RECORD_MADE.items():
        notebook(folder / student, [RIGHT_HAT, RECORD + source])
    for student, text in TEXT.items():
        (folder / student).mkdir()
        (folder / student / "a.ipynb").write_text(text, encoding="utf-8")
    shadow = "shadow = True\nraise SystemExit('the wrong package')\n"
    (folder / "shadows with a folder" / "vislam_edu").mkdir()
    (folder / "shadows with a folder" / "vislam_edu" / "__init__.py").write_text(shadow)
    (folder / "shadows with a module" / "vislam_edu.py").write_text(shadow)
    for student in ("is a pipe", "is a device", "is a folder", "leads nowhere"):
        (folder / student).mkdir()
    os.mkfifo(folder / "is a pipe" / "a.ipynb")
    (folder / "is a device" / "a.ipynb").symlink_to("/dev/zero")
    (folder / "is a folder" / "a.ipynb").mkdir()
    (folder / "leads nowhere" / "a.ipynb").symlink_to("nowhere")
    notebook(Path(os.fsdecode(os.fsencode(folder) + b"/not \xff utf-8")), [RIGHT_HAT])
    done = subprocess.run([sys.executable, "-m", "vislam_edu", "exercises", "--report", folder, "--out", out, "--jobs",
                           "2", "--limit", "60"], capture_output=True, text=True, timeout=400, errors="replace")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    entries = json.loads((out / "exercises.json").read_text(encoding="utf-8"))
    return {entry["notebook"].split("/")[0]: entry for entry in entries}, folder, out, done.stdout


pytestmark = posix


@pytest.mark.parametrize("student", [
    "a good one", "garbage on every file", "exits", "takes memory", "writes much", "prints much", "leaves a daemon",
    "leaves a thread", "an error without words", "shadows with a folder", "shadows with a module",
    "a surrogate in a cell", "=HYPERLINK(\"x\")", "not ? utf-8"])
def test_what_goes_wrong_in_one_cell_costs_nothing_else(graded, student):
    entry = graded[0][student]
    assert statuses(entry) == {"so3_hat": RIGHT}
    assert entry["problem"] == ""


def test_lines_without_the_signature_are_nobodys(graded):
    entry = graded[0]["forges the record"]
    assert statuses(entry) == {"so3_hat": RIGHT}
    assert entry["notes"] == ["its code has sys.argv"]


@pytest.mark.parametrize("student", ["ends its parent", "ends itself", "takes memory bit by bit"])
def test_who_ends_its_own_process_has_a_row_that_says_so(graded, student):
    entry = graded[0][student]
    # As good: a MemoryError in the cell; a notebook that ends before the grader sees that its parent is gone.
    if student != "ends itself" and not entry["problem"]:
        assert statuses(entry) == {"so3_hat": RIGHT}
    else:
        assert entry["problem"].startswith("its process ended before the notebook did")
        assert statuses(entry) == {"so3_hat": grading.NO_VERDICT}


@pytest.mark.parametrize("student", RECORD_MADE)
def test_what_stands_in_the_place_of_the_record_is_not_waited_for(graded, student):
    entry = graded[0][student]
    assert set(statuses(entry)) == {"so3_hat"}
    assert entry["problem"].startswith("its process ended")


@pytest.mark.parametrize("student", [*TEXT, "is a pipe", "is a device", "is a folder", "leads nowhere"])
def test_what_is_no_notebook_has_a_row_that_says_so(graded, student):
    assert graded[0][student]["problem"].startswith("not a readable notebook: ")
    assert graded[0][student]["exercises"] == []


def test_every_submission_has_its_row_and_nothing_else_is_left(graded):
    entries, folder, out, printed = graded
    assert len(entries) == len(list(folder.iterdir()))
    assert sorted(path.name for path in out.iterdir()) == [
        "exercises.csv", "exercises.json", "feedback", "matrix.csv", "points.csv", "similar.csv", "summary.txt"]
    assert "\x1b" not in printed


@linux
def test_a_process_that_left_the_group_is_ended(graded):
    pid = int((graded[1] / "leaves a daemon" / "daemon.pid").read_text())
    state = Path(f"/proc/{pid}/stat")
    assert not state.exists() or state.read_text().rsplit(")", 1)[1].split()[0] == "Z"


def test_files_that_are_written_have_a_limit(graded):
    assert (graded[1] / "writes much" / "large").stat().st_size <= submission.FILE_SIZE


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


def test_a_notebook_that_never_ends_is_stopped_with_its_children(tmp_path):
    code = ("import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)'])\n"
            "while True:\n    try:\n        time.sleep(1)\n    except BaseException: pass")
    path = notebook(tmp_path, [RIGHT_HAT, code])
    found = grading.grade(grading.read(path, "a"), limit=15)
    assert found.problem == "stopped after 15 s"
    assert found.results[0] == grading.Result("so3_hat", RIGHT, "", found.results[0].detail)


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
    path = notebook(tmp_path, [cells.source(EXERCISES[expected[0]])[0]], "renamed.ipynb")
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
