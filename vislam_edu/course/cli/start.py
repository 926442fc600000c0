"""`start`: a folder of one's own with the notebooks in it, opened in JupyterLab."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path

from ...cli import say
from ...cli.arguments import OptionError
from ...recordings import files, shipped
from ..guesses import without_guessed_outputs

FIRST = "00_start_here.ipynb"
COPIED = ("notebooks/*.ipynb", "notebooks/images/*", "docs/notation.md", "docs/reading.md")


def add_arguments(parser):
    parser.add_argument("folder", nargs="?", type=Path, default=Path("vislam_edu_notebooks"), metavar="FOLDER",
                        help="where the notebooks go (default: %(default)s); what is there already stays as it is")
    parser.add_argument("--no-open", action="store_true", help="copy only")


def run(arguments) -> int:
    """Copies, says what it did, and opens JupyterLab on chapter 00 unless asked not to."""
    if not arguments.no_open and find_spec("jupyterlab") is None:
        raise OptionError("JupyterLab is not installed: python -m pip install jupyterlab ipykernel (or --no-open)")
    copy_notebooks(arguments.folder)
    first = arguments.folder / "notebooks" / FIRST
    if arguments.no_open:
        return 0
    root = f"--ServerApp.root_dir={arguments.folder}"  # the pages in docs/ too, which chapter 00 links to
    return subprocess.call([sys.executable, "-m", "jupyterlab", root, str(first)])


def to_start_with(path: Path) -> bytes:
    """A file as a reader starts with it: in a notebook the results that are to be guessed are still to come."""
    if path.suffix != ".ipynb":
        return path.read_bytes()
    notebook = without_guessed_outputs(json.loads(path.read_text(encoding="utf-8")))
    return (json.dumps(notebook, ensure_ascii=False, indent=1, sort_keys=True) + "\n").encode()


def copy_notebooks(folder: Path, patterns: Iterable[str] = COPIED,
                   content: Callable[[Path], bytes] = to_start_with) -> None:
    """Copy the notebooks, their images and pages into a folder, never over a file that is there, and say how many.

    patterns : of what is copied. content : what is written of a file.
    """
    copied = kept = 0
    for path in (path for pattern in patterns for path in sorted(shipped.ROOT.glob(pattern))):
        target = folder / path.relative_to(shipped.ROOT)
        if target.exists():
            kept += 1
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with files.replacing(target) as file:
            file.write(content(path))
        copied += 1
    say(f"{folder}: {copied} files copied" + (f", {kept} were there and stay as they are" if kept else ""))
