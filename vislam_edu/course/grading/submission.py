"""A submitted notebook in a process of its own: its cells are run, and what its functions return is written down.

`grading` starts `run` in a fresh process. The cells run in an IPython shell without a kernel: all processes stay in one
group, no messages have to be understood, and no network is needed. After each cell, every function that the cell gives
to a check is put to the inputs of its exercise, which the seed makes the same everywhere; the results go to the grader
as numbers and words, and the grader judges them in its own process. What works here is a copy of the package from which
the notebook's imports are cut off, and each line is signed with a key that the grader hands over before the first cell.
"""

import ast
import json
import os
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from hashlib import blake2s
from pathlib import Path

import numpy as np

from ..ch13 import capstone
from ..checks import surroundings
from ..checks.exercise import Exercise
from ..checks.running import Outcome, Unreadable, error_message
from ..checks.verdict import Attempt, attempt
from ..exercises import EXERCISES
from . import borrowing

LARGEST = 50_000_000  # characters that are read of a notebook, or of what its checks recorded
MEMORY, FILE_SIZE = 4 << 30, 100 << 20  # bytes, for each process and for each file that it writes
MOST_NUMBERS = 20_000  # that one result may have; a right one has a few hundred
CELLS, RECORD = "cells.json", "record"  # names of files


def read(path: Path, most: int = LARGEST) -> str:
    """The text of a regular file. Raises OSError, and ValueError for another kind of file or too much text."""
    if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would wait, a device never end
        raise ValueError("not a regular file")
    with open(path, encoding="utf-8") as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise ValueError(f"has more than {most} characters")
    return text


def code_cells(text: str) -> list[str]:
    """The sources of the code cells of a notebook. Raises ValueError for what is no notebook."""
    try:
        content = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(content, dict) or content.get("nbformat") != 4 or not isinstance(content.get("cells"), list):
        raise ValueError("not a notebook of version 4")
    sources = []
    for cell in content["cells"]:
        source = cell.get("source") if isinstance(cell, dict) else None
        lines: list = source if isinstance(source, list) else [source]
        if not all(isinstance(line, str) for line in lines):
            raise ValueError("a cell without a source")
        if cell.get("cell_type") == "code":
            sources.append("".join(lines))
    return sources


def run(folder: Path, scratch: Path, seconds: int) -> None:
    """Run the cells of a notebook in its folder, all of them even where some fail, and end this process.

    scratch : holds CELLS, the code cells as JSON, and receives RECORD. The key for that is the first line of the
    standard input. seconds : of processor time that the system allows.
    """
    from IPython.core.inputtransformer2 import TransformerManager
    from IPython.core.interactiveshell import InteractiveShell

    sources = json.loads((scratch / CELLS).read_text(encoding="utf-8"))
    record = _Record(scratch / RECORD, sys.stdin.readline().strip())
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for name in [name for name in sys.modules if name.partition(".")[0] == "vislam_edu"]:
        del sys.modules[name]  # the notebook gets a copy of its own, to do with as it likes
    import vislam_edu.course.exercises  # noqa: F401 - before anything beside the notebook that has the same name

    _restrict(seconds)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # up to here the reader's; its output is not wanted
    os.chdir(folder)
    sys.path.insert(0, "")
    shell, plain = InteractiveShell.instance(), TransformerManager().transform_cell
    for number, source in enumerate(sources):
        result = shell.run_cell(source, store_history=True)
        error = result.error_before_exec or result.error_in_exec
        if error is not None:
            record.add({"cell": number, "error": _described(error)})
        with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
            for name, call in calls(plain(source)):
                record.add(_followed(name, call, shell.user_ns))
    record.add({"end": True})
    os._exit(0)  # without waiting for threads that the notebook has left


class _Record:
    """Lines that the grader believes: each is JSON behind a digest of it, made with the key."""

    def __init__(self, path, key):
        self.file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        self.key, self.encode, self.write = key, json.JSONEncoder().encode, os.write

    def add(self, entry):
        text = self.encode(entry)
        line = f"\n{signature(text, self.key)} {text}\n".encode()
        with suppress(OSError):
            while line:
                line = line[self.write(self.file, line):]


def signature(text: str, key: str) -> str:
    return blake2s(text.encode(), key=key.encode()).hexdigest()


def calls(source: str) -> Iterator[tuple[str, ast.Call]]:
    """The calls `check.NAME(...)` and `capstone.score(...)` in a cell, with NAME or "score". Raises SyntaxError."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="check"), attr=name), args=[_]) if name in EXERCISES:
                yield name, node
            case ast.Call(func=ast.Attribute(value=ast.Name(id="capstone"), attr="score"), args=[_, *_]):
                yield "score", node


def _followed(name: str, call: ast.Call, namespace: dict) -> dict:
    """What the function that a cell gives to a check does, or to the capstone's score."""
    try:
        function, *others = (_value(argument, namespace) for argument in call.args)
        options = {keyword.arg: _value(keyword.value, namespace) for keyword in call.keywords if keyword.arg}
        if name == "score":
            if not borrowing.in_notebook(function):  # the agreed filter is nobody's answer
                return {}
            surroundings.restored()  # of numpy there is only one
            return {"exercise": "filter_run", "score": capstone.scored(function, *others, **options).figures}
        return {"exercise": name} | (tried(name, function) if callable(function) else {"attempt": None})
    except BaseException as error:  # SystemExit included: the cell may mean to end the kernel
        return {"exercise": name, "error": _described(error)}


def _value(node, namespace):
    return eval(compile(ast.Expression(node), "<check>", "eval"), namespace)


# --- results as data --------------------------------------------------------------------------------------


def tried(name: str, function: Callable) -> dict:
    """A function put to all inputs of an exercise: its `Attempt` as JSON can hold it.

    uses : names of the functions of the package that it calls directly. here : whether its code is in the notebook.
    """
    uses: set[str] = set()
    made = attempt(EXERCISES[name], borrowing.watched(function, uses))
    return {"attempt": vars(made) | {"outcomes": list(map(_sent, made.outcomes))}, "uses": sorted(uses),
            "here": borrowing.in_notebook(function)}


def _sent(outcome: Outcome) -> dict:
    values, error = outcome.values, outcome.error
    if sum(value.size for value in values or []) > MOST_NUMBERS:
        error = Unreadable(f"it returned arrays of the shapes {[value.shape for value in values or []]}")
    return vars(outcome) | {
        "values": None if error or values is None else [[value.shape, value.tobytes().hex()] for value in values],
        "error": error and [type(error).__name__, _words(error), error_message(error)]}


def received(content: dict, exercise: Exercise) -> Attempt:
    """The attempt that `tried` has sent."""
    results = len(exercise.outputs) or 1
    return Attempt(**content | {"outcomes": [_outcome(outcome, results) for outcome in content["outcomes"]]})


def _outcome(content, results) -> Outcome:
    values, error = content["values"], content["error"]
    if values is not None and len(values) != results:  # the notebook has changed what sends them
        error, values = [Unreadable.__name__, *2 * [f"{len(values)} results came, not {results}"]], None
    return Outcome(**content | {
        "values": values and [np.frombuffer(bytes.fromhex(numbers)).reshape(shape) for shape, numbers in values],
        "error": error and _raised(*error), "changed": tuple(content["changed"]),
        "remarks": tuple(content["remarks"])})


def _raised(kind, words, told) -> BaseException:
    """An exception of the kind of another process, as far as a verdict looks at it."""
    known = {error.__name__: error for error in (Unreadable, np.linalg.LinAlgError, ZeroDivisionError, TypeError,
                                                 NameError, ValueError, IndexError)}
    error = known.get(kind, Exception)(words)
    error.told = told  # type: ignore[attr-defined]
    return error


def _restrict(seconds: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    for limit, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, FILE_SIZE),
                        (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
        with suppress(ValueError, OSError):  # a stricter limit is in force, or the system has none of this kind
            resource.setrlimit(limit, (most, most))


def _described(error: BaseException) -> str:
    return f"{type(error).__name__}: {_words(error)}"[:1000]


def _words(error: BaseException) -> str:
    try:
        return str(error)[:10_000]
    except BaseException:  # its own __str__ fails
        return ""
