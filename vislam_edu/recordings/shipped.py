"""The files that come with the package: two drives, the notebooks, the pages about them, stored results of studies.

In a clone they stand beside the package; a wheel carries them in the package's folder `shipped` (see setup.py).
"""

import json
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]
ROOT = _PACKAGE / "shipped" if (_PACKAGE / "shipped").is_dir() else _PACKAGE.parent


def results(name: str) -> dict[str, Any]:
    """What a script of `benchmarks/` or a study stored under this name: studies that take longer than a notebook may.

    >>> results("consistency")["runs"]
    50
    """
    return json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text(encoding="utf-8"))
