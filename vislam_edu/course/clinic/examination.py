"""An examination in the clinic: a small server shows each student a page, and a reading once it was ordered and paid.

Patients, and the key that draws them, stay with the server. Its log takes each order before the reading is shown, each
line under an authentication code (HMAC) of the key over the line and the code before it.
"""

import hashlib
import hmac
import json
import os
import threading
from collections.abc import Iterable, Mapping
from functools import cache
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from ...cli.arguments import OptionError
from . import clinic
from .clinic_tests import TESTS
from .patients import KINDS, PIECES

MOST_BYTES = 10_000  # of a form that a browser sends
PARTS = ("piece", "kind", "evidence", "cure", "thrift")


class Examination:
    """All patients of all students, as the log has them. `cases` : {(student, number): what was ordered and answered}.

    students : {name: id, number and e-mail of the roster}.
    log : file, made by `start`. key : the secret. Raises OptionError for a log that this key did not write.
    """

    def __init__(self, log: Path, key: str) -> None:
        self.log, self.key = log, key
        self.cases: dict[tuple[str, int], dict[str, Any]] = {}
        self.students: dict[str, list[str]] = {}
        self.level = self.patients = 0
        self._code, self._end, self.lock = "", 0, threading.RLock()
        self.patient = cache(self._patient)
        for number, line in enumerate(log.read_bytes().splitlines(keepends=True) if log.exists() else [], 1):
            if not line.endswith(b"\n"):
                break  # the server was stopped while it wrote this, before it showed anything
            code, _, text = line.decode(errors="replace").rstrip("\n").partition(" ")
            if not hmac.compare_digest(code.encode(), self._next(text).encode()):
                raise OptionError(f"{log}, line {number}: changed after it was written, or by another key")
            self._take(code, json.loads(text), len(line))

    def _next(self, text) -> str:
        return hmac.new(self.key.encode(), f"{self._code} {text}".encode(), hashlib.sha256).hexdigest()

    def _take(self, code, record, size) -> None:
        self._code, self._end = code, self._end + size
        if "students" in record:
            self.level, self.patients = record["level"], record["patients"]
            self.students |= record["students"]
            for number in range(1, self.patients + 1):
                for student in record["students"]:
                    self.cases.setdefault((student, number), {"ordered": [], "piece": [], "kind": [], "evidence": []})
            return
        case = self.cases[record["student"], record["patient"]]
        if "test" in record:
            case["ordered"].append(record["test"])
        else:
            case.update(record["answer"])

    def _write(self, **record) -> None:
        text = json.dumps(record)
        line = f"{self._next(text)} {text}\n".encode()
        with open(self.log, "ab") as file:
            file.truncate(self._end)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        self._take(line.decode().partition(" ")[0], record, len(line))

    def start(self, students: Mapping[str, list[str]], level: int, patients: int) -> None:
        """Begin, or go on with the same level and number of patients; students may be added (see `students`)."""
        if self.cases and (level, patients) != (self.level, self.patients):
            raise OptionError(f"{self.log} is of level {self.level} with {self.patients} patients: go on with "
                              "these, or take another folder")
        self._write(students=students, level=level, patients=patients)

    def token(self, student: str) -> str:
        """What a student's link ends in: nobody guesses it without the key."""
        return hmac.new(self.key.encode(), f"link {student}".encode(), hashlib.sha256).hexdigest()[:24]

    def _patient(self, student, number) -> clinic.Patient:
        patient = clinic.Patient(student, number, self.level, self.key)
        patient.order(*self.cases[student, number]["ordered"])
        return patient

    def order(self, student: str, number: int, test: str) -> None:
        """Log and pay a test. Raises ValueError for a test that there is not, or that costs more than is left."""
        with self.lock:
            patient = self.patient(student, number)
            if test in TESTS and test not in patient.readings and TESTS[test].price <= patient.budget:
                self._write(student=student, patient=number, test=test)
            patient.order(test)

    def answer(self, student: str, number: int, findings: Iterable[tuple[str, str, str]]) -> None:
        """Log an answer in place of an earlier one. findings : (piece, kind, evidence or ""). Raises ValueError."""
        with self.lock:
            named = [finding for finding in findings if finding[0]]
            ordered = ("", *self.cases[student, number]["ordered"])
            if not named or any(p not in PIECES or k not in KINDS or e not in ordered for p, k, e in named):
                raise ValueError("not an answer: choose a piece and its kind, and a test that you ordered or none")
            self._write(student=student, patient=number, answer=dict(zip(PARTS, map(list, zip(*named)))))

    def grade(self, student: str, number: int) -> dict[str, Any]:
        """The score of one patient as a dict. The cure is the package's own piece."""
        case = self.cases[student, number]
        if not case["piece"]:
            return {"patient": number, "total": 0.0, "answered": case, "remarks": ["not answered"]}
        piece, kind, evidence = (tuple(case[part]) for part in PARTS[:3])
        score = self._patient(student, number).answer(piece, kind, evidence)
        return {"patient": number, "total": round(score.total, 3), "answered": case,
                **{part: round(getattr(score, part), 3) for part in PARTS},
                "truth": score.truth, "diffs": score.diffs, "remarks": score.remarks}


# --- the page -------------------------------------------------------------------------------------------------

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Clinic</title>
<style>body {{ font: 16px sans-serif; margin: 1em auto; max-width: 62em; padding: 0 1em }}
pre {{ overflow-x: auto }} button, select {{ font: inherit; margin: .2em }}</style></head>
<body><main><h1>Clinic: {student}</h1><p role="status"><strong>{note}</strong></p>
<p>Each patient is a filter or a recording with {faults}. Order tests: each costs what its button says, and the sheet
shows its readings beside those of healthy patients; &lt; marks what is outside. Then answer: the piece that is wrong,
the kind of its fault, and an ordered test that shows it. "nothing" needs three tests without a finding, one of them a
bench. You may send an answer again; the last one counts. Piece 2 points, kind 1, evidence 3, the cure by the package's
own piece 3, budget left 1.</p>
<details><summary>The words of an answer</summary><h2>Pieces</h2>{pieces}<h2>Kinds</h2>{kinds}</details>
{patients}</main></body></html>
"""
_FAULTS = {1: "one fault, or none", 2: "one fault, or none", 3: "one fault, two, or none"}


def _words(words: Mapping[str, str]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(word)}</dt><dd>{escape(text)}</dd>" for word, text in words.items()) + "</dl>"


def _select(label, name, words, chosen) -> str:
    options = (f"<option{' selected' * (word == chosen)}>{escape(word)}</option>" for word in ("", *words))
    return f'<label>{label} <select name="{name}">{"".join(options)}</select></label> '


def page(exam: Examination, student: str, note: str = "") -> str:
    """A student's page, as HTML: what was ordered, what can be, and the answers so far."""
    sections = []
    for number in range(1, exam.patients + 1):
        patient, case = exam.patient(student, number), exam.cases[student, number]
        buttons = "".join(
            f'<button name="test" value="{escape(test.name)}"{" disabled" * (test.price > patient.budget)}>'
            f'{escape(test.name)}, {test.price}{" (bench)" * test.bench}: {escape(test.text)}</button>'
            for test in TESTS.values() if test.name not in patient.readings)
        findings = []
        for i in range(2 if exam.level == 3 else 1):
            chosen = {part: case[part][i] if i < len(case[part]) else "" for part in PARTS[:3]}
            words = {"piece": patient.suspects, "kind": KINDS, "evidence": case["ordered"]}
            findings.append("<p>" + "".join(_select(part, part, words[part], chosen[part]) for part in words) + "</p>")
        form = f'<form method="post"><input type="hidden" name="patient" value="{number}">'
        sections.append(
            f'<section id="p{number}"><h2>Patient {number}</h2><pre tabindex="0">{escape(patient.sheet())}</pre>'
            f'{form}<h3>Order a test</h3>{buttons}</form>'
            f'{form}<h3>Answer</h3>{"".join(findings)}'
            f'<button>{"Send again" if case["piece"] else "Send"}</button> '
            f'{"An answer is recorded." if case["piece"] else "Not answered."}</form></section>')
    return _PAGE.format(student=escape(student), note=escape(note), faults=_FAULTS[exam.level], pieces=_words(PIECES),
                        kinds=_words(KINDS), patients="".join(sections))


class _Server(ThreadingHTTPServer):
    request_queue_size = 128  # a class that opens its links at once; the default of 5 turns some away


def server(exam: Examination, address: tuple[str, int]) -> ThreadingHTTPServer:
    """A server of all pages, bound to (host, port) but not yet serving; port 0 takes a free one."""
    students = {f"/{exam.token(student)}": student for student in exam.students}

    class Handler(BaseHTTPRequestHandler):
        timeout = 20  # s, for a browser that stops in the middle of a form

        def log_message(self, format, *args):
            pass

        def do_GET(self, status=200, note=""):
            student = students.get(self.path)
            with exam.lock:
                text = page(exam, student, note) if student else "Nothing here: open the link that you were given."
            self.send_response(status if student else 404)
            self.send_header("Content-Type", f"text/{'html' if student else 'plain'}; charset=utf-8")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(text.encode())

        def do_POST(self):
            try:
                size = min(int(self.headers.get("Content-Length", 0)), MOST_BYTES)
                form = parse_qs(self.rfile.read(size).decode(), keep_blank_values=True)
                student, number = students[self.path], int(form["patient"][0])
                if "test" in form:
                    exam.order(student, number, form["test"][0])
                else:
                    exam.answer(student, number, list(zip(*(form[part] for part in PARTS[:3]))))
            except KeyError:
                return self.do_GET(400, "That form was not complete: nothing was recorded.")
            except (ValueError, OSError) as error:
                return self.do_GET(400, f"Nothing was recorded: {error}.")
            self.send_response(303)  # so that reloading the page sends nothing again
            self.send_header("Location", f"{self.path}#p{number}")
            self.end_headers()

    return _Server(address, Handler)
