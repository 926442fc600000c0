"""CPU seconds of `run` on a recording, this version and an earlier commit in turns:

    python benchmarks/against.py [COMMIT] [--recording 03.npz] [--turns 3]

Each turn is a process of its own, imports and figures included; of each version the smallest number is printed,
because even CPU seconds grow on a busy machine. The earlier version is checked out into a temporary folder.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from vislam_edu import recordings

HERE = Path(__file__).resolve().parents[1]


def measure(root, recording, out) -> tuple[float, float]:
    """CPU seconds of the command in the package of that folder, and its filter's speed, times real time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "vislam_edu", "run", recording, "--out", out, "--quiet"], check=True,
                   env=os.environ | {"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"}, cwd=out,
                   stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    summary = json.loads((Path(out) / "summary.json").read_text())
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, summary["real_time_factor"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", nargs="?", default="5e0be0e")
    parser.add_argument("--recording", default="03.npz")
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    recording = recordings.find(arguments.recording) or Path(arguments.recording).resolve()
    if not recording.exists():
        raise SystemExit(f"{arguments.recording}: no such recording here")
    with tempfile.TemporaryDirectory() as folder:
        old = Path(folder) / "old"
        subprocess.run(["git", "clone", "--quiet", HERE, old], check=True)
        subprocess.run(["git", "-C", old, "checkout", "--quiet", arguments.commit], check=True)
        found = {"now": [], arguments.commit: []}
        for _ in range(arguments.turns):
            for name, root in (("now", HERE), (arguments.commit, old)):
                with tempfile.TemporaryDirectory() as out:
                    found[name].append(measure(root, recording, out))
    best = {name: (min(cpu for cpu, _ in runs), max(speed for _, speed in runs)) for name, runs in found.items()}
    for name, (cpu, speed) in best.items():
        print(f"{name:10s} {cpu:5.2f} s of CPU, filter {speed:5.1f} times real time")
    print(f"ratio of the CPU seconds: {best['now'][0] / best[arguments.commit][0]:.2f}")


if __name__ == "__main__":
    main()
