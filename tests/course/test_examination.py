"""The clinic's examination: no reading leaves the server unpaid, the log cannot be changed, one row is a student."""

import csv
import json
import re
import subprocess
import sys
import threading
import urllib.error
import urllib.parse
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from html import escape

import pytest

from vislam_edu import cli
from vislam_edu.cli.arguments import OptionError
from vislam_edu.course.clinic import examination, patients
from vislam_edu.course.clinic.clinic_tests import TESTS, bands
from vislam_edu.course.clinic.patients import FAULTS, KINDS

KEY = "a secret"
STUDENTS = {"Müller, Jörg": ["7", "u7", "jm@uni.example"], "<b>Ann</b>": ["", "", ""], "=SUM(1)": ["8", "", ""]}
NAMES = list(STUDENTS)


@pytest.fixture
def exam(tmp_path):
    exam = examination.Examination(tmp_path / "log.txt", KEY)
    exam.start(STUDENTS, 1, 2)
    return exam


@pytest.fixture
def site(exam):
    with examination.server(exam, ("127.0.0.1", 0)) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


def asked(url, **form):
    """(status, text) of a page, or of what a form answers."""
    data = urllib.parse.urlencode(form, doseq=True).encode() if form else None
    try:
        with urllib.request.urlopen(url, data) as reply:
            return reply.status, reply.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def right_answer(student, number, level=1):
    """(test that shows it, piece, kind) of a patient with one fault."""
    [name] = patients.draw(student, number, level, KEY).faults
    return FAULTS[name].seen_by[0], FAULTS[name].piece, FAULTS[name].kind


def test_a_page_holds_a_reading_only_after_it_was_paid_for(exam, site):
    url = site + exam.token(NAMES[0])
    first = asked(url)[1]
    readings = {name: list(read) for name, read in bands().items()}
    assert not any(re.search(rf"^  {re.escape(key)} +[\d>]", first, re.M) for keys in readings.values() for key in keys)
    assert asked(url, patient=1, test="birth")[0] == 200
    after = asked(url)[1]
    shown = {name for name, keys in readings.items()
             if all(re.search(rf"^  {re.escape(key)} +[\d>]", after, re.M) for key in keys)}
    assert shown == {"birth"}
    assert exam.cases[NAMES[0], 1]["ordered"] == ["birth"]
    assert "budget left: 9" in after
    asked(url, patient=1, test="birth")  # a second time is free
    assert "budget left: 9" in asked(url)[1]
    for name in ("H", "predict", "recording", "update", "straight"):
        asked(url, patient=1, test=name)
    before = exam.log.read_bytes()
    status, page = asked(url, patient=1, test="1 km")
    assert (status, exam.log.read_bytes()) == (400, before)
    assert "costs 1, and 0 is left" in page
    assert "  1 km" not in page


def test_the_page_explains_itself_and_shows_names_as_they_are(exam, site):
    page = asked(site + exam.token(NAMES[1]))[1]
    assert "<h1>Clinic: &lt;b&gt;Ann&lt;/b&gt;</h1>" in page
    assert '<html lang="en">' in page
    for word in (*KINDS, *(test.text for test in TESTS.values())):
        assert escape(word) in page
    assert page.count("</form>") == 4
    assert all(page.count(f"<{tag}") == page.count(f"</{tag}>") for tag in ("form", "label", "select", "section"))
    assert "Müller, Jörg" in asked(site + exam.token(NAMES[0]))[1]


@pytest.mark.parametrize("form", [
    {"patient": 1, "test": "no such test"}, {"patient": 3, "test": "H"}, {"patient": "x", "test": "H"}, {"test": "H"},
    {"patient": 1}, {"patient": 1, "piece": "", "kind": "", "evidence": ""},
    {"patient": 1, "piece": "pose Jacobian", "kind": "", "evidence": ""},
    {"patient": 1, "piece": "pose Jacobian", "kind": "sign", "evidence": "H"},  # it was not ordered
    {"patient": 1, "piece": "the weather", "kind": "sign", "evidence": ""}, {"patient": 1, "piece": "a" * 20_000}])
def test_a_form_that_makes_no_sense_records_nothing(form, exam, site):
    before = exam.log.read_bytes()
    status, page = asked(site + exam.token(NAMES[0]), **form)
    assert status == 400
    assert "recorded" in page
    assert exam.log.read_bytes() == before


def test_only_the_links_open_a_page(exam, site):
    links = {exam.token(name) for name in NAMES}
    assert len(links) == 3
    assert examination.Examination(exam.log, KEY).token(NAMES[0]) in links
    for path in ("", NAMES[1][3:6], "../log.txt", f"{exam.token(NAMES[0])}x"):
        assert asked(site + path)[0] == 404
        assert asked(site + path, patient=1, test="H")[0] in (400, 404)
    assert len(exam.log.read_bytes().splitlines()) == 1


def test_a_class_that_orders_at_once_is_served(exam, site):
    with ThreadPoolExecutor(60) as pool:
        url = site + exam.token(NAMES[0])
        replies = list(pool.map(lambda test: asked(url, patient=1, test=test)[0], ["H", "birth", "predict"] * 20))
    assert set(replies) == {200}
    assert sorted(exam.cases[NAMES[0], 1]["ordered"]) == ["H", "birth", "predict"]
    assert examination.Examination(exam.log, KEY).cases == exam.cases


def test_a_stopped_server_goes_on_where_it_was_and_a_torn_line_counts_for_nothing(exam):
    exam.order(NAMES[0], 1, "H")
    with exam.log.open("ab") as log:
        log.write(b"torn in the mid")
    again = examination.Examination(exam.log, KEY)
    assert again.cases == exam.cases
    again.start(STUDENTS | {"late": ["9", "", ""]}, 1, 2)
    again.order("late", 2, "birth")
    assert examination.Examination(exam.log, KEY).cases["late", 2]["ordered"] == ["birth"]
    with pytest.raises(OptionError, match="go on with these"):
        again.start(STUDENTS, 2, 2)


def test_a_changed_log_is_noticed(exam):
    exam.order(NAMES[0], 1, "H")
    exam.order(NAMES[0], 1, "birth")
    lines = exam.log.read_bytes().splitlines(keepends=True)
    cheaper = lines[1].replace(b'"H"', b'"1 km"')
    for changed in ([lines[0], lines[2]], [lines[0], lines[2], lines[1]], [lines[0], cheaper],
                    [*lines, lines[1]], [b"\xff\n"], [b"\n"]):
        exam.log.write_bytes(b"".join(changed))
        with pytest.raises(OptionError, match=r"log.txt, line \d: changed"):
            examination.Examination(exam.log, KEY)
    exam.log.write_bytes(b"".join(lines))
    with pytest.raises(OptionError, match="line 1: changed after it was written, or by another key"):
        examination.Examination(exam.log, "another key")


def test_grading_is_one_row_a_student_with_a_total(exam, site, tmp_path, capsys):
    for name in NAMES[:2]:
        test, piece, kind = right_answer(name, 1)
        asked(site + exam.token(name), patient=1, test=test)
        asked(site + exam.token(name), patient=1, piece=piece, kind=kind, evidence="")
        asked(site + exam.token(name), patient=1, piece=piece, kind=kind, evidence=test)  # the last one counts
    (tmp_path / "key").write_text(KEY + "\n")
    assert cli.main(["clinic", "grade", "--key", str(tmp_path / "key"), "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "clinic.csv").open(encoding="utf-8")))
    assert [row["student"] for row in rows] == [*NAMES[:2], "'=SUM(1)"]
    assert [float(row["total"]) for row in rows] == [10, 10, 0]
    assert [row["patient 1"] for row in rows] == ["10.0", "10.0", "0.0"]
    assert [rows[0][name] for name in ("id", "number", "email", "maximum")] == ["7", "u7", "jm@uni.example", "20"]
    assert rows[0]["remarks"] == "2: not answered"
    told = json.loads((tmp_path / "clinic.json").read_text(encoding="utf-8"))
    assert told[NAMES[0]][0]["truth"] == [list(right_answer(NAMES[0], 1)[1:])]
    build = patients.draw(NAMES[0], 1, 1, KEY).build
    assert told[NAMES[0]][0]["diffs"] == [seam.diff for seam in vars(build).values() if hasattr(seam, "diff")]
    assert "Müller, Jörg" in capsys.readouterr().out


def test_two_faults_are_answered_in_two_rows(tmp_path):
    exam = examination.Examination(tmp_path / "log.txt", KEY)
    exam.start({"ann": ["", "", ""]}, 3, 8)
    number = next(n for n in range(1, 9) if len(patients.draw("ann", n, 3, KEY).faults) == 2)
    assert examination.page(exam, "ann").count('name="piece"') == 16
    findings = []
    for name in patients.draw("ann", number, 3, KEY).faults:
        fault = FAULTS[name]
        exam.order("ann", number, fault.seen_by[0])
        findings.append((fault.piece, fault.kind, fault.seen_by[0]))
    exam.answer("ann", number, findings)
    assert exam.grade("ann", number)["piece"] == 2
    assert exam.grade("ann", number)["kind"] == 1


def test_serving_from_the_command_line(tmp_path):
    roster = tmp_path / "roster.csv"
    roster.write_text('name,id,email\n"Müller, Jörg",7,\nZoë,8,z@uni.example\nZoë,9,\n', encoding="utf-8")
    words = ["clinic", "serve", "--key", str(tmp_path / "key"), "--roster", str(roster), "--students", "ann", "--port",
             "0", "--out", str(tmp_path / "exam")]
    with subprocess.Popen([sys.executable, "-m", "vislam_edu", *words], stdout=subprocess.PIPE, text=True) as served:
        try:
            assert "a new key was written" in served.stdout.readline()
            assert "4 students at http://127.0.0.1:" in served.stdout.readline()
            links = list(csv.DictReader((tmp_path / "exam" / "links.csv").open(encoding="utf-8")))
            assert [row["student"] for row in links] == ["ann", "Müller, Jörg", "Zoë (8)", "Zoë (9)"]
            assert links[2]["email"] == "z@uni.example"
            assert "Clinic: Zoë (8)" in asked(links[2]["link"])[1]
        finally:
            served.terminate()
    assert served.returncode == 0
    assert (tmp_path / "key").read_text().strip() not in (tmp_path / "exam" / "log.txt").read_text()


def test_an_examination_needs_students_and_a_key(tmp_path, capsys):
    key, out = str(tmp_path / "k"), str(tmp_path / "out")
    for words, problem in (([], "name the students"), (["--students", "a", "a"], "no other student's"),
                           (["--students", "a\x1b[31m"], "printable"), (["--students", " "], "printable")):
        assert cli.main(["clinic", "serve", "--key", key, "--out", out, *words]) == 2
        assert problem in capsys.readouterr().err
    (tmp_path / "k").write_text("\n")
    assert cli.main(["clinic", "serve", "--key", key, "--students", "a", "--out", out]) == 2
    assert "the key is empty" in capsys.readouterr().err
    assert cli.main(["clinic", "grade", "--key", key, "--out", out]) == 2
    assert "log.txt is missing" in capsys.readouterr().err
