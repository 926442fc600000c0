"""The environment that tests, and the kernels nbval starts for the notebooks, run in."""

import os

os.environ.pop("MPLBACKEND", None)                  # "agg" would keep figures out of the notebooks' outputs
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two workers; the matrices are small
