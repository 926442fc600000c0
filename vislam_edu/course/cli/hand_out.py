"""`hand-out`: a folder for students, notebooks with empty stubs and nothing of the teacher's, or one with answers."""

from pathlib import Path

from ...recordings import shipped
from .start import COPIED, copy_notebooks


def add_arguments(parser):
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where it goes; what is there stays as it is")
    parser.add_argument("--for", dest="readers", choices=("students", "teachers"), default="students",
                        help="students (default): empty stubs, nothing of the teacher's; teachers: the stubs hold "
                             "answers, and docs/instructor.md and docs/teaching.md of a clone are there too. Both: "
                             "notebooks, drives, docs/notation.md, docs/reading.md")
    parser.add_argument("--chapters", nargs="+", metavar="NN", help="as their files begin, 08b for one (default: all)")
    parser.add_argument("--keep-outputs", action="store_true",
                        help="leave what the cells print and draw, which answers the questions before them")


def run(arguments) -> int:
    """Copies; returns the exit status. Raises OSError."""
    chapters = arguments.chapters or ["*"]
    teachers = arguments.readers == "teachers"
    patterns = [f"notebooks/{chapter}_*.ipynb" for chapter in chapters] + [*COPIED[1:], "data/*.npz", "data/README.md"]
    patterns += ["docs/instructor.md", "docs/teaching.md"] if teachers else []
    missing = [chapter for chapter in chapters if not list(shipped.ROOT.glob(f"notebooks/{chapter}_*.ipynb"))]
    if missing:
        raise FileNotFoundError(2, "there is no notebook of this chapter", missing[0])
    copy_notebooks(arguments.folder, patterns, lambda path: _cleared(path, arguments.keep_outputs, teachers))
    return 0


def _cleared(path: Path, keep_outputs: bool, answers: bool = False) -> bytes:
    """A file as it is handed out: a notebook's stubs are empty or hold the answers, outputs are gone unless kept."""
    if path.suffix != ".ipynb":
        return path.read_bytes()
    import nbformat

    from ..checks.edit import plain_source
    from ..exercises import EXERCISES
    from ..grading import cells

    _, notebook = cells.read(path)
    cells.refresh(notebook)
    for cell in notebook.cells if answers else []:
        if exercise := EXERCISES.get(cell.metadata.get("nbgrader", {}).get("grade_id")):
            answer = plain_source(exercise.reference).partition("\n")[2]
            needed = "    from vislam_edu import se3\n" * ("se3." in answer)
            cell.source = cell.source.replace("    raise NotImplementedError\n", needed + answer)
    if not keep_outputs:
        notebook.metadata.pop("widgets", None)
        for cell in notebook.cells:
            if cell.cell_type == "code":
                cell.outputs, cell.execution_count = [], None
    return (nbformat.writes(notebook).rstrip() + "\n").encode()
