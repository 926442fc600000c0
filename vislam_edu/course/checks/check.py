"""What a notebook imports: `check`, `hint` and `solution`.

    check.se3_exp(se3_exp)      says whether the function is right
    hint("se3_exp", 1)          a nudge; 2 says more
    solution("se3_exp")         how the package does it

Under nbgrader (validate or autograde) a check that is not passed also raises AssertionError, so that its cell
scores nothing; anywhere else it only prints, so that a notebook runs from top to bottom with its exercises open.
"""

import inspect
import os
import textwrap

from ...plots.text import on_a_page
from .edit import plain_source
from .exercise import EXERCISES, find
from .picture import Picture
from .running import copied
from .verdict import WRONG, Verdict, judge

NBGRADER = "NBGRADER_EXECUTION"  # set by nbgrader in the kernels it starts


class Check:
    """The check of one exercise: call it with the student's function."""

    def __init__(self, exercise):
        self.exercise = exercise
        self.last: Verdict | None = None
        self.__doc__ = exercise.statement

    def __call__(self, function) -> Picture | None:
        """Try the function and print the verdict; a notebook shows the picture of what is wrong, where there is one.

        At the second failure one after the other it shows the lines of a plain answer, which `hint` does as well.
        """
        failed = self.last is not None and self.last.status == WRONG
        verdict = self.verdict(function)
        print(on_a_page(verdict.text))
        if verdict.more:
            print(verdict.more if failed else f"A second failure, or hint({verdict.exercise!r}), shows where to look.")
        if os.environ.get(NBGRADER) and not verdict.right:
            raise AssertionError(verdict.text)
        return verdict.picture

    def verdict(self, function) -> Verdict:
        """Try the function and return the verdict; prints nothing."""
        self.last = judge(self.exercise, function)
        return self.last

    @property
    def failing(self):
        """The arguments of the input that the last check failed on, fresh, to call the function with."""
        if self.last is None or self.last.failing is None:
            raise ValueError(f"check.{self.exercise.name} has not found a failing input")
        return tuple(map(copied, self.last.failing))

    def __repr__(self):
        return f"check.{self.exercise.name}"


class Checks:
    """All checks, one attribute an exercise."""

    def __getattr__(self, name) -> Check:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            made = vars(self)[name] = Check(find(name))
        except ValueError as error:
            raise AttributeError(str(error)) from None
        return made

    def __dir__(self):
        return list(EXERCISES)

    def __repr__(self):
        return "check: " + ", ".join(EXERCISES)


def hint(name, level=1) -> None:
    """Print a hint for an exercise: level 1 is a nudge, each further one says more."""
    hints = find(name).hints
    if level not in range(1, len(hints) + 1):
        raise ValueError(f"{name} has hints 1 to {len(hints)}, not {level!r}; what is left is solution({name!r})")
    print(on_a_page(f"{name}, hint {level} of {len(hints)}: {hints[level - 1]}"))
    last = getattr(check, name).last
    if last is not None and last.more:
        print(last.more)


def solution(name) -> None:
    """Print a plain answer, and the package's own functions that it stands for."""
    exercise = find(name)
    parts = [plain_source(exercise.reference)]
    parts += [f"# {shown.__module__}.{shown.__qualname__}\n{textwrap.dedent(inspect.getsource(shown))}"
              for shown in exercise.shows]
    print("\n\n".join(part.rstrip() for part in parts))


check = Checks()
