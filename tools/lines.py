"""Lines of Python in each part of the package:  python tools/lines.py"""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "vislam_edu"
FIRST = ("se3", "stereo", "noise", "drive", "belief", "kalman", "odometry", "mapping", "ekf_slam")
SECOND = ("metrics", "error_state", "inverse_depth", "motion", "blockwise", "window_slam", "robust", "smoother")


def lines(paths) -> int:
    """Lines of these files together."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def main() -> None:
    """Prints a line for each part of the core, each room of the helper and each folder of the course."""
    core = {path.stem: path for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    parts = {"core, first evening": lines(core[name] for name in FIRST),
             "core, second evening": lines(core[name] for name in SECOND),
             "core, beyond one pass": lines(path for name, path in core.items() if name not in FIRST + SECOND)}
    rooms = sorted(path for path in PACKAGE.iterdir() if (path / "__init__.py").exists() and path.name != "course")
    parts |= {f"{room.name}/": lines(room.rglob("*.py")) for room in rooms}
    for name, count in parts.items():
        print(f"{count:7} {name}")
    course = lines((PACKAGE / "course").rglob("*.py"))
    total = lines(PACKAGE.rglob("*.py"))
    print(f"{total - course:7} the helper\n{course:7} the course\n{total:7} in all")


if __name__ == "__main__":
    main()
