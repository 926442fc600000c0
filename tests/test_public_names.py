"""The two lists that a reader goes by: the names in the package's docstring, the files in the README."""

import ast
import json
import re
from collections import Counter, defaultdict
from importlib import import_module
from inspect import ismodule
from pathlib import Path

import vislam_edu
from vislam_edu import exercises

ROOT = Path(__file__).resolve().parents[1]


def listed():
    """{file: names} as the package's docstring has them."""
    names = defaultdict(set)
    files, pictures = vislam_edu.__doc__.partition("What the chapters use")[2].split("and of the pictures")
    for prefix, table in (("", files), ("pictures.", pictures)):
        rows = re.sub(r"\n +", " ", table).splitlines()[2:]  # a long row goes on below
        names |= {prefix + row.split()[0]: set(row.split()[1:]) for row in rows if row}
    return names


def used():
    """{file: names} that the notebooks' cells import from the package, or reach through a file that they import."""
    names = defaultdict(set, exercises=set(exercises.__all__))  # hint and solution are for the student to call
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        files = {}  # by the name that the notebook gives them
        nodes = list(ast.walk(ast.parse(code(path))))
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.module.startswith("vislam_edu"):
                for alias in node.names:
                    if ismodule(look_up(node.module, alias.name)):
                        files[alias.name] = f"{node.module}.{alias.name}".removeprefix("vislam_edu.")
                    else:
                        names[node.module.removeprefix("vislam_edu.")].add(alias.name)
        for node in nodes:
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in files:
                names[files[node.value.id]].add(node.attr)
    return names


def code(path):
    """The cells of a notebook as one program, without IPython's own commands."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    return re.sub(r"(?m)^%.*$", "", text)


def look_up(module, name):
    """What `from module import name` gives."""
    try:
        return getattr(import_module(module), name)
    except AttributeError:
        return import_module(f"{module}.{name}")


def test_the_docstring_lists_what_the_chapters_use_and_nothing_else():
    assert listed() == used()


def test_what_is_listed_is_there_and_explained():
    for file, names in listed().items():
        for name in names:
            thing = look_up(f"vislam_edu.{file}", name)
            assert thing.__doc__ or not callable(thing), f"{file}.{name} has no docstring"


def test_the_readme_lists_every_file_of_the_package_once():
    table = (ROOT / "README.md").read_text(encoding="utf-8").partition("## The package")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    package = ROOT / "vislam_edu"
    files = [path.stem for path in package.glob("*.py") if path.stem != "__init__"]
    folders = [f"{path.parent.name}/" for path in package.glob("*/__init__.py")]
    assert Counter(re.findall(r"`([^`]+)`", " ".join(rows))) == Counter(files + folders)
