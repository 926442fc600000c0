"""Whose work an answer is: what of the package it calls, and which answers of two students are the same code.

A function counts as borrowed where it is the package's own, or calls what the exercise stands for: `EXERCISES`,
`solution`, the function that `solution` shows first, one of the same name, or one of a later exercise. It may call what
the exercise's own plain answers call, what earlier exercises show, and the small tools in `TOOLS`. A stage of the
capstone is to be made of the student's own pieces: nothing that its `solution` shows.
"""

import ast
import builtins
import functools
import inspect
import itertools
import re
import sys
import sysconfig
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..checks.exercise import Exercise
from ..checks.running import tree_of
from ..exercises import EXERCISES

TOOLS = ("se3.", "noise.", "drive.", "belief.", "stereo.StereoCamera.imu_T_cam", "stereo.StereoCamera.cam_T_imu",
         "stereo.StereoCamera.to_world", "stereo.StereoCamera.to_cam", "stereo.StereoCamera.K_s")
CAPSTONE = 13  # chapter
# Words of a notebook that means to reach the machinery of its own check.
MEDDLING = re.compile(r"sys\.modules|_getframe|currentframe|setprofile|settrace|\bctypes\b|\bgc\.|/proc/|\bos\.kill"
                      r"|course\.(?:checks|grading)|importlib\.reload|sys\.argv|__code__|mock\.patch"
                      r"|^\s*(?:check|json|np|numpy|capstone|se3|builtins)(?:\.\w+)+\s*=[^=]|setattr\(|monkeypatch",
                      re.MULTILINE)

_PACKAGE = str(Path(__file__).resolve().parents[2])
_LIBRARIES = tuple({sysconfig.get_path(key) for key in ("stdlib", "purelib", "platlib")})


# --- in the student's process -----------------------------------------------------------------------------


def watched(function: Callable, uses: set[str], theirs: Iterable[str] = ()) -> Callable:
    """The function; while it runs, the package's functions that it calls directly are noted in `uses`.

    theirs : files of the package that count as the function's own.
    """
    theirs = {*theirs}

    def note(frame, event, _):
        if event != "call" or not _in_package(frame, theirs):
            return
        caller = frame.f_back
        while caller is not None and caller.f_code.co_filename.startswith(_LIBRARIES):
            caller = caller.f_back
        if caller is None or caller.f_code.co_filename == __file__ or not _in_package(caller, theirs):
            name = f"{frame.f_globals.get('__name__', '')}.{frame.f_code.co_qualname}"
            uses.add(name.removeprefix("vislam_edu.").replace(".<locals>", ""))

    def noted(step, *arguments):
        sys.setprofile(note)
        try:
            return step(*arguments)
        finally:
            sys.setprofile(None)

    def states(generator):
        with suppress(StopIteration):
            while True:
                yield noted(next, generator)

    def call(*arguments):
        result = noted(function, *arguments)
        return states(result) if inspect.isgenerator(result) else result

    with suppress(Exception):  # a callable without the attributes of a function
        return functools.wraps(function)(call)
    return call


def _in_package(frame, theirs) -> bool:
    file = frame.f_code.co_filename
    return file.startswith(_PACKAGE) and file not in theirs


def in_notebook(function: Any) -> bool:
    """Whether a function was defined by a cell of a notebook, and not by a file or by text that was executed."""
    function = inspect.unwrap(function)
    function = getattr(function, "func", getattr(function, "pyfunc", function))  # functools.partial, np.vectorize
    code = getattr(function, "__code__", None) or getattr(vars(type(function)).get("__call__"), "__code__", None)
    return any(mark in getattr(code, "co_filename", "") for mark in ("ipykernel", "<ipython-input"))


# --- in the grader's process ------------------------------------------------------------------------------


def borrowed(exercise: Exercise, uses: Iterable[str]) -> list[str]:
    """Which of the functions that an answer calls it may not."""
    return sorted(use for use in uses if not _may_use(exercise, use))


def _may_use(exercise: Exercise, use: str) -> bool:
    last = use.rpartition(".")[2]
    if use in _used_by_answers(exercise) or re.fullmatch(r"__\w+__", last):
        return True
    own = _shown(exercise)
    if use.startswith("course.") or last == exercise.name or use in (own if exercise.chapter == CAPSTONE else own[:1]):
        return False
    names = list(EXERCISES)
    first = next((name for name in names if use in _shown(EXERCISES[name])), None)
    return use.startswith(TOOLS) if first is None else names.index(first) < names.index(exercise.name)


def _shown(exercise: Exercise) -> list[str]:
    return [f"{function.__module__}.{function.__qualname__}".removeprefix("vislam_edu.")
            for function in exercise.shows]


@functools.cache
def _used_by_answers(exercise: Exercise) -> set[str]:
    uses: set[str] = set()
    for answer in exercise.answers:
        own = watched(answer, uses, [answer.__code__.co_filename])
        with np.errstate(all="ignore"):
            for _, arguments in exercise.inputs():
                result = own(*arguments)
                if exercise.reading:
                    exercise.reading(result)
    return uses


def asks_for_solution(sources: Iterable[str], name: str, here: bool) -> bool:
    """Whether the last definition of a function calls `EXERCISES` or `solution`; where no cell holds it, any cell."""
    node = definitions(sources).get(name)
    if not here or node is None:
        return any(re.search(r"\bEXERCISES\b|\bsolution\(", source) for source in sources)
    calls = {part.func.id for part in ast.walk(node) if isinstance(part, ast.Call) and isinstance(part.func, ast.Name)}
    items = {part.value.id for part in ast.walk(node)
             if isinstance(part, ast.Subscript) and isinstance(part.value, ast.Name)}
    return "solution" in calls or "EXERCISES" in items


def definitions(sources: Iterable[str]) -> dict[str, ast.FunctionDef]:
    """The last definition of each exercise's function in these cells."""
    found = {}
    for source in sources:
        with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
            found.update({node.name: node for node in ast.parse(source).body
                          if isinstance(node, ast.FunctionDef) and node.name in EXERCISES})
    return found


def forms(sources: Iterable[str]) -> dict[str, str]:
    """The answers in these cells without names, comments and layout, where they say more than any answer must.

    Left out are those as short as the shortest right answer, and those that are a plain answer of the package.
    """
    found = {}
    for name, node in definitions(sources).items():
        with suppress(RecursionError):
            form = _form(node)
            plain = _plain_forms(name)
            if form not in plain and len(form) > min(map(len, plain)):
                found[name] = form
    return found


@functools.cache
def _plain_forms(name: str) -> list[str]:
    trees = list(filter(None, map(tree_of, EXERCISES[name].answers)))
    return [_form(node) for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)][:len(trees)]


def _form(function: ast.FunctionDef) -> str:
    """The code of a function: its own names by number, in the order in which they appear; no docstring, no hints."""
    body = function.body[ast.get_docstring(function) is not None:]
    own = {node.arg for node in ast.walk(function) if isinstance(node, ast.arg)} | {
        node.id for line in body for node in ast.walk(line)
        if isinstance(node, ast.Name) and (isinstance(node.ctx, ast.Store) or not hasattr(builtins, node.id))}
    numbers: dict[str, int] = {}
    text = " ".join(ast.dump(line) for line in body)
    return re.sub(r"(?<=(?:id|rg)=')\w+(?=')", lambda match: f"v{numbers.setdefault(match[0], len(numbers))}"
                  if match[0] in own else match[0], text)


def pairs(answers: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str, list[str], int]]:
    """Pairs of students with equal answers: the two, which exercises, and how many both wrote; the most first.

    answers : of each student, `forms`. An answer that more than a third of the class shares, and more than two, does
    not count: it is how one writes it.
    """
    counts = Counter((name, form) for own in answers.values() for name, form in own.items())
    usual = {key for key, count in counts.items() if count > max(2, len(answers) / 3)}
    found = []
    for (one, first), (other, second) in itertools.combinations(answers.items(), 2):
        both = first.keys() & second.keys()
        equal = [name for name in EXERCISES if name in both and first[name] == second[name]
                 and (name, first[name]) not in usual]
        if equal:
            found.append((one, other, equal, len(both)))
    return sorted(found, key=lambda pair: -len(pair[2]))
