"""`python -m vislam_edu`: the command line, see `cli`."""

import os

from .cli import main

if __name__ == "__main__":
    os.environ["MPLBACKEND"] = "agg"  # nothing is shown in a window, whatever the environment says
    raise SystemExit(main())
