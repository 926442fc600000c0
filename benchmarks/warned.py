"""The tables of `docs/warnings.md`: which runs were warned of, and whether they should have been.

    python -m vislam_edu consistency --regime all --seeds 10 --out STUDY
    python benchmarks/warned.py STUDY/summary.json

The first table is the study's. The second runs the recordings that this machine has, each as it is and with `--audit`.
"""

import json
import sys
import tempfile
from pathlib import Path

from vislam_edu import cli, recordings
from vislam_edu.plots import report_figures

COURSE = {"0027.npz": "0027_ground_truth.txt", "03.npz": None} | {
    f"course_2025/{name}.npy": f"course_2025/{name}_truth_of_left_camera.txt" for name in ("regular", "optical_same_K")}
WAYS = ("", "--audit", "--audit --lens", "--audit --batch", "--error-state right")


def regimes(study: dict) -> None:
    """A row for each regime: mean NEES of the pose, share of the drives warned of, share without ground truth."""
    names = list(next(iter(study.values()))["filters"])
    print("| regime | " + " | ".join(names) + " |\n|---|" + "---|" * len(names))
    for regime, figures in study.items():
        cells = [f"{_brief(one['nees_pose'])}: {one['warned']:.0%}, {one['warned_without_truth']:.0%}"
                 for one in figures["filters"].values()]
        print(f"| {regime} | " + " | ".join(cells) + " |")


def run(path: str, options: list[str]) -> dict:
    """The summary of one run, without its figures."""
    report_figures.FIGURES.clear()
    with tempfile.TemporaryDirectory() as folder:
        if cli.main(["run", path, *options, "--quiet", "--out", folder]):
            raise SystemExit(f"{path} {' '.join(options)}: no result")
        return json.loads((Path(folder) / "summary.json").read_text())


def recorded() -> None:
    """A row for each recording and way to run it: NEES, share inside 3 sigma, what the warnings begin with."""
    print("\n| recording | options | NEES | inside 3 sigma | warnings |\n|---|---|---|---|---|")
    here = {name: truth for name, truth in COURSE.items() if recordings.find(name)}
    for name, truth in ({"street_loop": None, "first_steps": None} | here).items():
        path = str(recordings.find(name))
        known = ["--ground-truth", str(recordings.find(truth))] if truth else []
        for way in WAYS:
            numbers = run(path, [*known, *way.split()])
            figures = numbers["batch"] if "--batch" in way else numbers
            inside = figures.get("inside_3_sigma")
            begins = "; ".join(warning[:36] for warning in numbers["warnings"]) or "none"
            print(f"| {name} | {way} | {_brief(figures.get('nees_pose'))} | "
                  f"{'' if inside is None else format(inside, '.0%')} | {begins} |")


def _brief(value) -> str:
    return "" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    for file in sys.argv[1:]:
        regimes(json.loads(Path(file).read_text())["regimes"])
    recorded()
