"""Run the notebooks and store their outputs, so that running them again changes no byte.

    python tools/notebooks.py [--check] [--timings] [NOTEBOOK ...]
    python tools/notebooks.py --stubs CHAPTER       # print the exercise cells of a chapter
    python tools/notebooks.py --refresh NOTEBOOK    # bring its exercise cells up to date; answers in them are lost

What differs from run to run without meaning anything (timestamps, kernel details, random widget ids, the
version of the program that encoded a picture) is removed or numbered: a diff then shows a change of content.
"""

import asyncio
import base64
import importlib.util
import json
import os
import re
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from vislam_edu import cli
from vislam_edu.cli.arguments import OptionError
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import cells
from vislam_edu.recordings.files import replacing, shown

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
AT_ONCE = 2
CELL_TIMEOUT = 600  # s
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
KERNELSPEC = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
AUTHORED_CELL_METADATA = {"editable", "jupyter", "nbgrader", "slideshow", "tags"}


class NotebookError(ValueError):
    """A notebook that cannot be read or run; the message names the file and the cell."""


@dataclass(frozen=True)
class Execution:
    """One notebook, run: the text to store, its first difference from the stored one, the time taken (s)."""

    path: Path
    text: str
    change: str | None
    seconds: float


def execute(path: Path) -> Execution:
    """Run a notebook in its own folder. Writes nothing. Raises NotebookError."""
    start = time.perf_counter()
    stored, notebook = _read(path)
    _execute(notebook, path)
    _normalise(notebook)
    text = _to_text(notebook)
    return Execution(path, text, first_difference(stored, text), time.perf_counter() - start)


def _read(path):
    """The file's text, and the notebook in it without its outputs."""
    try:
        stored, notebook = cells.read(path)
    except (OSError, ValueError) as error:
        raise NotebookError(f"{path}: not a readable notebook: {shown(error)}") from error
    for cell in _code_cells(notebook):
        cell.outputs, cell.execution_count = [], None
    return stored, notebook


def _execute(notebook, path):
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    current = ["before the first cell"]

    def remember(cell, cell_index):
        current[0] = _name(cell, cell_index)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        try:  # widget state is collected (nbclient 0.11 hangs on Output widgets otherwise) and dropped by _normalise
            client = NotebookClient(notebook, kernel_name="python3", record_timing=False, timeout=CELL_TIMEOUT,
                                    extra_arguments=["--log-level=ERROR"],  # not its own log; warnings are outputs
                                    resources={"metadata": {"path": str(path.resolve().parent)}},
                                    coalesce_streams=True, on_cell_start=remember)
            asyncio.run(client.async_execute(env=_kernel_environment(profile)))
        except CellExecutionError as error:
            details = re.sub(r"\x1b\[[0-9;]*m", "", error.traceback)     # without colours
            raise NotebookError(f"{path}: {current[0]}: {error.ename}: {error.evalue}\n{details}") from error
        except CellTimeoutError as error:
            raise NotebookError(f"{path}: {current[0]}: still running after {CELL_TIMEOUT} s") from error
        except DeadKernelError as error:
            raise NotebookError(f"{path}: {current[0]}: the kernel died (out of memory?)") from error


def _kernel_environment(profile):
    """This environment without what would show in the outputs: personal settings, another drawing backend."""
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    return environment | {"IPYTHONDIR": profile}


def _normalise(notebook):
    """Remove what changes from run to run, in place. Cell ids stay."""
    notebook.metadata = {"kernelspec": KERNELSPEC, "language_info": {"name": "python"}}
    numbers: dict[str, str] = {}
    for cell in notebook.cells:
        cell.metadata = {key: value for key, value in cell.metadata.items() if key in AUTHORED_CELL_METADATA}
    for data in _output_data(notebook):
        if WIDGET_VIEW in data:
            view = data[WIDGET_VIEW]
            view["model_id"] = numbers.setdefault(view["model_id"], f"{len(numbers):032x}")
        if "image/png" in data:
            png = without_text_chunks(base64.b64decode(data["image/png"]))
            data["image/png"] = base64.b64encode(png).decode()


def without_text_chunks(png: bytes) -> bytes:
    """The same picture without its text chunks (matplotlib writes its own version there)."""
    kept, position = [PNG_SIGNATURE], len(PNG_SIGNATURE)
    while position < len(png):
        length = int.from_bytes(png[position:position + 4], "big")
        end = position + 4 + 4 + length + 4     # length, type, data, checksum
        if png[position + 4:position + 8] not in (b"tEXt", b"iTXt", b"zTXt"):
            kept.append(png[position:end])
        position = end
    return b"".join(kept)


def first_difference(stored: str, new: str) -> str | None:
    """Name the first cell in which two notebooks differ (None: the texts are equal)."""
    if stored == new:
        return None
    old_cells, new_cells = json.loads(stored)["cells"], json.loads(new)["cells"]
    for index, (old, cell) in enumerate(zip(old_cells, new_cells, strict=True)):
        for key in sorted(old.keys() | cell.keys()):
            if old.get(key) != cell.get(key):
                was, now = _where_they_part(json.dumps(old.get(key)), json.dumps(cell.get(key)))
                return f"{_name(cell, index)}: {key}: stored {was}, now {now}"
    return "the notebook's metadata or formatting"


def _where_they_part(old, new, width=60):
    same = next((i for i, (a, b) in enumerate(zip(old, new)) if a != b), min(len(old), len(new)))
    start = max(0, same - width // 3)
    return old[start:start + width], new[start:start + width]


def _name(cell, index):
    source = "".join(cell["source"]).strip()
    return f"cell {index + 1} ({source.splitlines()[0][:50] if source else 'empty'})"


def _code_cells(notebook):
    return (cell for cell in notebook.cells if cell.cell_type == "code")


def _output_data(notebook):
    return (output.data for cell in _code_cells(notebook) for output in cell.outputs if "data" in output)


def _to_text(notebook):
    import nbformat

    return nbformat.writes(nbformat.from_dict(notebook)) + "\n"


def _run_all(paths):
    """Yield an Execution or a NotebookError for each notebook as it ends, with a progress bar."""
    pool = ThreadPoolExecutor(AT_ONCE)
    try:
        tasks = [pool.submit(execute, path) for path in paths]
        for task in tqdm(as_completed(tasks), total=len(tasks), unit="notebook", leave=False):
            error = task.exception()
            if error is not None and not isinstance(error, NotebookError):
                raise error
            yield error or task.result()
    finally:
        pool.shutdown(cancel_futures=True)


def stubs(chapter: int) -> str:
    """The cells of a chapter's exercises as text."""
    chosen = [exercise for exercise in EXERCISES.values() if exercise.chapter == chapter]
    return "\n\n\n".join(cell.source for exercise in chosen for cell in cells.pair(exercise))


def refresh(path: Path) -> list[str]:
    """Bring the exercise cells of a notebook file up to date; returns the grade ids of those that changed.

    Raises OSError, and OptionError for what is no notebook of version 4.
    """
    try:
        _, notebook = cells.read(path)
    except ValueError as error:
        raise OptionError(f"{path}: {error}") from None
    changed = cells.refresh(notebook)
    if changed:
        with replacing(path) as file:
            file.write(_to_text(notebook).encode())
    return changed


def run(paths: list[Path], check: bool, timings: bool) -> int:
    """Run the notebooks. Returns 0, or 1 when a notebook failed or, with --check, would change.

    Raises OptionError when there is none, or when a package that runs them is missing.
    """
    paths = paths or sorted(NOTEBOOKS.glob("*.ipynb"))
    if not paths:
        raise OptionError(f"no notebooks in {NOTEBOOKS}; name the ones to run")
    for module in ("nbformat", "nbclient", "ipykernel"):
        if importlib.util.find_spec(module) is None:
            raise OptionError(f"{module} is needed to run notebooks: python -m pip install {module}")
    seconds, changed, failed = {}, 0, 0
    for outcome in _run_all(paths):
        if isinstance(outcome, NotebookError):
            failed += 1
            tqdm.write(f"failed: {outcome}")
            continue
        seconds[outcome.path] = outcome.seconds
        if outcome.change is not None:
            changed += 1
            tqdm.write(f"{'differs' if check else 'changed'}: {outcome.path}: {outcome.change}")
            if not check:
                with replacing(outcome.path) as file:
                    file.write(outcome.text.encode())
    if timings:
        for path in sorted(seconds):
            print(f"{seconds[path]:6.1f} s  {path.name}")
    print(f"{len(paths)} notebooks: {changed} changed, {failed} failed")
    return int(failed > 0 or (check and changed > 0))


def do(argv: list[str]) -> int:
    """What the command line asks for; returns the exit status."""
    parser = cli.Parser(prog="python tools/notebooks.py", description=__doc__.splitlines()[0])
    parser.add_argument("notebooks", nargs="*", type=Path, metavar="NOTEBOOK", help="default: all of them")
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if one would change")
    parser.add_argument("--timings", action="store_true", help="print the seconds each notebook took")
    parser.add_argument("--stubs", type=int, choices=sorted({exercise.chapter for exercise in EXERCISES.values()}),
                        metavar="CHAPTER", help="print the exercise cells of a chapter")
    parser.add_argument("--refresh", type=Path, metavar="NOTEBOOK",
                        help="bring the exercise cells of a notebook up to date; answers in them are lost")
    arguments = parser.parse_args(argv)
    if arguments.stubs is not None:
        print(stubs(arguments.stubs))
    elif arguments.refresh is not None:
        print(f"{arguments.refresh}: changed {', '.join(refresh(arguments.refresh)) or 'nothing'}")
    else:
        return run(arguments.notebooks, arguments.check, arguments.timings)
    return 0


def main(argv: list[str] | None = None) -> int:
    """The command line, with the same handling of errors as `python -m vislam_edu`."""
    return cli.main(argv, do)


if __name__ == "__main__":
    raise SystemExit(main())
