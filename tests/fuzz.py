"""Files, options and notebooks damaged by chance, from a seed: each ends well or in one line with status 2.

    python tests/fuzz.py                     all kinds, 2000 cases, about five minutes
    python tests/fuzz.py --kind zip --cases 1 --seed 1234      one case again

A case fails when the command line shows a traceback or an error that was not foreseen, more than one line on stderr,
control characters, another status than 0 and 2, leaves files behind, or takes more memory than `MEMORY`.
"""

import argparse
import contextlib
import copy
import functools
import io
import json
import os
import pickle
import sys
import tempfile
import warnings
import zipfile
from pathlib import Path

import numpy as np
from memory import peak

from vislam_edu import cli, recordings

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE / "recordings"), str(HERE.parent / "tools")]

from test_recordings import NPZ, PICKLED  # noqa: E402

from notebooks import do as notebooks_tool  # noqa: E402

MEMORY = 200e6  # bytes that one command may take for a file of a few kB
ARRAYS = [np.nan, np.inf, -np.inf, 1e300, -1e150, 2.0**62, 0, -1, True, "text", 1j, [], [[]], "\x1b[31m\n=1+1",
          np.float16(7), np.longdouble(1), np.zeros((3, 0)), np.zeros((2, 3, 4, 5)), np.full(5, np.nan), np.arange(7)]
WORDS = ["nan", "inf", "-1", "0", "1e160", "1" * 400, "0x10", "1_000", "", " ", "é", "\x1b[31m", "\udcff", "1e-320",
         "-0", "9" * 30, "--", "1,5", "None", "1e", "½", "٣", "a/b", "..", "\n", "1e5", "3",
         "/dev/null", "o/../../../../../../../dev/null/x.npz"]
VALUES = [None, True, 0, -1, 1e308, 10**40, "", "x" * 10_000, "\ud800", "\x1b[31m", [], {}, [[[]]], {"a": []}, 4,
          "code", ["a", 1], "def so3_hat(\n# BEGIN SOLUTION", "check.so3_hat("]
HEADERS = [b"(" * 2000, b"{'descr': '|O', 'fortran_order': False, 'shape': ()}", b"{'descr': '<f8'", b"1", b"\xff" * 50,
           b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**12,)}", b"{'descr': '<f8', 'fortran_order': 3, "
           b"'shape': (1000000000000,)}", b"{'descr': ('<f8', (9, 9)), 'fortran_order': False, 'shape': (2,)}"]


def any_of(rng, values):
    return values[rng.integers(len(values))]


def damaged(rng, content: bytes, where: int | None = None) -> bytes:
    """The bytes with some of them (of the first `where`) changed, cut off, doubled or removed."""
    found, end = bytearray(content), min(where or len(content), len(content))
    for _ in range(rng.integers(1, 4)):
        at, length = int(rng.integers(end)), int(rng.integers(1, 40))
        match rng.integers(6):
            case 0:
                del found[at:]
            case 1:
                del found[at:at + length]
            case 2:
                found[at:at] = found[at:at + length]
            case 3:
                found[at:at] = rng.integers(0, 256, length, np.uint8).tobytes()
            case _:
                found[at:at + 1] = bytes([rng.integers(256)])
    return bytes(found)


def archive(fields, method=zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        for name, value in fields.items():
            member = io.BytesIO()
            np.save(member, np.asarray(value), allow_pickle=False)
            file.writestr(f"{name}.npy", member.getvalue())
    return out.getvalue()


@functools.cache
def own_fields():
    with tempfile.TemporaryDirectory() as folder:
        recordings.save(recordings.load("first_steps"), Path(folder) / "a.npz")
        with np.load(Path(folder) / "a.npz") as file:
            return dict(file)


def changed(rng, fields):
    """Some of the fields replaced, removed, or of another shape or type."""
    fields = dict(fields)
    for _ in range(rng.integers(1, 3)):
        name = any_of(rng, list(fields))
        value = np.array(fields[name])
        match rng.integers(6):
            case 0:
                del fields[name]
            case 1:
                fields[name] = any_of(rng, [value.T, value.ravel(), value[None], value[..., None], value[:0],
                                            value[::-1]]) if value.ndim else value[None]
            case 2:
                with contextlib.suppress(ValueError, TypeError), np.errstate(all="ignore"):
                    fields[name] = value.astype(any_of(rng, ["f2", "f4", "i8", "u1", "g", "c16", "U5", "?", ">f8"]))
            case 3 if value.size and value.dtype.kind == "f":
                value.flat[rng.integers(value.size)] = any_of(rng, [np.nan, np.inf, 1e300, -1e9, 1e-310])
                fields[name] = value
            case _:
                fields[name] = any_of(rng, ARRAYS)
    return fields


# --- kinds: each writes its files into the working directory and returns the words of a command ------------


def numpy_file(rng):
    Path("a.npz").write_bytes(archive(changed(rng, NPZ)))
    return ["info", "a.npz"]


def header(rng):
    fields = dict(NPZ)
    name = any_of(rng, list(fields))
    member = io.BytesIO()
    np.save(member, fields.pop(name))
    content = member.getvalue()
    if rng.random() < 0.5:
        content = damaged(rng, content, 120)
    else:
        text = any_of(rng, HEADERS) + b"\n"
        content = content[:8] + len(text).to_bytes(2, "little") + text + content[128:]
    raw = io.BytesIO(archive(fields))
    with zipfile.ZipFile(raw, "a") as file:
        file.writestr(f"{name}.npy", content)
    Path("a.npz").write_bytes(raw.getvalue())
    return ["info", "a.npz"]


def pickled(rng):
    content = pickle.dumps(np.array(PICKLED, dtype=object), protocol=int(rng.integers(2, 6)))
    start = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }".ljust(117) + b"\n"
    Path("a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(start).to_bytes(2, "little") + start
                              + damaged(rng, content, int(rng.choice([200, 2000, len(content)]))))
    return ["info", "a.npy"]


def zip_structure(rng):
    content = archive(NPZ, int(any_of(rng, [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2,
                                            zipfile.ZIP_LZMA])))
    if rng.random() < 0.5:  # its directory, at the end
        at = content.index(b"PK\x01\x02")
        content = content[:at] + damaged(rng, content[at:])
    else:
        content = damaged(rng, content)
    Path("a.npz").write_bytes(content)
    return ["info", "a.npz"]


def own_format(rng):
    Path("a.npz").write_bytes(archive(changed(rng, own_fields())))
    return ["info", "a.npz"]


def truth(rng):
    drive = recordings.load("first_steps")
    recordings.save(drive, "a.npz")
    if rng.random() < 0.5:
        recordings.save_kitti("truth.txt", drive.truth_world_T_cam)
    else:
        recordings.save_tum("truth.txt", drive.times, drive.truth_world_T_cam)
    content = Path("truth.txt").read_bytes()
    if rng.random() < 0.5:
        content = damaged(rng, content)
    else:
        lines = [line.split(b" ") for line in content.splitlines()]
        for _ in range(rng.integers(1, 4)):
            line = any_of(rng, lines)
            line[rng.integers(len(line))] = any_of(rng, WORDS).encode(errors="replace")
        content = b"\n".join(b" ".join(line) for line in lines)
    Path("truth.txt").write_bytes(content)
    return ["info", "a.npz", "--ground-truth", "truth.txt"]


def options(rng):
    commands = {
        "run nothing.npz --out out": ["--sigma-v", "--sigma-omega", "--sigma-px", "--gate", "--min-disparity",
                                      "--every", "--error-state", "--initialisation", "--ground-truth"],
        "audit nothing.npz": ["--figure", "--cured", "--ground-truth"],
        "simulate --out a.npz --frames 10": ["--sigma-v", "--sigma-omega", "--sigma-px", "--outlier-share", "--seed",
                                             "--out"],
        "exercises --report nothing --out out": ["--limit", "--jobs", "--image"],
        "exercises": ["--museum", "--report"],
        "info": ["--ground-truth", ""],
        "clinic serve --key key --out out": ["--patients", "--level", "--roster", "--port"],
    }
    command = any_of(rng, list(commands))
    words = command.split()
    for _ in range(rng.integers(1, 3)):
        words += [any_of(rng, commands[command]), any_of(rng, WORDS)]
    return words


def notebook(rng):
    from vislam_edu.course.exercises import EXERCISES
    from vislam_edu.course.grading import cells

    pair = [cell | {"outputs": []} for cell in cells.pair(EXERCISES["so3_hat"])]
    content = copy.deepcopy({"cells": pair, "metadata": {"kernelspec": {"name": "python3"}}, "nbformat": 4,
                             "nbformat_minor": 5})
    for _ in range(rng.integers(1, 3)):
        node = content
        while True:  # down to a place by chance
            key = any_of(rng, list(node) if isinstance(node, dict) else range(len(node)))
            if not isinstance(node[key], dict | list) or not node[key] or rng.random() < 0.3:
                break
            node = node[key]
        if rng.random() < 0.25:
            del node[key]
        else:
            node[key] = any_of(rng, VALUES)
        if not content:
            break
    text = json.dumps(content).encode()
    Path("a.ipynb").write_bytes(damaged(rng, text) if rng.random() < 0.2 else text)
    return ["notebooks", "--refresh", "a.ipynb"]


@functools.cache
def study_fields():
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()), \
            contextlib.redirect_stdout(io.StringIO()):
        cli.main(["consistency", "--seeds", "1", "--frames", "10", "--out", folder])
        with np.load(Path(folder) / "seed_00000.npz") as file:
            return dict(file)


def study(rng):
    Path("study").mkdir()
    content = archive(changed(rng, study_fields()))
    Path("study", "seed_00000.npz").write_bytes(damaged(rng, content) if rng.random() < 0.3 else content)
    return ["consistency", "--seeds", "1", "--frames", "10", "--out", "study"]


def tiny(rng):
    """A field far smaller than any car has it, or a landmark whose true place is unknown: no warning of numpy's."""
    fields = dict(own_fields())
    name = any_of(rng, ["baseline", "K", "times", "twists", "pixels", "cam_T_imu", "truth_landmarks"])
    value = np.array(fields[name])
    match name:
        case "K":
            value[:2] *= 10.0**-rng.integers(1, 300)
        case "cam_T_imu":
            value[:3, 3] *= 10.0**-rng.integers(1, 300)
        case "truth_landmarks":
            value[rng.random(len(value)) < rng.choice([0.05, 0.5, 1])] = np.nan
        case _:
            value *= 10.0**-rng.integers(1, 300)
    fields[name] = value
    Path("a.npz").write_bytes(archive(fields))
    return ["audit", "a.npz"] if rng.random() < 0.5 else ["run", "a.npz", "--out", "out", "--quiet"]


def names(rng):
    """Names of files that a terminal would obey, and folders that cannot be made."""
    name = any_of(rng, ["a\x1b[31m", "b\x07", "\udcff", "é", "o/../../../../../../../dev/null/x"])
    if "/" not in name:
        recordings.save(recordings.load("first_steps").slice(0, 12), f"{name}.npz")
    recording = f"{name}.npz" if "/" not in name and rng.random() < 0.7 else "first_steps"
    return any_of(rng, [["info", recording], ["audit", recording, "--cured", f"out{name}.npz"],
                        ["audit", recording, "--figure", f"out{name}.png"], ["audit", recording, "--cured", recording],
                        ["run", recording, "--to", "12", "--out", name], ["exercises", "--report", name],
                        ["simulate", "--frames", "10", "--out", f"{name}.npz"]])


KINDS = {"numpy": (numpy_file, 5), "header": (header, 3), "pickle": (pickled, 4), "zip": (zip_structure, 4),
         "own": (own_format, 5), "truth": (truth, 4), "options": (options, 5), "notebook": (notebook, 5),
         "study": (study, 2), "tiny": (tiny, 2), "names": (names, 2)}
# What a command that ends well writes:
LEAVES = {"study": {"study/summary.json"}, "options": {"a.npz", "out"}, "tiny": {"out"}}


def problem_of(kind: str, seed: int) -> str:
    """Run one case in a new folder; "" or what is wrong with how it ended."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.mkdir(os.path.join(folder, "work"))  # so that an option ".." is an empty folder, too
        os.chdir(os.path.join(folder, "work"))
        try:
            words = KINDS[kind][0](np.random.default_rng((seed, list(KINDS).index(kind))))
            return _judged(words, LEAVES.get(kind, set()) | ({words[-1]} if kind == "names" else set()))
        finally:
            os.chdir(before)


def _judged(words, leaves) -> str:
    out, err, status = io.StringIO(), io.StringIO(), [0]
    there = set(Path().rglob("*"))

    def run():
        try:
            tool = words[0] == "notebooks"
            status[0] = cli.main(words[1:], notebooks_tool) if tool else cli.main(words)
        except SystemExit as stopped:  # argparse leaves this way
            status[0] = stopped.code

    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("always")
        memory = peak(run)
    said = err.getvalue()
    lines = [line for line in said.splitlines() if line and "drive/s" not in line and "frame/s" not in line
             and not line.startswith(("warning: ", "figure: ", "cured drive: "))]
    new = {str(path) for path in set(Path().rglob("*")) - there if not {str(path), path.parts[0]} & leaves}
    problems = {
        f"status {status[0]}": status[0] not in (0, 2),
        "an error that was not foreseen": "unforeseen" in said or "Traceback" in said,
        f"{len(lines)} lines on stderr": len(lines) != (1 if status[0] else 0),
        "control characters": any(not (c.isprintable() or c in "\n\r") for c in out.getvalue() + "".join(lines)),
        f"left {sorted(new)}": bool(new - leaves if status[0] == 0 else new - {"out"}),
        f"{memory / 1e6:.0f} MB": memory > MEMORY,
    }
    found = [text for text, wrong in problems.items() if wrong]
    return f"{'; '.join(found)}: {' '.join(map(ascii, words))}: {said.strip()[-400:]}" if found else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0, help="of the first case")
    parser.add_argument("--kind", choices=KINDS)
    arguments = parser.parse_args()
    weights = [name for name, (_, weight) in KINDS.items() for _ in range(weight)]
    failed = 0
    for seed in range(arguments.seed, arguments.seed + arguments.cases):
        kind = arguments.kind or weights[seed % len(weights)]
        found = problem_of(kind, seed)
        if found:
            failed += 1
            print(f"--kind {kind} --cases 1 --seed {seed}: {found}", flush=True)
    print(f"{arguments.cases} cases, {failed} failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
