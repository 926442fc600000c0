"""Submissions that misbehave, put to `exercises --report`: each ends in its own row and costs no other its grade.

    python tests/hostile.py                  all of them, a few minutes
    python tests/hostile.py --load 4         with four busy processes beside them
    python tests/hostile.py --only record    those with this word in their name

A submission fails when its row does not say what stands beside it here; all of them together, when a process, a file
beyond the limit or a control character is left. `test_grading.py` puts the first of each kind to every commit.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from vislam_edu.course.grading import submission

HAT = """import numpy as np
def so3_hat(omega):
    x, y, z = omega
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
"""
WRONG_HAT = "import numpy as np\ndef so3_hat(omega):\n    return np.diag(omega)\n"
CHECK_HAT = "from vislam_edu.course.exercises import check\ncheck.so3_hat(so3_hat)"
RIGHT_HAT = HAT + CHECK_HAT
SHORT, LONG = 30, 300  # s, for a notebook that has to be stopped, and for one that ends on its own under load too
REPORT = {"exercises.csv", "exercises.json", "feedback", "matrix.csv", "points.csv", "similar.csv", "summary.txt"}


@dataclass(frozen=True)
class Case:
    """wanted : words of `outcome` that its row must have, or others after a bar. cells : None for a file by hand."""

    wanted: str
    cells: list[str] | None


def before(source, wanted="right"):
    """In a cell before a right answer and its check."""
    return Case(wanted, [source, RIGHT_HAT])


def after(source, wanted="right"):
    return Case(wanted, [RIGHT_HAT, source])


def faked(source, wanted="wrong"):
    """In a cell between a wrong answer and its check."""
    return Case(wanted, [WRONG_HAT, source, CHECK_HAT])


def answer(body, wanted="wrong"):
    return Case(wanted, [f"import numpy as np, sys\ndef so3_hat(omega):\n    {body}\n" + CHECK_HAT])


DAEMON = """import os, subprocess, sys, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open("daemon.pid", "w").write(str(os.getpid()))
        time.sleep(1000)
    os._exit(0)
while not os.path.exists("daemon.pid"):
    time.sleep(0.01)
"""
RECORD = "import os, shutil, sys; path = sys.argv[2] + '/record'\n"
FORGED = RECORD + r"""
with open(path, "a") as file:
    file.write('{"exercise": "odot", "status": "right", "outcomes": null}\n')
    file.write('0' * 64 + ' {"exercise": "adjoint", "outcomes": []}\n[' + "[" * 100000 + "\n3\n")
"""
VERDICT = """import vislam_edu.course.checks.check as c
import vislam_edu.course.checks.verdict as v
right = lambda exercise, function, *_: v.Verdict(exercise.name, "right", "right")
c.judge = v.judge = v.concluded = right"""
REFERENCE = "from vislam_edu.course.exercises import EXERCISES\n"
STUBBORN = "import time\nwhile True:\n    try: time.sleep(1)\n    except BaseException: pass"
SHADOWS = "import vislam_edu; assert 'shadow' not in vislam_edu.__file__"
ENDED, STOPPED = "right ended", "right stopped"

CASES = {
    # --- a verdict that is not its own ---
    "patches the judge": faked(VERDICT, "wrong noted"),
    "forges the record": before(FORGED, "right noted"),
    "replaces json": faked("import json\njson.dumps = json.JSONEncoder.encode = lambda *_, **__: "
                           "'{\"exercise\": \"so3_hat\", \"status\": \"right\"}'", "wrong noted"),
    "patches what is called": faked("""from vislam_edu.course.checks import running, surroundings
ours = running.outcome_of
running.outcome_of = lambda exercise, function, arguments: ours(exercise, exercise.reference, arguments)
surroundings.restored = lambda: []""", "wrong noted"),
    "another reference": faked(REFERENCE + "object.__setattr__(EXERCISES['so3_hat'], 'reference', so3_hat)"),
    "no inputs": faked(REFERENCE + "object.__setattr__(EXERCISES['so3_hat'], 'inputs', lambda: [])"),
    "easy inputs": faked(REFERENCE + "object.__setattr__(EXERCISES['so3_hat'], 'inputs', "
                                     "lambda: [('', (np.zeros(3),))] * 7)"),
    "a check of its own": Case("wrong", [WRONG_HAT, "class check:\n    so3_hat = print\ncheck.so3_hat(so3_hat)"]),
    "prints a verdict": faked("print('so3_hat: right, on 7 inputs (5 random; x axis; [1, 2, 3])')"),
    "allclose is always true": faked("np.allclose = np.array_equal = lambda *_, **__: True", "wrong noted"),
    "isinstance is always true": faked("import builtins\nbuiltins.isinstance = lambda *_: True",
                                       "wrong noted|no_verdict noted"),
    "equal to everything": answer("class All(np.ndarray):\n        __eq__ = lambda *_: True\n        "
                                  "__sub__ = __rsub__ = lambda *_: np.zeros((3, 3))\n    return np.eye(3).view(All)"),
    "signs with the grader's key": faked(r"""import gc
for record in [one for one in gc.get_objects() if type(one).__name__ == "_Record"]:
    record.add({"exercise": "so3_hat", "status": "right", "verdict": "right"})""", "wrong noted"),
    "stops who asks": answer("from vislam_edu.course.checks.running import _Stop\n    raise _Stop", "wrong noted"),
    "asks the frame above": answer("return sys._getframe(5).f_locals['exercise'].reference(omega)",
                                   "wrong noted|borrowed noted"),
    "calls the reference": Case("borrowed", [REFERENCE + "so3_hat = lambda w: EXERCISES['so3_hat'].reference(w)",
                                             CHECK_HAT]),
    # --- the record of what it did ---
    "a pipe for a record": after(RECORD + "os.unlink(path); os.mkfifo(path)", "no_verdict ended"),
    "a device for a record": after(RECORD + "os.unlink(path); os.symlink('/dev/zero', path)", "no_verdict ended"),
    "a folder for a record": after(RECORD + "os.unlink(path); os.mkdir(path)", "no_verdict ended"),
    "a large record": after(RECORD + "open(path, 'a').write('x' * (50_000_000 + 1))", "no_verdict ended"),
    "no utf-8 in a record": after(RECORD + r"open(path, 'ab').write(b'\xff\n')", "no_verdict ended"),
    "garbage on every file": before("import os\nfor i in range(3, 20):\n    try: os.write(i, b'x' * 1000)\n"
                                    "    except OSError: pass"),
    "closes every file": after("import os; os.closerange(0, 256)", ENDED),
    "removes its scratch folder": after(RECORD + "shutil.rmtree(sys.argv[2], ignore_errors=True)", "unstarted"),
    # --- memory, files, floods ---
    "takes memory": before("import numpy as np\nx = np.ones(10**9)"),
    "takes memory bit by bit": before("import numpy as np\nx = []\nwhile True: x.append(np.zeros(1 << 23))",
                                      "no_verdict ended|right"),
    "takes 3 GB": before("import numpy as np\nx = np.ones(3 * 10**9 // 8)"),  # only a sandbox forbids
    "writes much": before("open('large', 'wb').write(bytes(3 * 10**8))"),
    "writes many files": before("for i in range(2000): open(f'file {i}', 'w').write('x')"),
    "opens many files": before("kept = [open('a.ipynb') for _ in range(100_000)]", "right|no_verdict"),
    "prints much": before("print('x' * 10**8)"),
    "never stops printing": after("while True: print('x' * 1000)", "right stopped|right ended"),
    "a large result": answer("return np.zeros((20_000, 20_000))"),
    "a large integer": answer("return np.array([[10**5000] * 3] * 3)"),
    "a result in itself": answer("a = [0, 0, 0]; a[0] = a; return a"),
    "a result without an end": answer("return (row for row in iter(int, 1))"),
    "an error without words in an answer": answer("class Mute(Exception):\n        def __str__(self): raise self\n"
                                                  "    raise Mute", "wrong|no_verdict"),
    "a result that exits": answer("class Exits:\n        def __array__(self, *_, **__): raise SystemExit\n"
                                  "    return Exits()"),
    "a large message": answer("raise ValueError('x' * 10**8)"),
    "numbers that change": answer("class Cunning:\n        __array__ = lambda *_, **__: np.random.rand(3, 3)\n"
                                  "    return Cunning()"),
    # --- processes and signals ---
    "leaves a daemon": before(DAEMON),
    "ends its parent": before("import os; os.kill(os.getppid(), 9)", "no_verdict ended|right"),
    "ends itself": before("import os; os.kill(os.getpid(), 9)", "no_verdict ended"),
    "ends its group": after("import os, signal; os.killpg(0, signal.SIGKILL)", ENDED),
    "stops itself": after("import os, signal; os.kill(os.getpid(), signal.SIGSTOP)", STOPPED),
    "stops its parent": after("import os, signal; os.kill(os.getppid(), signal.SIGSTOP)", STOPPED),
    "forks": before("import os, time\nfor _ in range(60):\n    if os.fork() == 0: time.sleep(1000)"),
    "forks and goes on": after("import os; os.fork()"),
    "a pool that waits": after("import multiprocessing, time\npool = multiprocessing.get_context('fork').Pool(2)\n"
                               "pool.map_async(time.sleep, [1000] * 4)"),
    "exits": before("import sys; sys.exit(3)"),
    "exits at once": after("import os; os._exit(0)", ENDED),
    "a fault of memory": after("import ctypes; ctypes.string_at(0)", ENDED),
    "recursion without a limit": after("import sys\nsys.setrecursionlimit(10**9)\nclass A:\n"
                                       "    __repr__ = lambda self: repr([self])\nrepr(A())", "right"),
    # --- time ---
    "never ends": after(STUBBORN, STOPPED),
    "an endless loop": after("while True: pass", STOPPED),
    "an answer without an end": answer("while True: pass"),
    "deaf to signals": after("import signal\nfor number in range(1, 32):\n    try: signal.signal(number, 1)\n"
                             "    except OSError: pass\n" + STUBBORN, STOPPED),
    "a power without an end": after("10 ** 10 ** 10", "right stopped|right ended|right"),
    "waits for a line": before("input('your name: ')"),
    "leaves a thread": before("import threading, time\nthreading.Thread(target=time.sleep, args=(1000,)).start()"),
    "sleeps at its end": after("import atexit, time; atexit.register(time.sleep, 1000)"),
    # --- Python turned round ---
    "deep recursion": answer("return so3_hat(omega)"),
    "an error without words": before("class Mute(Exception):\n    def __str__(self): raise self\nraise Mute"),
    "interrupts": before("raise KeyboardInterrupt"),
    "a nest of brackets": before("(" * 10_000 + ")" * 10_000),
    "a row of signs": before("-" * 100_000 + "1", "right|no_verdict ended"),
    "a zero in the source": before("1 + 1\0"),
    "a surrogate in a cell": before("'\ud800'"),
    "no builtins": after("import builtins\nfor name in list(vars(builtins)): delattr(builtins, name)",
                         "right ended|right"),
    "numpy is gone": after("import sys\nfor name in list(sys.modules): del sys.modules[name]"),
    "time stands still": before("import time\ntime.time = time.monotonic = time.process_time = lambda: 0"),
    "errors of numpy": before("import numpy as np\nnp.seterr(all='raise'); np.set_printoptions(precision=0)"),
    "another folder": before("import os; os.chdir('/'); os.environ.clear()"),
    "commands of the shell": before("%reset -f\n!kill -9 $PPID\nget_ipython().ask_exit()", "right|no_verdict ended"),
    # --- its neighbours ---
    "reads its neighbour": Case("right", ["import json\ncells = json.load(open('../a good one/a.ipynb'))['cells']\n"
                                          "exec(cells[1]['source'])", CHECK_HAT]),  # only a sandbox forbids
    "spoils its neighbour": before("open('../a good one/a.ipynb', 'w').write('{}')"),
    "removes its folder": before("import os, shutil; shutil.rmtree(os.getcwd())"),
    "shadows with a folder": before(SHADOWS),
    "shadows with a module": before(SHADOWS),
    # --- names ---
    "a good one": before("1 + 1"),
    "=HYPERLINK(\"x\")": before("1"),
    "\x1b[31mred": before("1"),
    "two\nlines": before("1"),
    # --- files that are no notebook, or hardly one ---
    "is a pipe": Case("unreadable", None),
    "is a device": Case("unreadable", None),
    "is a folder": Case("unreadable", None),
    "leads nowhere": Case("unreadable", None),
    "leads to itself": Case("unreadable", None),
}
TEXT = {
    "no json": "no notebook",
    "empty": "{}",
    "cells are a number": '{"cells": 3, "nbformat": 4}',
    "a source is a number": '{"cells": [{"cell_type": "code", "source": 3}], "nbformat": 4, "nbformat_minor": 5}',
    "a cell is a number": '{"cells": [3], "nbformat": 4, "nbformat_minor": 5}',
    "nested": '{"cells": ' + "[" * 100_000,
    "of version 3": '{"worksheets": [], "nbformat": 3, "nbformat_minor": 0}',
    "large": '{"cells": [' + " " * submission.LARGEST + '], "nbformat": 4}',
    "utf-16": '{"cells": [], "nbformat": 4}'.encode("utf-16"),
}
CASES |= {name: Case("unreadable", None) for name in TEXT}
NOT_UTF8 = b"not \xff utf-8"


def notebook(folder, sources, name="a.ipynb"):
    folder.mkdir(parents=True, exist_ok=True)
    content = {"cells": [{"cell_type": "code", "source": source} for source in sources], "nbformat": 4,
               "nbformat_minor": 5, "metadata": {}}
    (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return folder / name


def handed_in(folder: Path, names: Iterable[str]) -> None:
    """Write the submissions, and two good ones beside them."""
    for name in {*names, "a good one"}:
        own = folder / name
        own.mkdir()
        if (cells := CASES[name].cells) is not None:
            notebook(own, cells)
        elif name in TEXT:
            text = TEXT[name]
            (own / "a.ipynb").write_bytes(text if isinstance(text, bytes) else text.encode())
        elif name == "is a pipe":
            os.mkfifo(own / "a.ipynb")
        elif name == "is a folder":
            (own / "a.ipynb").mkdir()
        else:
            where = {"is a device": "/dev/zero", "leads to itself": "a.ipynb", "leads nowhere": "nowhere"}[name]
            (own / "a.ipynb").symlink_to(where)
        if name.startswith("shadows"):
            theirs = own / ("vislam_edu.py" if "module" in name else "vislam_edu/__init__.py")
            theirs.parent.mkdir(exist_ok=True)
            theirs.write_text("shadow = True\nraise SystemExit('the wrong package')\n")
    notebook(Path(os.fsdecode(os.fsencode(folder) + b"/" + NOT_UTF8)), [RIGHT_HAT])


def outcome(entry: dict) -> set[str]:
    """Words for a row of exercises.json: the status of so3_hat, how its process ended, whether a note was made."""
    kinds = {"its process ended": "ended", "stopped after": "stopped", "not a readable": "unreadable",
             "could not be run": "unstarted"}
    found = {word for text, word in kinds.items() if entry["problem"].startswith(text)}
    found |= {result["status"].replace(" ", "_") for result in entry["exercises"] if result["exercise"] == "so3_hat"}
    return found | ({"noted"} if entry["notes"] else set()) | (set() if found & {*kinds.values()} else {"complete"})


def report(folder: Path, out: Path, limit: float) -> tuple[dict[str, dict], str]:
    """Grade a folder by the command: entries of exercises.json by the student's folder, and what was printed."""
    done = subprocess.run([sys.executable, "-m", "vislam_edu", "exercises", "--report", folder, "--out", out, "--jobs",
                           "2", "--limit", str(limit)], capture_output=True, text=True, timeout=3600, errors="replace")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    entries = json.loads((out / "exercises.json").read_text(encoding="utf-8"))
    return {entry["notebook"].split("/")[0]: entry for entry in entries}, done.stdout


def problem_of(name: str, entries: dict[str, dict]) -> str:
    """What is wrong with the row of one submission; "" where it has the words that are wanted."""
    entry = entries.get("".join(c if c.isprintable() else "?" for c in " ".join(name.split())))
    came = outcome(entry) if entry else {"no row"}
    if any(set(choice.split()) <= came for choice in CASES[name].wanted.split("|")):
        return ""
    return f"{name!r}: wanted {CASES[name].wanted!r}, came {sorted(came)}, {entry and entry['problem']!r}"


def left_behind(folder: Path, out: Path, printed: str) -> list[str]:
    """Files too large or unasked for, processes that still run, and control characters, one line each."""
    found = {"results": sorted({path.name for path in out.iterdir()} ^ REPORT),
             "too large": [path for path in folder.rglob("*")
                           if path.is_file() and path.stat().st_size > submission.FILE_SIZE],
             "still runs": running_in(folder),
             "printed": [c for c in printed if not (c.isprintable() or c == "\n")]}
    return [f"{what}: {which}" for what, which in found.items() if which]


def running_in(folder: Path) -> list[Path]:
    """Processes that stand in a folder (on Linux)."""
    return [link for link in Path("/proc").glob("[0-9]*/cwd") if _points_into(link, folder)]


def _points_into(link, folder) -> bool:
    try:
        return os.readlink(link).startswith(str(folder))
    except OSError:  # another user's process, or one that has ended
        return False


def put(names: Iterable[str], limit: float) -> list[str]:
    """Hand in these, grade them, and say what did not end as it should."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        folder, out = Path(scratch) / "class", Path(scratch) / "grades"
        folder.mkdir()
        handed_in(folder, names)
        entries, printed = report(folder, out, limit)
        found = [problem_of(name, entries) for name in {*names, "a good one"}]
        return [*filter(None, found), *left_behind(folder, out, printed)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--load", type=int, default=0, help="busy processes beside it")
    parser.add_argument("--only", default="", help="part of their names")
    arguments = parser.parse_args()
    names = [name for name in CASES if arguments.only in name]
    endless = [name for name in names if "stopped" in CASES[name].wanted]
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(arguments.load)]
    start = time.monotonic()
    try:
        found = put(endless, SHORT) + put([name for name in names if name not in endless], LONG)
    finally:
        for process in busy:
            process.kill()
    print(*found, f"{len(names)} submissions, {len(found)} problems, {time.monotonic() - start:.0f} s", sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
