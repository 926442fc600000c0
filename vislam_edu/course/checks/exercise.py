"""What an exercise is: a function to write, the inputs it is tried on, and the wrong versions people write.

    @exercise(chapter=1, cases=some_generator, hints=("first", "second"), shows=[se3.so3_hat])
    def so3_hat(omega):
        '''Statement: what to write, shapes, frames, units.'''
        x, y, z = omega
        return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])

    so3_hat.slip("transposed", "What the student reads.", ("return np", "return -np"))

The decorated function is the reference: a plain answer, as a student would write it, with the symbols of the statement.
`mutants` changes it in one place at a time, so a line of it does one thing. A usual mistake is an edit of it. Its
signature and docstring become the student's stub.
"""

import functools
import inspect
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np

from .edit import Edit, diff, edited

EXERCISES: dict[str, "Exercise"] = {}  # by name, in the order of the chapters

SEED = 276
ORDINARY = "random"  # label of inputs that are no special case

_WIDTH = 96  # characters of a line in a stub: more would have to be scrolled in JupyterLab

_STUB = '''def {name}{signature}:
    """{doc}

    Checked to {tolerance} of the largest entry.
    """
    # BEGIN SOLUTION
    raise NotImplementedError
    # END SOLUTION
'''


@dataclass(frozen=True)
class Mistake:
    """One wrong version: its name in the museum, what the student reads, and a function with the edits made in it."""

    name: str
    hint: str
    base: Callable
    edits: tuple[Edit, ...]

    @functools.cached_property
    def function(self) -> Callable:
        return edited(self.base, *self.edits)

    def lines(self) -> str:
        """The lines of the plain answer that the edits change, as a diff."""
        return diff(self.base, *self.edits, around=0)


@dataclass(frozen=True, eq=False)
class Exercise:
    """One exercise; see the module's docstring.

    reference : the right answer, a plain one; the exercise itself can be called in its place.
    cases : a function of a random generator that yields (label, arguments).
    hints : from a nudge to nearly the answer. shows : the package's functions that `solution` prints.
    outputs : names of the results where the answer returns several, else empty.
    canonical : what to compare, as a function of the list of results; None compares them as they are.
    tolerance : largest error, relative to the largest entry of the result.
    reading : what is made of a result before it is compared, where it is no array; None takes it as it is.
    first : of (arguments, results, right results), what differs first and where to look, two sentences; None : none.
    inherited : mistakes of other exercises that are recognised in this one too.
    """

    chapter: int
    reference: Callable
    cases: Callable
    hints: tuple[str, ...]
    shows: tuple[Callable, ...]
    outputs: tuple[str, ...]
    canonical: Callable | None
    tolerance: float
    reading: Callable | None = None
    first: Callable | None = None
    inherited: list[Mistake] = field(default_factory=list)
    mistakes: list[Mistake] = field(default_factory=list)
    answers: list[Callable] = field(default_factory=list)  # the plain ones: the reference, and other usual ways

    def __call__(self, *arguments):
        return self.reference(*arguments)

    @property
    def name(self) -> str:
        return self.reference.__name__

    @functools.cached_property
    def arguments(self) -> list[str]:
        return list(inspect.signature(self.reference).parameters)

    @property
    def statement(self) -> str:
        return inspect.getdoc(self.reference) or ""

    @property
    def stub(self) -> str:
        """The cell that the student fills in. The marks between which the answer goes are nbgrader's."""
        paragraphs = (textwrap.fill(text, _WIDTH, initial_indent="    ", subsequent_indent="    ")
                      for text in self.statement.split("\n\n"))
        return _STUB.format(name=self.name, signature=inspect.signature(self.reference),
                            doc="\n\n".join(paragraphs).lstrip(), tolerance=short(self.tolerance))

    def inputs(self, seed: int = SEED) -> list:
        """The (label, arguments) the answer is tried on: always the same, freshly made.

        Ordinary ones come first, so that a student is shown one of these where all are wrong.
        """
        return sorted(self.cases(np.random.default_rng(seed)), key=lambda case: case[0] != ORDINARY)

    def expected(self, *arguments):
        """The right result, read as an answer's is."""
        with np.errstate(all="ignore"):
            result = self.reference(*arguments)
        return self.reading(result) if self.reading else result

    def otherwise(self, function: Callable) -> Callable:
        """Decorator of another plain answer that is usual too."""
        self.answers.append(function)
        return function

    def slip(self, name: str, hint: str, *edits: Edit, of: Callable | None = None) -> None:
        """Hang a plain answer (the reference, where `of` names no other) with these edits in the museum."""
        self.mistakes.append(Mistake(name, " ".join(hint.split()), of or self.reference, edits))


def exercise(*, chapter, cases, hints, shows, outputs=(), canonical=None, tolerance=1e-8, reading=None, first=None):
    """Decorator that makes an exercise of its reference answer and enters it under the function's name."""
    def enter(reference):
        entry = Exercise(chapter, reference, cases, tuple(" ".join(hint.split()) for hint in hints), tuple(shows),
                         tuple(outputs), canonical, tolerance, reading, first, answers=[reference])
        if entry.name in EXERCISES:
            raise ValueError(f"there are two exercises called {entry.name}")
        EXERCISES[entry.name] = entry
        return entry
    return enter


def find(name) -> Exercise:
    """The exercise of that name. Raises ValueError, naming those that sound alike."""
    try:
        return EXERCISES[name]
    except KeyError:
        close = get_close_matches(str(name), EXERCISES, n=3, cutoff=0.4) or list(EXERCISES)
        raise ValueError(f"there is no exercise {name!r}; did you mean {' or '.join(close)}?") from None


def short(number) -> str:
    """1e-8 rather than 1e-08."""
    return f"{number:.0e}".replace("e-0", "e-").replace("e+0", "e+")
