"""`python -m vislam_edu`: the command line, see `cli`."""

import os
import sys

if __name__ == "__main__":
    os.environ["MPLBACKEND"] = "agg"  # nothing is shown in a window, whatever the environment says
    try:
        from .cli import main
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise SystemExit(130) from None
    raise SystemExit(main())
