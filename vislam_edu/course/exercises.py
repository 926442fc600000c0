"""All exercises, and the checks that a student's own functions are put to.

    from vislam_edu.course.exercises import check, hint, solution

    check.so3_hat(so3_hat)

One module per chapter holds its exercises: statement, inputs, hints, and the wrong versions that people write.
"""

from importlib import import_module
from pathlib import Path

from .checks.check import check, hint, solution
from .checks.exercise import EXERCISES
from .checks.surroundings import remember

__all__ = ["EXERCISES", "check", "hint", "solution"]

for path in sorted(Path(__file__).parent.glob("ch*/exercises.py")):
    import_module(f".{path.parent.name}.exercises", __package__)  # registers its exercises
for exercise in sorted(EXERCISES.values(), key=lambda each: each.chapter):  # whichever module was imported first
    EXERCISES[exercise.name] = EXERCISES.pop(exercise.name)
remember()  # what numpy and the package are before any answer has run
