"""Calling a function that someone else wrote: copies in, arrays out, a time limit, and errors named as theirs."""

import ast
import contextlib
import copy
import ctypes
import inspect
import linecache
import os
import re
import sys
import sysconfig
import textwrap
import threading
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

from . import surroundings

LIMIT = 5.0  # s of CPU time, for all inputs of one check together; a right answer takes milliseconds
_PATIENCE = 8.0  # times the limit may pass by the clock on the wall: then an answer waits for something, or sleeps
_POLL = 0.02  # s
_GRACE = 0.2  # s, for a stopped answer to end
_DEEPEST = 10_000  # calls within calls that an answer may ask for

_PACKAGE = Path(__file__).resolve().parents[2]
_NOT_THEIRS = [*(f"{path}{os.sep}" for path in [_PACKAGE, *(sysconfig.get_path(key) for key in (
    "stdlib", "purelib", "platlib"))]), "<frozen"]
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")


class Unreadable(Exception):
    """An answer that is no array of numbers, or not the promised number of arrays."""


class _Stop(BaseException):
    """Thrown into an answer that takes too long. No Exception: `except Exception` must not catch it."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one input: either `values`, or the `error` that was raised.

    blank : the function is a stub (it raised NotImplementedError, or returned None or `...`), or calls one: then
    `calls` names it. nothing : it returned None.
    changed : names of the arguments that the call changed. precise : no result was of less than 64 bits.
    remarks : what was made of an unusual result, in words.
    """

    values: list | None = None
    error: BaseException | None = None
    blank: bool = False
    calls: str = ""
    nothing: bool = False
    changed: tuple[str, ...] = ()
    precise: bool = True
    remarks: tuple[str, ...] = ()


def answers(exercise, function, cases, limit=LIMIT) -> tuple[list[Outcome], str]:
    """Put a function to every case. Returns the outcomes so far and, if time ran out, what became of it.

    The second result is "" (all done), "stopped", or "running" where the answer could not be stopped. Works in
    the main thread of a notebook and on every system: the answer runs in a thread of its own, into which an
    exception is thrown when the time is up. Code that never returns to Python (one endless numpy call) cannot
    be reached that way.
    """
    outcomes: list[Outcome] = []

    def work():
        with np.errstate(all="ignore"):
            for _, arguments in cases:
                outcomes.append(outcome_of(exercise, function, arguments))
                if outcomes[-1].blank:
                    return

    with surroundings.guarded():
        ended = within(work, limit)
    return outcomes[:len(cases)], ended if len(outcomes) < len(cases) else ""


def within(work, limit) -> str:
    """Run `work()` in a thread of its own; "" if it came to its end, else see `answers`. limit : s of CPU time.

    CPU time, because a busy machine must not change a verdict. Where a thread has no clock of its own it is that of
    the process, which does nothing else meanwhile. The work may not recurse deeper than `_DEEPEST`, whatever it asks
    for. What it asked for is undone by the thread itself, when it ends: Python aborts when the limit is lowered under
    a thread that is deep in its calls.
    """
    before, ask = sys.getrecursionlimit(), sys.setrecursionlimit
    capped = mock.patch.object(sys, "setrecursionlimit", lambda depth: ask(min(depth, max(before, _DEEPEST))))
    clocks: list[int] = []

    def guarded():
        if hasattr(time, "pthread_getcpuclockid"):
            clocks.append(time.pthread_getcpuclockid(threading.get_ident()))
        try:
            with contextlib.suppress(_Stop):
                work()
        finally:
            capped.stop()
            ask(before)

    def spent() -> float:
        with contextlib.suppress(OSError, IndexError):  # no clock, not started yet, or ended just now
            return time.clock_gettime(clocks[0])
        return time.process_time() - started

    capped.start()
    thread = threading.Thread(target=guarded, daemon=True)
    started, end = time.process_time(), time.monotonic() + _PATIENCE * limit
    with warnings.catch_warnings():  # a warning would show a path that differs from run to run
        warnings.simplefilter("ignore")
        try:
            thread.start()
            while thread.is_alive() and spent() < limit and time.monotonic() < end:
                thread.join(_POLL)
        except RuntimeError:  # a system without threads, such as Python in a browser: no time limit there
            guarded()
        finally:  # also when the student interrupts the kernel
            ended = _stop(thread) if thread.is_alive() else ""
    return ended


def _stop(thread) -> str:
    for _ in range(3):  # an answer with a bare `except:` in its loop takes more than one
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(_Stop))
        thread.join(_GRACE)
        if not thread.is_alive():
            return "stopped"
    return "running"


def outcome_of(exercise, function, arguments) -> Outcome:
    """Call a function on copies of the arguments and read its result."""
    given = [copied(argument) for argument in arguments]
    changed: tuple[str, ...] = ()
    try:
        result = function(*given)
        if result is None or result is ... or result is NotImplemented:
            return Outcome(blank=True, nothing=result is None)
        if exercise.reading:
            result = exercise.reading(_as_yielded(result) if inspect.isgenerator(result) else result)
        changed = tuple(name for name, before, after in zip(exercise.arguments, arguments, given)
                        if not _alike(before, after))
        values, precise, remarks = read(result, exercise.outputs)
        return Outcome(values, changed=changed, precise=precise, remarks=remarks)
    except NotImplementedError as error:
        raised_in = _their_frames(error)[-1:]
        calls = [frame.name for frame in raised_in if frame.name != getattr(function, "__name__", frame.name)]
        return Outcome(blank=True, calls="".join(calls))
    except _Stop:
        raise
    except BaseException as error:  # SystemExit included: an answer must not end the kernel, whatever it returns
        return Outcome(error=error, changed=changed)


def _as_yielded(states) -> list:
    """What a generator yields. Raises Unreadable where it changes afterwards what it has yielded."""
    kept = [(state, copied(state)) for state in states]
    if not all(_alike(*pair) for pair in kept):
        raise Unreadable("your function changes an array after it has yielded it, and whoever has kept it finds the "
                         "last state in place of each: yield a copy, or make a new array in each step")
    return [state for state, _ in kept]


def _alike(before, after) -> bool:
    """Whether an array, or each array of a tuple, has kept its numbers."""
    if isinstance(before, tuple | list):
        return len(before) == len(after) and all(map(_alike, before, after))
    return not isinstance(before, np.ndarray) or np.array_equal(before, after, equal_nan=before.dtype.kind == "f")


def tree_of(function) -> ast.Module | None:
    """The syntax tree of a function's source; None where it has none, or is a lambda in the middle of a line."""
    try:
        return ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError):
        return None


def written(function) -> bool:
    """Whether a function holds more than a stub does: its docstring, `raise`, `pass`, `...`, `return None`."""
    tree = tree_of(function)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)] if tree else []
    return any(not _is_stub_line(line) for node in functions[:1] for line in node.body)


def _is_stub_line(line) -> bool:
    if isinstance(line, ast.Expr | ast.Return):
        return line.value is None or isinstance(line.value, ast.Constant)
    return isinstance(line, ast.Raise | ast.Pass)


def copied(argument):
    """An argument that may be written to: a copy of an array or of the camera; numbers cannot change."""
    if isinstance(argument, tuple):
        return tuple(map(copied, argument))
    if isinstance(argument, np.ndarray):
        return argument.copy()
    return argument if isinstance(argument, bool | int | float) else copy.deepcopy(argument)


def read(result, names) -> tuple[list, bool, tuple[str, ...]]:
    """A result as a list of float arrays, whether all came with 64 bits, and remarks. Raises Unreadable."""
    remarks: dict[str, None] = {}
    if names and isinstance(result, np.ndarray) and result.dtype.kind in "biuf" and result.shape[:1] == (len(names),):
        remarks[f"It returned one array where {len(names)} results are asked for; it was taken apart."] = None
        result = tuple(result)
    if not names:
        parts = [result]
    elif isinstance(result, (tuple, list)) and len(result) == len(names):
        parts = list(result)
    else:
        got = f"{len(result)} results" if isinstance(result, (tuple, list)) else f"one {type(result).__name__}"
        raise Unreadable(f"it must return {len(names)} results, {', '.join(names)}; it returned {got}")
    values, precise = [], True
    for part, name in zip(parts, names or ["the result"]):
        array = _array(part, name, remarks)
        if array.dtype.kind not in "biuf":
            raise Unreadable(f"{name} must be an array of real numbers, not {type(part).__name__} of {array.dtype}")
        precise &= array.dtype.kind != "f" or array.dtype.itemsize >= 8
        values.append(np.array(array, dtype=float))
    return values, precise, tuple(remarks)


def _array(part, name, remarks) -> np.ndarray:
    """One result as an array; what is unusual and still has numbers is converted, with a remark."""
    if inspect.isgenerator(part) or isinstance(part, map | zip | filter):
        raise Unreadable(f"{name} is a {type(part).__name__}, which makes its values one by one: wrap it in list(...)")
    if inspect.iscoroutine(part):
        part.close()
        raise Unreadable("the function is a coroutine: write def, not async def")
    if hasattr(part, "toarray"):
        remarks[f"({name} came as a sparse matrix and was made a plain array.)"] = None
        part = part.toarray()
    try:
        array = np.asarray(part)
    except ValueError:
        if isinstance(part, tuple):
            raise Unreadable(f"{name} must be one array, and it is a tuple of {len(part)}: return nothing besides the "
                             "result that the statement asks for") from None
        raise Unreadable(f"{name} is a list whose rows have different lengths") from None
    if array.dtype.kind == "c" and not array.imag.any():
        remarks[f"({name} came as complex numbers without imaginary parts: take .real.)"] = None
        return array.real
    if array.dtype.kind == "O":
        with contextlib.suppress(TypeError, ValueError, OverflowError):
            plain = array.astype(float)
            remarks[f"({name} came as an array of Python objects and was made one of numbers.)"] = None
            return plain
    return array


def _their_frames(error):
    """The frames of an exception that lie in the student's code, innermost last."""
    return [frame for frame in traceback.extract_tb(error.__traceback__)
            if not frame.filename.startswith(tuple(_NOT_THEIRS))]


def error_message(error) -> str:
    """An exception as its author needs it: their own lines, innermost last, and the message."""
    if isinstance(error, Unreadable):
        return str(error)
    if hasattr(error, "told"):  # it was raised in another process, which had the code
        return error.told
    lines = []
    for frame in _their_frames(error):
        code = linecache.getline(frame.filename, frame.lineno or 0).strip()
        lines.append(f"  line {frame.lineno} in {frame.name}:  {code}")
    message = " ".join(_ADDRESS.sub("0x...", str(error)[:2000]).split())
    return "\n".join([*lines[-4:], f"  {type(error).__name__}: {message}"])
