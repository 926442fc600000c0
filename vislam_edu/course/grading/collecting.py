"""Grade all notebooks of a folder, several at a time; each result is kept at once, and an interrupted run goes on.

All are read before the first one runs: a notebook can change the files of the others.
"""

import json
import os
import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from . import grading
from .grading import Notebook, Result, Submission
from .sandbox import Sandbox

KEPT = "exercises.partial.jsonl"  # beside the report, until it is complete
_TRIES = 2


def notebooks(path: Path) -> list[Path]:
    """The notebooks at a path: itself, or all in and below a folder. Raises OSError when there are none."""
    if not path.is_dir():
        if not path.exists():
            raise FileNotFoundError(2, "there is no such notebook or folder", str(path))
        if not path.is_file():
            raise OSError(22, "is neither a file nor a folder", str(path))
        return [path]
    found = [file for file in sorted(path.rglob("*.ipynb")) if ".ipynb_checkpoints" not in file.parts]
    if not found:
        raise FileNotFoundError(2, "no notebooks in this folder", str(path))
    return found


def graded(path: Path, folder: Path, limit: float = grading.LIMIT, jobs: int = 1,
           sandbox: Sandbox | None = None) -> list[Submission]:
    """Run the notebooks at a path, with a progress bar. Returns them in the order of their names.

    folder : where `KEPT` holds what is graded. limit : s, for each. jobs : how many at a time.
    Raises KeyboardInterrupt, with what is kept in its text, when it is interrupted.
    """
    from tqdm import tqdm

    root = path if path.is_dir() else path.parent
    read = {name: grading.read(file, name) for file in notebooks(path)
            if (name := file.relative_to(root).as_posix())}
    stop, lock = threading.Event(), threading.Lock()
    done, tries = _kept(folder / KEPT, read)
    for name, notebook in read.items():
        if name not in done and tries[name] >= _TRIES:
            done[name] = Submission(name, time=notebook.time, problem="not graded: twice the grader was ended while "
                                    "this was running; run it with --sandbox")

    with open(folder / KEPT, "a", encoding="utf-8") as log:
        def keep(name, event, **content):
            with lock:
                log.write(json.dumps({"notebook": name, "digest": read[name].digest, event: True} | content) + "\n")
                log.flush()
                os.fsync(log.fileno())

        def work(name):
            keep(name, "started")
            try:
                result = grading.grade(read[name], limit, sandbox, root.resolve(), stop)
            except grading.Stopped:
                keep(name, "stopped")
                return
            keep(name, "graded", submission=asdict(result))
            done[name] = result

        pool = ThreadPoolExecutor(jobs)
        try:
            tasks = [pool.submit(work, name) for name in read if name not in done]
            for task in tqdm(as_completed(tasks), total=len(read), initial=len(read) - len(tasks), unit="notebook",
                             leave=False, disable=None):
                task.result()
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{len(done)} of {len(read)} notebooks are graded, and kept in {folder / KEPT}: "
                                    "the same command goes on from there") from None
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
    for name, notebook in read.items():
        if grading.read(notebook.path, name).digest != notebook.digest:
            done[name].notes.append("its file was changed while notebooks ran; graded as it was before")
    return [done[name] for name in read]


def _kept(path: Path, read: dict[str, Notebook]) -> tuple[dict[str, Submission], Counter[str]]:
    """What is graded already, and how often each notebook was begun and neither finished nor stopped."""
    done: dict[str, Submission] = {}
    tries: Counter[str] = Counter()
    for entry in _lines(path):
        name = entry["notebook"]
        if name not in read or read[name].digest != entry["digest"]:  # handed in anew
            continue
        tries[name] += ("started" in entry) - ("stopped" in entry)
        if "submission" in entry:
            content = entry["submission"]
            done[name] = Submission(**content | {"results": [Result(**result) for result in content["results"]]})
    return done, tries


def _lines(path: Path) -> Iterator[dict]:
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):  # the last one may be cut off
                yield json.loads(line)
