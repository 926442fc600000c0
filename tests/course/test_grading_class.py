"""A class's submissions, honest and otherwise: each ends as it should; points, Canvas and Moodle files made of them."""

import contextlib
import csv
import json
import os
import subprocess
import sys
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from blind_answers import read

from vislam_edu import cli
from vislam_edu.cli.arguments import OptionError
from vislam_edu.course.checks import surroundings
from vislam_edu.course.checks.running import copied
from vislam_edu.course.checks.verdict import NOT_WRITTEN, RIGHT, WRONG, concluded, judge
from vislam_edu.course.cli import hand_out
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import borrowing, grading, points, submission

pytestmark = pytest.mark.skipif(os.name != "posix", reason="process groups and limits are those of POSIX")
BORROWED, MISSING = grading.BORROWED, grading.MISSING

HAT = """import numpy as np
from vislam_edu import se3
def so3_hat(omega):
    x, y, z = omega
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
"""
WRONG_HAT = "import numpy as np\ndef so3_hat(omega):\n    return np.diag(omega)\n"
EXP = """def so3_exp(phi):
    # Rodrigues, or the series where the angle is small
    angle = np.sqrt(phi @ phi)
    hat = so3_hat(phi)
    if angle < 1e-4:
        total, term = np.eye(3), np.eye(3)
        for k in range(1, 9):
            term = term @ hat / k
            total = total + term
        return total
    return np.eye(3) + np.sin(angle) / angle * hat + (1 - np.cos(angle)) / angle**2 * hat @ hat
"""
RENAMED_EXP = (EXP.replace("# Rodrigues, or the series where the angle is small", '"""My own work."""')
               .replace("angle", "theta").replace("hat = ", "W = ").replace("* hat", "* W").replace("@ hat", "@ W")
               .replace("total", "result").replace("term", "t").replace("phi", "rotation_vector"))
ADJOINT = """def adjoint(T):
    result = np.zeros((6, 6))
    result[:3, :3] = T[:3, :3]
    result[3:, 3:] = T[:3, :3]
    for column in range(3):
        result[:3, 3 + column] = np.cross(T[:3, 3], T[:3, column])
    return result
"""
PLAIN = [EXP.replace("np.sqrt(phi @ phi)", "np.linalg.norm(phi)"), ADJOINT.replace("np.zeros((6, 6))", "np.eye(6)")]
RENAMED_ADJOINT = ADJOINT.replace("result", "A").replace("column", "i").replace("(T)", "(pose)").replace("T[", "pose[")
COURSE = "from vislam_edu.course.exercises import check\n"
CHECKED = [HAT, COURSE + "check.so3_hat(so3_hat)", EXP, COURSE + "check.so3_exp(so3_exp)", ADJOINT,
           COURSE + "check.adjoint(adjoint)"]
CHECK_HAT = CHECKED[1]
OTHERS = [HAT, CHECK_HAT, PLAIN[0], CHECKED[3], PLAIN[1], CHECKED[5]]
TAKEN = "from vislam_edu.course.exercises import EXERCISES, solution\n"
CLASS = {  # student: the cells, the statuses of so3_hat, so3_exp and adjoint
    "right": (CHECKED, (RIGHT, RIGHT, RIGHT)),
    "partly right": ([*CHECKED[:2], "def so3_exp(phi):\n    raise NotImplementedError\n", CHECKED[3],
                      ADJOINT.replace("np.cross(T[:3, 3], T[:3, column])", "0"), CHECKED[5]],
                     (RIGHT, NOT_WRITTEN, WRONG)),
    "wrong": ([WRONG_HAT, CHECK_HAT, *CHECKED[2:4]], (WRONG, WRONG, MISSING)),
    "check deleted": ([HAT, *OTHERS[2:]], (MISSING, RIGHT, RIGHT)),
    "renamed": (OTHERS, (RIGHT, RIGHT, RIGHT)),
    "broken": (None, ()),
    "copied": ([HAT, CHECK_HAT, RENAMED_EXP, CHECKED[3], RENAMED_ADJOINT, CHECKED[5]], (RIGHT, RIGHT, RIGHT)),
    "borrowed by name": (["from vislam_edu.se3 import so3_hat", CHECK_HAT], (BORROWED, MISSING, MISSING)),
    "borrowed by call": (["import vislam_edu.se3 as s\ndef so3_hat(omega):\n    return 1.0 * s.so3_hat(omega)",
                          CHECK_HAT], (BORROWED, MISSING, MISSING)),
    "borrowed from the reference": ([TAKEN + "so3_hat = lambda omega: EXERCISES['so3_hat'].reference(omega)",
                                     CHECK_HAT], (BORROWED, MISSING, MISSING)),
    "borrowed from the solution": ([TAKEN + """import contextlib, io, numpy as np
with contextlib.redirect_stdout(io.StringIO()) as text:
    solution("so3_hat")
exec(text.getvalue().split("# vislam_edu")[0])""", CHECK_HAT], (BORROWED, MISSING, MISSING)),
    "patches the judge": ([WRONG_HAT, """import vislam_edu.course.checks.check as c
import vislam_edu.course.checks.verdict as v
right = lambda exercise, function, *_: v.Verdict(exercise.name, "right", "right")
c.judge = v.judge = v.concluded = right""", CHECK_HAT], (WRONG, MISSING, MISSING)),
    "appends records": ([WRONG_HAT, CHECK_HAT, """import os, sys
line = '{"exercise": "so3_hat", "status": "right", "mistake": "", "text": "", "outcomes": []}\\n'
for path in (sys.argv[2] + "/record", sys.argv[2] + "/verdicts.jsonl"):
    open(path, "a").write("0" * 64 + " " + line + line)"""], (WRONG, MISSING, MISSING)),
    "replaces json": ([WRONG_HAT, """import json
json.dumps = json.JSONEncoder.encode = lambda *_, **__: '{"exercise": "so3_hat", "status": "right"}'""", CHECK_HAT],
                      (WRONG, MISSING, MISSING)),
    "patches what is called": ([WRONG_HAT, """from vislam_edu.course.checks import running, surroundings
ours = running.outcome_of
running.outcome_of = lambda exercise, function, arguments: ours(exercise, exercise.reference, arguments)
surroundings.restored = lambda: []""", CHECK_HAT], (WRONG, MISSING, MISSING)),
    "Jürgen Groß": (OTHERS, (RIGHT, RIGHT, RIGHT)),
    "two versions": (OTHERS, (RIGHT, RIGHT, RIGHT)),
}
ROSTER = """Student,ID,SIS User ID,SIS Login ID,Section,Chapter 1 (77)
    Points Possible,,,,,3
""" + "".join(f'"{name}",{number},u{number},login{number},A,\n' for number, name in enumerate(CLASS, 100)) \
    + "Absent Anna,99,u99,login99,A,\n"


def write(folder: Path, cells, name="01_se3_kinematics.ipynb") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    content = {"cells": [{"cell_type": "code", "source": source} for source in cells], "nbformat": 4,
               "nbformat_minor": 5, "metadata": {}}
    (folder / name).write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
    return folder / name


def table(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """The class, graded by one command for Canvas: its folder of results, and the printed text."""
    folder, out = tmp_path_factory.mktemp("class"), tmp_path_factory.mktemp("grades")
    names = {"renamed": "my homework.ipynb", "Jürgen Groß": "01 Übung, fertig.ipynb"}
    for student, (cells, _) in CLASS.items():
        write(folder / student, cells or [], names.get(student, "01_se3_kinematics.ipynb"))
    (folder / "broken" / "01_se3_kinematics.ipynb").write_text("{")
    old = write(folder / "two versions", [WRONG_HAT, CHECK_HAT], "01_se3_kinematics (1).ipynb")
    os.utime(old, (1e9, 1e9))
    spoils = f"open('../right/01_se3_kinematics.ipynb', 'w').write({'{}'!r})"
    write(folder / "borrowed by name", [spoils, *CLASS["borrowed by name"][0]])
    (folder.parent / "roster.csv").write_text(ROSTER, encoding="utf-8")
    done = subprocess.run([sys.executable, "-m", "vislam_edu", "exercises", "--report", folder, "--out", out, "--jobs",
                           "2", "--roster", folder.parent / "roster.csv", "--for", "canvas", "--assignment",
                           "Chapter 1 (77)"], capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    return out, done.stdout


@pytest.mark.parametrize("student", CLASS)
def test_each_submission_ends_as_it_should(graded, student):
    entries = {entry["notebook"]: {result["exercise"]: result["status"] for result in entry["exercises"]}
               for entry in json.loads((graded[0] / "exercises.json").read_text(encoding="utf-8"))
               if "(1)" not in entry["notebook"]}
    [found] = [entry for name, entry in entries.items() if name.startswith(f"{student}/")]
    wanted = CLASS[student][1]
    assert tuple(found[name] for name in ("so3_hat", "so3_exp", "adjoint")[:len(wanted)]) == wanted


def test_the_teacher_is_told_what_to_read(graded):
    summary = (graded[0] / "summary.txt").read_text(encoding="utf-8")
    assert graded[1].count("read these") == 1
    reasons = summary.partition("read these\n")[2].splitlines()
    for student in CLASS:
        told = [line for line in reasons if line.strip().startswith(f"{student}/")]
        if student.startswith(("borrowed", "patches", "appends", "replaces", "right")):  # whose file was changed
            assert told, student
        else:
            assert not told
    assert "  copied and right: the same code in 2 of 2: so3_exp, adjoint" in reasons
    pairs = {frozenset((row["student"], row["other"])): row["exercises"] for row in table(graded[0] / "similar.csv")}
    assert pairs[frozenset({"right", "copied"})] == "so3_exp adjoint"
    assert pairs[frozenset({"right", "wrong"})] == "so3_exp"
    assert frozenset({"right", "renamed"}) not in pairs


def test_canvas_gets_its_columns_and_every_student_of_the_roster(graded):
    rows = table(graded[0] / "canvas.csv")
    assert list(rows[0]) == ["Student", "ID", "SIS User ID", "SIS Login ID", "Section", "Chapter 1 (77)"]
    assert rows[0]["Student"] == "Points Possible"
    assert rows[0]["Chapter 1 (77)"] == "9"  # the exercises of chapter 1
    found = {row["Student"]: (row["ID"], row["Chapter 1 (77)"]) for row in rows[1:]}
    assert set(found) == {*CLASS, "Absent Anna"}
    assert found["right"] == ("100", "3")
    assert found["Jürgen Groß"][1] == found["two versions"][1] == "3"
    assert found["broken"][1] == found["Absent Anna"][1] == "0"


def test_points_say_what_they_rest_on(graded):
    rows = {row["student"]: row for row in table(graded[0] / "points.csv")}
    assert rows["broken"]["remarks"].startswith("broken/01_se3_kinematics.ipynb: not a readable notebook: ")
    assert rows["Absent Anna"]["remarks"] == "nothing handed in"
    assert rows["two versions"]["remarks"] == "chapter 1, newest of 2: two versions/01_se3_kinematics.ipynb"
    assert rows["partly right"]["total"] == "1"
    assert rows["borrowed by call"]["total"] == "0"


# --- without running anything -----------------------------------------------------------------------------


def submitted(name, *statuses, time=0.0, problem=""):
    names = ("so3_hat", "so3_exp", "adjoint")
    return grading.Submission(name, list(map(grading.Result, names, statuses)), problem, time=time)


def test_names_in_bulk_downloads_are_read():
    for name, student in [("doejane_7_99_01_se3_kinematics.ipynb", "doejane 7"),
                          ("doejane_LATE_7_99_01_se3-2.ipynb", "doejane 7"),
                          ("Jane van Doe_1234_assignsubmission_file_/sub/a.ipynb", "Jane van Doe 1234"),
                          ("Jane van Doe_1234_assignsubmission_file/a.ipynb", "Jane van Doe 1234"),
                          ("all/Jane van Doe_1234_assignsubmission_file_a.ipynb", "Jane van Doe 1234"),
                          ("anna/03_landmark_ekf.ipynb", "anna"), ("03_landmark_ekf.ipynb", "03_landmark_ekf")]:
        assert submitted(name).student == student


def test_moodle_gets_its_columns_and_names_with_umlauts_are_found(tmp_path):
    (tmp_path / "roster.csv").write_text("\ufeffFirst name;Last name;ID number;Email address\n"
                                         "Jürgen;Groß;u7;jg@uni.example\nAnna;Lee;u8;anna@uni.example\n"
                                         "Anna;Lee;u9;lee@uni.example\n", encoding="utf-8")
    people = points.roster(tmp_path / "roster.csv")
    rows, worth = points.rows([
        submitted("Ju\u0308rgen Groß_4711_assignsubmission_file_/a.ipynb", RIGHT, WRONG),
        submitted("Anna Lee_4712_assignsubmission_file_/a.ipynb", RIGHT, RIGHT)], people, {"so3_hat": 2, "so3_exp": 3})
    assert points.write(rows, worth, tmp_path, "moodle", "Chapter 1") == ["points.csv", "moodle.csv"]
    assert table(tmp_path / "moodle.csv") == [
        {"First name": first, "Last name": last, "ID number": number, "Email address": email, "Chapter 1": total,
         "Chapter 1 (feedback)": words} for first, last, number, email, total, words in [
            ("Jürgen", "Groß", "u7", "jg@uni.example", "2", ""),
            ("Anna", "Lee", "u8", "anna@uni.example", "0", "nothing handed in"),
            ("Anna", "Lee", "u9", "lee@uni.example", "0", "nothing handed in")]]
    assert rows[-1].remarks == ["several students of the roster have this name"]


def test_late_days_cost_and_the_newest_or_the_best_counts():
    due = datetime(2026, 5, 1, 12)
    versions = [submitted("anna/a.ipynb", RIGHT, RIGHT, time=due.timestamp()),
                submitted("anna/b.ipynb", RIGHT, WRONG, time=(due + timedelta(hours=25)).timestamp()),
                submitted("anna/c.ipynb", time=due.timestamp() + 1e6, problem="not a readable notebook: no")]
    [newest], _ = points.rows(versions, due=due, penalty=10)
    assert (newest.total, newest.late, newest.remarks[-1]) == (0.8, 2, "chapter 1, newest of 2: anna/b.ipynb")
    [best], _ = points.rows(versions, due=due, penalty=10, best=True)
    assert (best.total, best.late) == (2.0, 0)
    person = points.Person(name="anna", submitted="2026-05-01T11:00")
    [row], _ = points.rows(versions, [person], due=due, penalty=10)
    assert row.total == 1.0


def test_a_roster_that_is_none_says_where(tmp_path):
    for text, words in [("name,id\n", "no student in it"), ("name,submitted\nAnna,yesterday\n", "'yesterday' for Anna"),
                        ("M\xfcller\n".encode("latin-1"), "not UTF-8")]:
        (tmp_path / "roster.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(OptionError, match=words):
            points.roster(tmp_path / "roster.csv")


def test_gradescope_gets_a_result_for_each_exercise():
    [row], worth = points.rows([submitted("anna/a.ipynb", RIGHT, WRONG)], points={"so3_hat": 2, "so3_exp": 1})
    found = points.results_json(row, worth)
    assert found["score"] == 2
    assert [(one["name"], one["score"], one["max_score"], one["status"]) for one in found["tests"]] == [
        ("so3_hat", 2, 2, "passed"), ("so3_exp", 0, 1, "failed")]


@pytest.mark.parametrize(("text", "words"), [
    ("exercise,points\nso3_hat,many\n", "row 2: points must be a number, got 'many'"),
    ("exercise,points\nso3_hut,1\n", "row 2: no exercise 'so3_hut'"), ("exercise,points\nso3_hat,-1\n", "row 2")])
def test_a_list_of_points_that_is_none_says_where(tmp_path, text, words):
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(OptionError, match=words):
        points.worth(tmp_path / "points.csv")


def through_data(exercise, function):
    """The verdict of the grader: what the function did crosses as JSON."""
    entry = json.loads(json.dumps(submission.tried(exercise.name, function)))
    return concluded(exercise, submission.received(entry["attempt"], exercise))


class Cunning:
    """Numbers of its own for whoever asks."""

    def __array__(self, *_, **__):
        return np.array([[0.0, -3, 2], [3, 0, -1], [-2, 1, 0]])


OUTSIDE = np.array([1.0, 2.0, 3.0])


def outside(omega):
    return np.diag(OUTSIDE)


@pytest.mark.parametrize("function", [
    outside, lambda omega, more: 0, lambda omega: Cunning(), lambda omega: 1 / 0, lambda omega: [[1], [1, 2]],
    lambda omega: np.zeros((2000, 2000)), lambda omega: omega[:, None] * omega[None, :2],
    lambda omega: (row for row in omega), lambda omega: np.full((3, 3), np.nan), lambda omega: omega.fill(0),
    lambda omega: np.diag(omega).astype(np.float32), lambda: 0, lambda omega: b"\xff".decode()])
def test_the_verdict_is_that_of_the_notebook(function):
    exercise = EXERCISES["so3_hat"]
    told, here = through_data(exercise, function).text, judge(exercise, function).text
    assert told == here or "arrays of the shapes [(2000, 2000)]" in told


@pytest.mark.parametrize("number", [0, 1, 7, 50])
def test_a_notebook_that_changes_its_inputs_answers_for_others_than_it_is_judged_by(number, monkeypatch):
    """With omega = 0, drawn or given, a matrix of zeros is right."""
    exercise = EXERCISES["so3_hat"]
    with monkeypatch.context() as patched:
        patched.setattr(type(exercise), "inputs", lambda *_: [("random", (np.zeros(3),))] * number)
        patched.setattr(surroundings, "restored", list)
        assert judge(exercise, lambda omega: np.diag(omega)).right or not number
        entry = json.loads(json.dumps(submission.tried("so3_hat", lambda omega: np.diag(omega))))
    assert concluded(exercise, submission.received(entry["attempt"], exercise)).status == WRONG


@pytest.mark.parametrize("name", ["so3_hat", "twist_jacobians"])
def test_results_that_are_left_out_are_wrong(name):
    """What puts the function to its inputs runs in the notebook's process, where it may be changed."""
    exercise = EXERCISES[name]
    whole = submission.tried(name, exercise.reference)["attempt"]
    assert concluded(exercise, submission.received(whole, exercise)).right
    outcomes = whole["outcomes"]
    for left in ([one | {"values": []} for one in outcomes], [one | {"values": one["values"][1:]} for one in outcomes],
                 outcomes[:-1], []):
        assert concluded(exercise, submission.received(whole | {"outcomes": left}, exercise)).status == WRONG


@pytest.mark.parametrize("name", [*(name for name, one in EXERCISES.items() if one.chapter in (1, 3, 5)), "filter_run"])
def test_known_mistakes_are_known_across_processes(name):
    exercise = EXERCISES[name]
    for function in [exercise.reference, exercise.mistakes[0].function]:
        told, here = through_data(exercise, function), judge(exercise, function)
        assert (told.status, told.mistake, told.text) == (here.status, here.mistake, here.text)


@pytest.mark.parametrize("name", EXERCISES)
def test_what_stands_for_the_exercise_is_borrowed_and_a_plain_answer_is_not(name):
    exercise = EXERCISES[name]
    assert borrowing.borrowed(exercise, borrowing._used_by_answers(exercise)) == []
    main = f"{exercise.shows[0].__module__}.{exercise.shows[0].__qualname__}"
    if main.startswith("vislam_edu."):
        assert borrowing.borrowed(exercise, [main.removeprefix("vislam_edu.")])
    assert borrowing.borrowed(exercise, [f"anywhere.{name}", f"course.ch99.exercises.{name}"])


def test_right_blind_answers_are_nobody_elses():
    inputs = cache(lambda name: EXERCISES[name].inputs()[:3])
    for answer in read():
        if not answer.cause:
            uses = set()
            with np.errstate(all="ignore"):
                for _, arguments in inputs(answer.exercise):
                    borrowing.watched(answer.function(), uses)(*map(copied, arguments))
            assert borrowing.borrowed(EXERCISES[answer.exercise], uses) == []


def test_a_variable_called_solution_is_none():
    own = HAT.replace("x, y, z = omega", "solution = omega\n    x, y, z = solution")
    assert not borrowing.asks_for_solution([own, "solution('so3_hat')"], "so3_hat", here=True)
    assert borrowing.asks_for_solution([own, "solution('so3_hat')"], "so3_hat", here=False)
    assert borrowing.asks_for_solution(["def so3_hat(w):\n    return EXERCISES['so3_hat'](w)"], "so3_hat", here=True)


def test_names_and_layout_do_not_make_another_answer():
    first, second = ({**borrowing.forms([source])} for source in (EXP, RENAMED_EXP))
    assert first == second
    assert first
    assert borrowing.forms([EXP.replace("k in range(1, 9)", "k in range(1, 12)")]) != first
    assert borrowing.forms([HAT, "def so3_exp(phi):\n    return phi\n"]) == {}  # as short as they come


def test_students_are_handed_stubs_and_nothing_of_the_teachers(tmp_path, capsys):
    assert cli.main(["hand-out", str(tmp_path / "course"), "--for", "students", "--chapters", "03", "13"]) == 0
    files = {path.relative_to(tmp_path / "course").as_posix() for path in (tmp_path / "course").rglob("*")}
    assert {"notebooks/03_landmark_ekf.ipynb", "notebooks/13_your_own_filter.ipynb", "docs/notation.md",
            "data/first_steps.npz"} <= files
    assert not [file for file in files if "instructor" in file or "teaching" in file or "test" in Path(file).name]
    text = (tmp_path / "course" / "notebooks" / "03_landmark_ekf.ipynb").read_text(encoding="utf-8")
    assert not any(cell.get("outputs") for cell in json.loads(text)["cells"])
    source = Path(__file__).parents[2] / "notebooks" / "03_landmark_ekf.ipynb"
    kept = hand_out._cleared(source, keep_outputs=True)
    assert json.loads(kept) == json.loads(source.read_bytes())
    (tmp_path / "worked.ipynb").write_text(source.read_text(encoding="utf-8").replace(
        "raise NotImplementedError", "return 42"), encoding="utf-8")
    assert b"return 42" not in hand_out._cleared(tmp_path / "worked.ipynb", keep_outputs=True)
    assert cli.main(["hand-out", str(tmp_path / "own"), "--for", "teachers", "--chapters", "01"]) == 0
    assert (tmp_path / "own" / "docs" / "instructor.md").exists()
    text = (tmp_path / "own" / "notebooks" / "01_se3_kinematics.ipynb").read_text(encoding="utf-8")
    [stub] = ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["id"] == "so3-hat"]
    assert "NotImplementedError" not in stub
    exec(stub, scope := {"np": np})
    assert judge(EXERCISES["so3_hat"], scope["so3_hat"]).right
    assert cli.main(["hand-out", str(tmp_path / "other"), "--chapters", "99"]) == cli.BAD_INPUT
    assert capsys.readouterr().err == "vislam_edu: 99: there is no notebook of this chapter\n"
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(("words", "message"), [
    (["--for", "canvas"], "exercises --for canvas: --roster names the file with the students' ids"),
    (["--due", "tomorrow"], "'tomorrow' is no time; write it as 2026-05-01T23:59")])
def test_options_that_cannot_be_are_refused_before_anything_runs(tmp_path, capsys, words, message):
    write(tmp_path / "class", ["pass"])
    with contextlib.suppress(SystemExit):
        cli.main(["exercises", "--report", str(tmp_path / "class"), "--out", str(tmp_path / "out"), *words])
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
