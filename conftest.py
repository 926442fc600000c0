"""The environment that tests, and the kernels nbval starts for the notebooks, run in."""

import os
import sys

os.environ.pop("MPLBACKEND", None)                  # "agg" would keep figures out of the notebooks' outputs
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two workers; the matrices are small
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)     # a hundred processes: each would compile the package anew
sys.dont_write_bytecode = False                     # for this one, which has read that variable already
# nbval imports jsonschema, which would compile the grammar in this for a second, in each of pytest's processes.
sys.modules["rfc3987_syntax"] = None  # type: ignore[assignment]
pytest_plugins = ["nbval.plugin"]
