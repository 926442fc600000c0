"""Run one submitted notebook and collect the verdicts of its checks.

A submitted notebook is a program of its author: running it does, with your rights, whatever it says, unless it runs in
a sandbox (`sandbox`). Each has processes of its own with limits of time, memory and file size, which are ended with
it; that protects from mistakes, and from nothing else. Its functions are put to the inputs in its own process
(`submission`), and their results are judged here.
"""

import hashlib
import json
import os
import re
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...recordings.files import shown
from ..checks.verdict import NOT_WRITTEN, RIGHT, concluded, judge
from ..exercises import EXERCISES
from . import borrowing, submission
from .sandbox import Sandbox

LIMIT = 300.0  # s, for one notebook
BORROWED, NO_VERDICT, MISSING = "borrowed", "no verdict", "missing"

_CALL = re.compile(r"\bcheck\.(\w+)\s*\(")
_STUB = re.compile(r"^def (\w+)\(", re.MULTILINE)
_CHAPTER = re.compile(r"(?:^|_)(\d\d)_[a-z]")
_DOWNLOADED = re.compile(r"(?:^|/)(?P<name>[^/]+?)_(?:LATE_)?(?P<id>\d+)_(?:assignsubmission_file|\d+_)")
# What a notebook needs of the environment. The rest stays here: it may hold passwords and tokens.
_PASSED_ON = {"PATH", "HOME", "USER", "LANG", "LC_ALL", "TZ", "TMPDIR", "TEMP", "TMP", "SYSTEMROOT", "SYSTEMDRIVE",
              "COMSPEC", "PATHEXT", "USERPROFILE", "APPDATA", "LOCALAPPDATA", "PYTHONPATH", "VIRTUAL_ENV",
              "CONDA_PREFIX", "LD_LIBRARY_PATH", "JUPYTER_PATH", "MPLCONFIGDIR", "XDG_CACHE_HOME"}
_PACKAGE = str(Path(__file__).resolve().parents[3])
# -P: the folder that the grader stands in is not searched. A process between the two: a notebook may end its parent.
_BETWEEN = [sys.executable, "-I", "-S", "-c", "import subprocess, sys; sys.exit(subprocess.call(sys.argv[1:]) != 0)"]
_RUN = f"""import sys; from pathlib import Path
if {_PACKAGE!r} not in sys.path: sys.path.insert(0, {_PACKAGE!r})
from vislam_edu.course.grading import submission
submission.run(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))"""
_JUDGING = threading.Lock()  # one at a time: what explains a mistake has a limit of time


class Stopped(Exception):
    """The grader was asked to stop."""


@dataclass(frozen=True)
class Result:
    """What became of one exercise of one notebook.

    status : of the last check that ran, NO_VERDICT where it did not, BORROWED where it is right and the package's work
    (`mistake` says whose), or MISSING where the notebook has no check of an exercise of its chapter. score : of the
    capstone, what `capstone.Score.figures` holds; else None.
    """

    exercise: str
    status: str
    mistake: str = ""
    detail: str = ""
    score: dict | None = None

    @property
    def chapter(self) -> int:
        return EXERCISES[self.exercise].chapter


@dataclass(frozen=True)
class Submission:
    """One notebook that was run. problem : why it could not be run to its end, else "".

    notes : why a teacher should read it. forms : of its answers, see `borrowing.forms`. time : when the file was
    written, s since 1970.
    """

    name: str
    results: list[Result] = field(default_factory=list)
    problem: str = ""
    notes: list[str] = field(default_factory=list)
    forms: dict[str, str] = field(default_factory=dict)
    time: float = 0.0

    @property
    def student(self) -> str:
        """Whose it is: by the name in a bulk download, or its folder, or its own name where it was in none."""
        return f"{self.student_name} {self.student_id}".strip()

    @property
    def student_name(self) -> str:
        if found := _DOWNLOADED.search(self.name):
            return found["name"]
        return self.name.split("/")[0] if "/" in self.name else Path(self.name).stem

    @property
    def student_id(self) -> str:
        """The number that Canvas has for the student, or Moodle for the participant, in a bulk download; else ""."""
        found = _DOWNLOADED.search(self.name)
        return found["id"] if found else ""


@dataclass(frozen=True)
class Notebook:
    """A notebook file as it was handed in. cells : sources of its code cells. problem : why it cannot be read, or "".

    digest : of its text. time : when it was written, s since 1970.
    """

    path: Path
    name: str
    cells: list[str] = field(default_factory=list)
    problem: str = ""
    digest: str = ""
    time: float = 0.0


def read(path: Path, name: str) -> Notebook:
    """Read a notebook file; nothing that it is raises."""
    digest, time = "", 0.0
    try:
        time = path.stat().st_mtime
        text = submission.read(path)
        digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()
        return Notebook(path.resolve(), name, submission.code_cells(text), "", digest, time)
    except (OSError, ValueError) as error:
        return Notebook(path, name, [], f"not a readable notebook: {shown(error)}", digest, time)


def grade(notebook: Notebook, limit: float = LIMIT, sandbox: Sandbox | None = None, hidden: Path | None = None,
          stop: threading.Event | None = None) -> Submission:
    """Run one notebook in a fresh process, in its own folder, all of it even where cells fail.

    limit : s, for the whole notebook. hidden : the folder of all submissions, which a sandbox does not show. stop : to
    be set by another thread; then Stopped is raised. Otherwise nothing that a notebook holds or does raises.
    """
    path, name, cells = notebook.path, notebook.name, notebook.cells
    if notebook.problem:
        return Submission(name, problem=notebook.problem, time=notebook.time)
    key = secrets.token_hex(16)
    with tempfile.TemporaryDirectory(prefix="vislam_edu-", ignore_cleanup_errors=True) as folder:
        scratch = Path(folder)
        (scratch / submission.CELLS).write_text(json.dumps(cells), encoding="utf-8")
        problem = _run(path.parent, scratch, key, limit, sandbox, hidden or path.parent, stop or threading.Event())
        entries = _entries(scratch / submission.RECORD, key)
    if not problem and not any("end" in entry for entry in entries):
        problem = "its process ended before the notebook did (out of memory, or the notebook ended it)"
    with _JUDGING:
        found, notes = _judged(entries, cells)
    errors = {entry["cell"]: shown(entry["error"]) for entry in entries if "cell" in entry}
    failed = {entry["exercise"]: shown(entry["error"]) for entry in entries if {"exercise", "error"} <= entry.keys()}
    checked = {exercise: errors.get(number) or failed.get(exercise, "") for number, source in enumerate(cells)
               for exercise in _CALL.findall(source)}
    return Submission(name, [
        found.get(exercise) or (Result(exercise, NO_VERDICT, detail=checked[exercise]) if exercise in checked
                                else Result(exercise, MISSING))
        for exercise in _expected(path, cells, checked)], problem, notes + _meddling(cells), borrowing.forms(cells),
        notebook.time)


def _meddling(cells) -> list[str]:
    words = dict.fromkeys(match[0].strip() for cell in cells for match in borrowing.MEDDLING.finditer(cell))
    return [f"its code has {', '.join(list(words)[:6])}"] if words else []


def _expected(path, cells, checked) -> list[str]:
    """The exercises of the chapters that a notebook is about: by its name and its checks, or else by its functions."""
    names = set(checked) or {name for source in cells for name in _STUB.findall(source)}
    chapters = {exercise.chapter for name, exercise in EXERCISES.items() if name in names}
    if found := _CHAPTER.search(path.name):
        chapters.add(int(found[1]))
    return [name for name, exercise in EXERCISES.items() if exercise.chapter in chapters]


def _run(folder, scratch, key, limit, sandbox, hidden, stop) -> str:
    """Run a notebook, wait for it and end all that it has started. Returns the problem, "" if it ran to its end."""
    token = scratch.name
    own = {"IPYTHONDIR": str(scratch), "OPENBLAS_NUM_THREADS": "1",
           "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    environment = {key: value for key, value in os.environ.items() if key.upper() in _PASSED_ON} | own
    python = ["-P", "-c", _RUN, str(folder), str(scratch), str(int(limit) + 10)]
    command = (sandbox.command(python, folder, scratch, hidden, own, token) if sandbox
               else [sys.executable, *python])
    with tempfile.TemporaryFile() as complaints:  # nothing that the notebook can reach
        process = subprocess.Popen([*_BETWEEN, *command], env=environment, stdin=subprocess.PIPE,
                                   stdout=subprocess.DEVNULL, stderr=complaints, start_new_session=True)
        with suppress(BrokenPipeError), process.stdin as pipe:  # type: ignore[union-attr]
            pipe.write(f"{key}\n".encode())
        deadline = time.monotonic() + limit
        try:
            while process.poll() is None:
                if stop.wait(0.02):
                    raise Stopped
                if time.monotonic() > deadline:
                    return f"stopped after {limit:g} s"
        finally:
            _end(process, token)
            if sandbox:
                sandbox.end(token)
        complaints.seek(0)
        lines = complaints.read().decode(errors="replace").split("\n")
    if not (scratch / submission.RECORD).exists():  # it did not come to the first cell
        return "could not be run: " + (shown(" ".join(lines[-2:])) or "its process did not start")
    return ""


def _end(process, token) -> None:
    """End a process with its group and, on Linux, what has left the group: its environment still has the token."""
    if os.name != "posix":
        process.kill()
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for _ in range(20):  # what starts others faster than this is left to the sandbox
        survivors = [int(entry.parent.name) for entry in Path("/proc").glob("[0-9]*/environ")
                     if token.encode() in _bytes(entry)]
        for survivor in survivors:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(survivor, signal.SIGKILL)
        if not survivors:
            return


def _bytes(path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # another user's process, or one that has ended
        return b""


def _entries(record, key) -> list[dict[str, Any]]:
    """What `submission` wrote down; lines without its signature are the notebook's own."""
    entries = []
    with suppress(OSError, ValueError):
        for line in submission.read(record).splitlines():
            digest, _, text = line.partition(" ")
            if secrets.compare_digest(digest.encode(), submission.signature(text, key).encode()):
                entries.append(json.loads(text))
    return entries


def _judged(entries, cells) -> tuple[dict[str, Result], list[str]]:
    """The last verdict on each exercise, and what is to be said of how it came about.

    A score of the capstone stands beside the verdict of its check and never replaces it: without a check the exercise
    counts as not written.
    """
    results: dict[str, Result] = {}
    scores: dict[str, dict] = {}
    notes = []
    for entry in entries:
        name = entry.get("exercise")
        if "score" in entry:
            scores[name] = entry["score"]
        elif "attempt" in entry:
            results[name] = _result(EXERCISES[name], entry, cells)
            if entry.get("here") is False and results[name].status == RIGHT:
                notes.append(f"{name} is not defined in a cell")
    for name, score in scores.items():
        results[name] = replace(results.get(name) or Result(name, NOT_WRITTEN), score=score)
    return results, notes


def _result(exercise, entry, cells) -> Result:
    if entry["attempt"] is None:
        verdict = judge(exercise, None)
    else:
        try:
            verdict = concluded(exercise, submission.received(entry["attempt"], exercise))
        except Exception as error:  # arrays of numbers can still be such that mathematics fails on them
            return Result(exercise.name, NO_VERDICT, detail=f"not judged: {shown(error)}")
    if verdict.right:
        uses = borrowing.borrowed(exercise, entry["uses"])
        if borrowing.asks_for_solution(cells, exercise.name, entry["here"]):
            uses.append("EXERCISES or solution")
        if uses:
            return Result(exercise.name, BORROWED, ", ".join(uses),
                          f"The numbers are right, but they are the package's: your function uses {', '.join(uses)}.")
    return Result(exercise.name, verdict.status, shown(verdict.mistake), _lines(verdict.text))


def _lines(text, most=10_000) -> str:
    """Text of several lines without control characters."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in str(text)[:most])
