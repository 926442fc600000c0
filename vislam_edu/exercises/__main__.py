"""`python -m vislam_edu.exercises`: the same as `python -m vislam_edu exercises`."""

from .report import main

raise SystemExit(main())
