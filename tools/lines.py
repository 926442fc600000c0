"""Lines of Python in each part of the package, and how many of them are code:  python tools/lines.py

The others are docstrings, comments and blank lines. `MOST` is what the two floors may have (a test holds it): whoever
adds lets something go.
"""

import ast
from collections.abc import Iterable
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "vislam_edu"
FIRST = ("se3", "stereo", "noise", "drive", "belief", "kalman", "odometry", "mapping", "ekf_slam", "inverse_depth")
SECOND = ("metrics", "error_state", "motion", "blockwise", "window_slam", "robust", "smoother")
MOST = {"the helper": 13_600, "the course": 11_350}


def counted(paths: Iterable[Path]) -> tuple[int, int]:
    """All lines of these files together, and those that are code."""
    total = code = 0
    for path in paths:
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        docstrings = {i for node in ast.walk(ast.parse(text))
                      if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node)
                      for i in range(node.body[0].lineno - 1, node.body[0].end_lineno)}
        total += len(lines)
        code += sum(bool(line.strip()) and not line.lstrip().startswith("#") and i not in docstrings
                    for i, line in enumerate(lines))
    return total, code


def parts() -> dict[str, tuple[int, int]]:
    """`counted` of each part of the core, each room of the helper, both floors, and all."""
    core = {path.stem: path for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")}
    rooms = sorted(path for path in PACKAGE.iterdir() if (path / "__init__.py").exists() and path.name != "course")
    course = set((PACKAGE / "course").rglob("*.py"))
    return {"core, first evening": counted(core[name] for name in FIRST),
            "core, second evening": counted(core[name] for name in SECOND),
            "core, beyond one pass": counted(path for name, path in core.items() if name not in FIRST + SECOND),
            **{f"{room.name}/": counted(room.rglob("*.py")) for room in rooms},
            "the helper": counted(set(PACKAGE.rglob("*.py")) - course), "the course": counted(course),
            "in all": counted(PACKAGE.rglob("*.py"))}


if __name__ == "__main__":
    print("  lines  of code")
    for name, (total, code) in parts().items():
        print(f"{total:7,} {code:8,}  {name}" + (f" (at most {MOST[name]:,})" if name in MOST else ""))
