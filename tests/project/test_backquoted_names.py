"""Every name in backquotes in a docstring of the package, in CONTRIBUTING and in docs/ is one that there is."""

import ast
import importlib
import keyword
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "vislam_edu").rglob("*.py"))
TEXTS = [ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
NAME = re.compile(r"(?<!`)`([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\(\))?`(?!`)")
ELSEWHERE = {"nbgrader_config.py"}  # files of other programs
SCOPES = ast.Module | ast.ClassDef | ast.FunctionDef


@cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def docstrings(path):
    return "\n".join(ast.get_docstring(node) or "" for node in ast.walk(tree(path)) if isinstance(node, SCOPES))


def names_in(node):
    """The names that stand in code: variables, arguments, attributes, definitions, and strings that are one word."""
    for one in ast.walk(node):
        for field in ("id", "attr", "arg", "name", "asname"):
            yield from str(getattr(one, field, None) or "").split(".")
        if isinstance(one, ast.Constant) and isinstance(one.value, str) and one.value.isidentifier():
            yield one.value


@cache
def words():
    """Every name in the code of the package, and those of its modules and rooms."""
    found = {name for path in SOURCES for name in names_in(tree(path))}
    return found | {part for path in SOURCES for part in path.relative_to(ROOT).with_suffix("").parts}


@cache
def members():
    """{module, room or class: the names in it}, classes with what they inherit and what stands behind `self.`."""
    found, bases = defaultdict(set), defaultdict(set)
    for path in SOURCES:
        name = path.parent.name if path.stem == "__init__" else path.stem
        found[name] |= set(names_in(tree(path)))
        found[path.parent.name].add(path.stem)
        found[path.parent.parent.name].add(path.parent.name)
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ClassDef):
                found[node.name] |= set(names_in(node))
                bases[node.name] |= {base.id for base in node.bases if isinstance(base, ast.Name)}
    for name in bases:
        waiting = list(bases[name])
        while waiting:
            base = waiting.pop()
            found[name] |= found.get(base, set())
            waiting += bases.get(base, ())
    return found


def known(first, rest):
    """Whether `first.rest` is there: of a module, of a class, of a variable named as its class, or of a library."""
    owners = [name for name in members() if name == first or (name[0].isupper() and name.lower().endswith(first))]
    if owners:
        return any(rest.split(".")[0] in members()[name] for name in owners)
    try:
        value = importlib.import_module(first)
        for part in rest.split("."):
            value = getattr(value, part, None) or importlib.import_module(f"{value.__name__}.{part}")
    except (ImportError, AttributeError):
        return False
    return True


def missing(text, dotted_only=False):
    for name in dict.fromkeys(NAME.findall(text)):
        first, _, rest = name.partition(".")
        if keyword.iskeyword(first) or first == "self" or rest in ("csv", "json", "txt", "toml", "npz", "js"):
            continue
        if name.endswith("_") and any(word.startswith(name) for word in words()):  # `so3_`: what begins so
            continue
        if rest == "py":
            there = name in ELSEWHERE or any(ROOT.rglob(name))
        elif rest:
            there = (dotted_only and first not in members()) or known(first, rest)
        else:
            there = dotted_only or name in words()
        if not there:
            yield name


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_in_docstrings_are_there(path):
    assert list(missing(docstrings(path))) == []


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_names_in_the_documentation_are_there(path):
    """Names of other systems, which docs/notation.md lists beside the package's, are not looked for."""
    assert list(missing(path.read_text(encoding="utf-8"), dotted_only=True)) == []


PATH = re.compile(r"(?<![\w/.])((?:\.ci|benchmarks|data|docs|notebooks|tests|tools|vislam_edu)(?:/[\w.]+)+)")
MADE_UP = re.compile(r"NN|18")  # what a recipe makes


def gone(text):
    """What a text names of this repository that is not there: files, `python -m vislam_edu` commands."""
    yield from (path for path in PATH.findall(text)
                if not MADE_UP.search(path) and not (ROOT / path.rstrip(".")).exists())
    yield from (name for name in re.findall(r"python -m vislam_edu ([a-z]\w*)", text)
                if not list((ROOT / "vislam_edu").rglob(f"cli/{name}.py")))


def test_files_and_commands_of_contributing_are_there():
    text = TEXTS[0].read_text(encoding="utf-8")
    assert list(gone(text)) == []
    assert list(gone("`tests/nowhere.py`, python -m vislam_edu nothing")) == ["tests/nowhere.py", "nothing"]
    scripts = {path.relative_to(ROOT).as_posix() for path in (ROOT / "benchmarks").glob("*.py")}
    assert {path for path in PATH.findall(text) if path.startswith("benchmarks/") and path.endswith(".py")} == scripts


def test_a_name_that_is_gone_is_found():
    gone = ["slam.update", "recordings.py", "Belief.pose_variance", "nowhere_at" + "_all", "numpy.nothing"]
    there = ["se3.exp", "error_state.py", "drive.taus", "Belief.pose", "numpy.dtype", "window_slam"]
    assert list(missing(", ".join(f"`{name}`" for name in [*gone, *there]))) == gone
