"""The checks that a student's own functions are put to.

    from vislam_edu.exercises import check, hint, solution

    check.so3_hat(so3_hat)

One module per chapter holds its exercises: statement, inputs, hints, and the wrong versions that people write.
"""

from . import (  # noqa: F401 - register
    chapter01,
    chapter02,
    chapter03,
    chapter04,
    chapter05,
    chapter06,
    chapter07,
    chapter08,
    chapter09,
    chapter10,
    chapter11,
    chapter12,
    chapter13,
)
from .check import check, hint, solution
from .exercise import EXERCISES
from .surroundings import remember

__all__ = ["EXERCISES", "check", "hint", "solution"]

remember()  # what numpy and the package are before any answer has run
