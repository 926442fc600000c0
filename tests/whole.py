"""Whether the long version of the tests is asked for: `VISLAM_EDU_WHOLE=1`."""

import os

WHOLE = bool(os.environ.get("VISLAM_EDU_WHOLE"))


def few(number, cases):
    """The first cases of a test whose others would fail with them; in the long version all."""
    return list(cases) if WHOLE else list(cases)[:number]
