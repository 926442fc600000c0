"""`hand-out`: a folder for students: notebooks with empty stubs, their pages and drives, nothing of the teacher's."""

import warnings
from pathlib import Path

from ...cli import say
from ...recordings import shipped
from .start import COPIED, copy_notebooks


def add_arguments(parser):
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where it goes; what is there stays as it is")
    parser.add_argument("--chapters", nargs="+", metavar="NN", help="two digits each (default: all)")
    parser.add_argument("--keep-outputs", action="store_true",
                        help="leave what the cells print and draw, which answers the questions before them")


def run(arguments) -> int:
    """Copies; returns the exit status. Raises OSError."""
    chapters = arguments.chapters or ["*"]
    patterns = [f"notebooks/{chapter}_*.ipynb" for chapter in chapters] + [*COPIED[1:], "data/*.npz", "data/README.md"]
    missing = [chapter for chapter in chapters if not list(shipped.ROOT.glob(f"notebooks/{chapter}_*.ipynb"))]
    if missing:
        raise FileNotFoundError(2, "there is no notebook of this chapter", missing[0])
    copied, kept = copy_notebooks(arguments.folder, patterns, lambda path: _cleared(path, arguments.keep_outputs))
    say(f"{arguments.folder}: {copied} files copied" + (f", {kept} were there and stay as they are" if kept else ""))
    return 0


def _cleared(path: Path, keep_outputs: bool) -> bytes:
    """A file as students get it: in a notebook the answers in stubs are gone, and the outputs unless they are kept."""
    if path.suffix != ".ipynb":
        return path.read_bytes()
    import nbformat

    from ..grading import cells

    _, notebook = cells.read(path)
    cells.refresh(notebook)
    if not keep_outputs:
        notebook.metadata.pop("widgets", None)
        for cell in notebook.cells:
            if cell.cell_type == "code":
                cell.outputs, cell.execution_count = [], None
    with warnings.catch_warnings(action="ignore"):  # about cells without ids
        return (nbformat.writes(notebook).rstrip() + "\n").encode()
