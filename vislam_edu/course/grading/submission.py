"""A submitted notebook in a process of its own: its cells are run, and what its checks find is recorded.

`grading` starts `run` in a fresh process. The cells run in an IPython shell without a kernel: all processes stay in one
group, no messages have to be understood, and no network is needed.
"""

import json
import os
import stat
import sys
from contextlib import suppress
from pathlib import Path

LARGEST = 50_000_000  # characters that are read of a notebook, or of what its checks recorded
MEMORY, FILE_SIZE = 4 << 30, 100 << 20  # bytes, for each process and for each file that it writes


def read(path: Path, most: int = LARGEST) -> str:
    """The text of a regular file. Raises OSError, and ValueError for another kind of file or too much text."""
    if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would wait, a device never end
        raise ValueError("not a regular file")
    with open(path, encoding="utf-8") as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise ValueError(f"has more than {most} characters")
    return text


def code_cells(path: Path) -> list[str]:
    """The sources of the code cells of a notebook. Raises OSError, and ValueError for what is no notebook."""
    try:
        content = json.loads(read(path))
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


def run(path: Path, record: Path, seconds: int) -> None:
    """Run the code cells of a notebook in its folder, all of them even where some fail, and end this process.

    record : file that checks append their verdicts to, and this function the error of each cell that failed, by number.
    seconds : of processor time that the system allows.
    """
    from IPython.core.interactiveshell import InteractiveShell

    from .. import exercises  # noqa: F401 - before anything beside the notebook that has the same name

    sources = code_cells(path)
    _restrict(seconds)
    record.touch()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # up to here the reader's; its output is not wanted
    os.chdir(path.parent)
    sys.path.insert(0, "")
    shell = InteractiveShell.instance()
    for number, source in enumerate(sources):
        result = shell.run_cell(source, store_history=True)
        error = result.error_before_exec or result.error_in_exec
        if error is not None:
            _append(record, {"cell": number, "error": _described(error)})
    _append(record, {"end": True})
    os._exit(0)  # without waiting for threads that the notebook has left


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
    try:
        return f"{type(error).__name__}: {error}"[:1000]
    except Exception:  # its own __str__ fails
        return type(error).__name__[:1000]


def _append(record: Path, entry: dict) -> None:
    with suppress(OSError):
        if stat.S_ISREG(os.stat(record).st_mode):
            with open(record, "a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
