"""Whether the long version of the tests is asked for: `VISLAM_EDU_WHOLE=1`."""

import os

WHOLE = bool(os.environ.get("VISLAM_EDU_WHOLE"))
