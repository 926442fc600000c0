"""`python -m vislam_edu`: the command line, see `cli`."""

import gc
import os
import sys

if __name__ == "__main__":
    gc.set_threshold(100_000)  # objects between two searches for unused cycles, by default 700: 6 % of a run
    os.environ["MPLBACKEND"] = "agg"  # nothing is shown in a window, whatever the environment says
    try:
        from .cli import main
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise SystemExit(130) from None
    raise SystemExit(main())
