"""What pip installs from a wheel: package, drives and notebooks, in a path with spaces, away from the clone."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from vislam_edu import cli
from vislam_edu.course.cli import start

CLONE = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted(path.name for path in (CLONE / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a wheel")
    source = folder / "source"
    shutil.copytree(CLONE, source, ignore=shutil.ignore_patterns(".git", "build", "*.egg-info", "__pycache__", ".venv"))
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder,
                    source], check=True)
    [path] = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder with the package alone in it, and the environment that imports it from there."""
    folder = tmp_path_factory.mktemp("with ö and spaces")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", folder, wheel],
                   check=True)
    return folder, os.environ | {"PYTHONPATH": str(folder)}


def shell(installed, *arguments, **options):
    return subprocess.run([sys.executable, "-m", "vislam_edu", *map(str, arguments)], env=installed[1], text=True,
                          capture_output=True, **options)


def test_the_wheel_holds_what_the_clone_has(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    modules = {str(path.relative_to(CLONE)) for path in (CLONE / "vislam_edu").rglob("*.py")}
    assert modules <= names
    assert {f"vislam_edu/shipped/notebooks/{name}" for name in NOTEBOOKS} <= names
    assert {"vislam_edu/shipped/data/street_loop.npz", "vislam_edu/shipped/data/first_steps.npz"} <= names
    assert not [name for name in names if name.startswith("tests")]
    extension = CLONE / "docs" / "labextensions"
    files = {path.relative_to(extension).as_posix() for path in extension.rglob("*.*")}
    assert files == {name.partition("/data/share/jupyter/labextensions/")[2] for name in names} - {""}


def test_a_shipped_drive_is_found_from_anywhere(installed, tmp_path):
    done = shell(installed, "info", "first_steps", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "42" in done.stdout


def test_the_console_script_is_the_command_line(installed):
    [entry] = installed[0].glob("vislam_edu-*.dist-info/entry_points.txt")
    assert "vislam_edu = vislam_edu.cli:main" in entry.read_text()
    assert shell(installed, "--help").stdout.count("start") >= 1


def test_a_notebook_copied_by_start_runs(installed, tmp_path):
    folder = tmp_path / "my notebooks"
    done = shell(installed, "start", folder, "--no-open", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (folder / "notebooks").glob("*.ipynb")) == NOTEBOOKS
    notebook = nbformat.read(folder / "notebooks" / "11_filter_to_graph.ipynb", as_version=4)
    notebook.cells = [cell for cell in notebook.cells if cell.get("id") in ("imports", "gtsam")]
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": folder / "notebooks"}}).execute(
        env=installed[1])
    assert notebook.cells[-1].outputs[0].text.count("cost at our estimate") == 2


def test_start_never_writes_over_a_students_work(tmp_path, capsys):
    first = tmp_path / "notebooks" / start.FIRST
    first.parent.mkdir()
    first.write_text("my answers")
    for _ in range(2):
        assert cli.main(["start", str(tmp_path), "--no-open"]) == 0
    assert first.read_text() == "my answers"
    assert {path.name for path in (tmp_path / "docs").iterdir()} == {"notation.md", "reading.md"}  # not the teacher's
    assert "0 files copied" in capsys.readouterr().out.splitlines()[-1]


def test_start_says_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(start, "find_spec", lambda name: None)
    assert cli.main(["start", str(tmp_path / "x")]) == 2
    assert "JupyterLab is not installed" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_package_that_is_missing_is_named_in_one_line(monkeypatch, capsys):
    def missing(argv):
        raise ModuleNotFoundError("No module named 'nbformat'", name="nbformat")

    monkeypatch.setattr(cli, "dispatch", missing)
    assert cli.main(["exercises"]) == 2
    assert "python -m pip install nbformat" in capsys.readouterr().err
