"""A recording is audited before it is filtered: its sensors are compared with each other and with what is possible.

Here live the comparisons, the findings, and the cures that the findings propose. A filter runs only
where the tracks are too few for visual odometry.
"""

from .judge import audit
from .report import Finding, Report

__all__ = ["Finding", "Report", "audit"]
