"""Run one submitted notebook and collect the verdicts of its checks.

A submitted notebook is a program of its author: running it does, with your rights, whatever it says, unless it runs in
a sandbox (`sandbox`). Each has processes of its own with limits of time, memory and file size, which are ended with
it; that protects from mistakes, and from nothing else. And a verdict comes from the same process as the student's
code, which can fake it: what looks too good is worth reading.
"""

import json
import os
import re
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
from ..checks.check import VERDICTS
from ..checks.verdict import NOT_WRITTEN, RIGHT, WRONG
from ..exercises import EXERCISES
from . import submission
from .sandbox import Sandbox

LIMIT = 300.0  # s, for one notebook
NO_VERDICT, MISSING = "no verdict", "missing"

_CALL = re.compile(r"\bcheck\.(\w+)\s*\(")
_STUB = re.compile(r"^def (\w+)\(", re.MULTILINE)
_CHAPTER = re.compile(r"(\d\d)_")
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


class Stopped(Exception):
    """The grader was asked to stop."""


@dataclass(frozen=True)
class Result:
    """What became of one exercise of one notebook.

    status : of the last check that ran, NO_VERDICT where it did not, or MISSING where the notebook has no check of an
    exercise of its chapter. score : of the capstone, what `capstone.Score.figures` holds; else None.
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
    """One notebook that was run. problem : why it could not be run to its end, else ""."""

    name: str
    results: list[Result] = field(default_factory=list)
    problem: str = ""

    @property
    def student(self) -> str:
        """The folder that the notebook was in, or its own name where it was in none."""
        return self.name.split("/")[0] if "/" in self.name else Path(self.name).stem


def grade(path: Path, name: str, limit: float = LIMIT, sandbox: Sandbox | None = None, hidden: Path | None = None,
          stop: threading.Event | None = None) -> Submission:
    """Run one notebook in a fresh process, in its own folder, all of it even where cells fail.

    limit : s, for the whole notebook. hidden : the folder of all submissions, which a sandbox does not show. stop : to
    be set by another thread; then Stopped is raised. Otherwise nothing that a notebook holds or does raises.
    """
    try:
        cells = submission.code_cells(path)
    except (OSError, ValueError) as error:
        return Submission(name, problem=f"not a readable notebook: {shown(error)}")
    path = path.resolve()
    with tempfile.TemporaryDirectory(prefix="vislam_edu-", ignore_cleanup_errors=True) as scratch:
        problem = _run(path, Path(scratch), limit, sandbox, hidden or path.parent, stop or threading.Event())
        record = Path(scratch) / "verdicts.jsonl"
        verdicts, errors, ended = _verdicts(record), {}, False
        for entry in _entries(record):
            ended = ended or entry.get("end") is True
            if isinstance(entry.get("cell"), int):
                errors[entry["cell"]] = shown(entry.get("error"))
    if not problem and not ended:
        problem = "its process ended before the notebook did (out of memory, or the notebook ended it)"
    checked = {exercise: errors.get(number, "") for number, source in enumerate(cells)
               for exercise in _CALL.findall(source)}
    return Submission(name, [
        verdicts[exercise] if exercise in verdicts
        else Result(exercise, NO_VERDICT, detail=checked[exercise]) if exercise in checked
        else Result(exercise, MISSING) for exercise in _expected(path, cells, checked)], problem)


def _expected(path, cells, checked) -> list[str]:
    """The exercises of the chapters that a notebook is about: by its name and its checks, or else by its functions."""
    names = set(checked) or {name for source in cells for name in _STUB.findall(source)}
    chapters = {exercise.chapter for name, exercise in EXERCISES.items() if name in names}
    if found := _CHAPTER.match(path.name):
        chapters.add(int(found[1]))
    return [name for name, exercise in EXERCISES.items() if exercise.chapter in chapters]


def _run(path, scratch, limit, sandbox, hidden, stop) -> str:
    """Run a notebook, wait for it and end all that it has started. Returns the problem, "" if it ran to its end."""
    record, token = scratch / "verdicts.jsonl", scratch.name
    own = {VERDICTS: str(record), "IPYTHONDIR": str(scratch), "OPENBLAS_NUM_THREADS": "1",
           "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    environment = {key: value for key, value in os.environ.items() if key.upper() in _PASSED_ON} | own
    python = ["-P", "-c", _RUN, str(path), str(record), str(int(limit) + 10)]
    command = (sandbox.command(python, path.parent, scratch, hidden, own, token) if sandbox
               else [sys.executable, *python])
    complaints = scratch / "stderr"
    with open(complaints, "wb") as stderr:
        process = subprocess.Popen([*_BETWEEN, *command], env=environment, stdin=subprocess.DEVNULL,
                                   stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True)
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
    if not record.exists():  # it did not come to the first cell
        lines = complaints.read_text(encoding="utf-8", errors="replace").split("\n")
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


def _entries(record) -> list[dict[str, Any]]:
    """The lines of a record that are JSON objects; the rest was cut off, or written by the submission itself."""
    entries = []
    with suppress(OSError, ValueError):
        for line in submission.read(record).splitlines():
            with suppress(ValueError, RecursionError):
                entries.append(json.loads(line))
    return [entry for entry in entries if isinstance(entry, dict)]


def _verdicts(record) -> dict[str, Result]:
    """The last verdict on each exercise, as far as the record makes sense.

    A score of the capstone stands beside the verdict of its check and never replaces it: without a check the exercise
    counts as not written.
    """
    results: dict[str, Result] = {}
    scores: dict[str, dict | None] = {}
    for entry in _entries(record):
        name, status = entry.get("exercise"), entry.get("status")
        if not (isinstance(name, str) and name in EXERCISES):
            continue
        if "score" in entry:
            scores[name] = _score(entry["score"])
        if status in (RIGHT, WRONG, NOT_WRITTEN):
            results[name] = Result(name, status, shown(entry.get("mistake", "")), _lines(entry.get("text", "")))
    for name, score in scores.items():
        results[name] = replace(results.get(name) or Result(name, NOT_WRITTEN), score=score)
    return results


def _lines(text, most=10_000) -> str:
    """Text of several lines without control characters."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in str(text)[:most])


def _score(score) -> dict | None:
    """A capstone's figures with nothing but short texts and numbers in them, else None."""
    drives = score.get("drives") if isinstance(score, dict) else None
    if not isinstance(drives, list) or not all(isinstance(row, dict) for row in drives):
        return None
    return {"drives": [{shown(key, 40): value if isinstance(value, float | int | None) else shown(value)
                        for key, value in list(row.items())[:40]} for row in drives[:20]]}
