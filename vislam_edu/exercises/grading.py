"""Run submitted notebooks and collect the verdicts of their checks.

A submitted notebook is a program of its author: running it does, with your rights, whatever it says. Run
strangers' notebooks where nothing can be lost or learned: a container or virtual machine without network, with the
submissions read-only and as a user who owns nothing. The time limit ends what takes too long; it protects from
nothing else. And a verdict comes from the same process as the student's code, which can fake it: what looks too
good is worth reading.
"""

import json
import os
import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from . import kernel
from .check import VERDICTS
from .exercise import EXERCISES

LIMIT = 300.0  # s, for one notebook
NO_VERDICT = "no verdict"

_CALL = re.compile(r"\bcheck\.(\w+)\s*\(")
# What a kernel needs of the environment. The rest stays here: it may hold passwords and tokens.
_PASSED_ON = {"PATH", "HOME", "USER", "LANG", "LC_ALL", "TZ", "TMPDIR", "TEMP", "TMP", "SYSTEMROOT", "SYSTEMDRIVE",
              "COMSPEC", "PATHEXT", "USERPROFILE", "APPDATA", "LOCALAPPDATA", "PYTHONPATH", "VIRTUAL_ENV",
              "CONDA_PREFIX", "LD_LIBRARY_PATH", "JUPYTER_PATH", "MPLCONFIGDIR", "XDG_CACHE_HOME"}


@dataclass(frozen=True)
class Result:
    """What became of one exercise of one notebook. status : of the last check that ran, or NO_VERDICT.

    score : of the capstone, what `capstone.Score.figures` holds; else None.
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


def notebooks(path: Path) -> list[Path]:
    """The notebooks at a path: itself, or all in and below a folder. Raises OSError when there are none."""
    if not path.is_dir():
        if not path.is_file():
            raise FileNotFoundError(2, "there is no such notebook or folder", str(path))
        return [path]
    found = [file for file in sorted(path.rglob("*.ipynb")) if ".ipynb_checkpoints" not in file.parts]
    if not found:
        raise FileNotFoundError(2, "no notebooks in this folder", str(path))
    return found


def grade(path: Path, name: str, limit=LIMIT) -> Submission:
    """Run one notebook in a fresh kernel, in its own folder, all of it even where cells fail.

    limit : s, for the whole notebook. Never raises because of what a notebook holds.
    """
    import nbformat

    try:
        notebook = nbformat.reads(path.read_text(encoding="utf-8"), as_version=4)
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    except Exception as error:  # nbformat raises what its parsers raise
        return Submission(name, problem=f"not a readable notebook: {_one_line(error)}")
    for cell in code:
        cell.outputs, cell.execution_count = [], None
    problem, verdicts = _execute(notebook, path.resolve().parent, limit)
    return Submission(name, [verdicts.get(exercise) or Result(exercise, NO_VERDICT, detail=detail)
                             for exercise, detail in _checked(code).items()], problem)


def _checked(code) -> dict[str, str]:
    """The exercises that code cells check, in the order of the chapters, and the error of the checking cell."""
    found = {}
    for cell in code:
        errors = [f"{output.ename}: {output.evalue}" for output in cell.outputs if output.output_type == "error"]
        for name in _CALL.findall(cell.source):
            found[name] = _one_line(errors[0]) if errors else ""
    return {name: found[name] for name in EXERCISES if name in found}


def _execute(notebook, folder, limit):
    """Run in place. Returns the problem, if any, and the last verdict on each exercise."""
    from nbclient.exceptions import DeadKernelError

    problem = ""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        record = Path(scratch) / "verdicts.jsonl"
        environment = {key: value for key, value in os.environ.items() if key.upper() in _PASSED_ON}
        environment |= {VERDICTS: str(record), "IPYTHONDIR": scratch, "OPENBLAS_NUM_THREADS": "1"}
        try:
            kernel.execute(notebook, folder, environment, limit, timeout=None, allow_errors=True,
                           shutdown_kernel="immediate")
        except TimeoutError:
            problem = f"stopped after {limit:g} s"
        except DeadKernelError:
            problem = "the kernel died (out of memory, or the notebook ended it)"
        return problem, _verdicts(record)


def _verdicts(record) -> dict[str, Result]:
    results: dict[str, Result] = {}
    if record.exists():
        for line in record.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
                before = results.get(entry["exercise"])
                result = Result(entry["exercise"], entry["status"], entry["mistake"], entry["text"],
                                entry.get("score", before and before.score))
            except (ValueError, KeyError, TypeError):
                continue  # cut off by a dying kernel, or written by the submission itself
            if result.exercise in EXERCISES:
                results[result.exercise] = result
    return results


def _one_line(error) -> str:
    return " ".join(str(error).split())[:200]
