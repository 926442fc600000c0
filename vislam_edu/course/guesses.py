"""Guesses: asked before a result is shown, kept in a file of the reader's, shown again beside the result.

    drift = guess("How far off is dead reckoning after 500 m?", "m")  # a cell of its own, before the result
    drift.compare(error[-1])                                          # in the cell of the result
    your_guesses()                                                    # at the end of the chapter: all of them

The answers stand in `guesses.json`, in the folder in which the notebook runs. Where nobody can answer (nbval,
nbconvert, `tools/notebooks.py`) nothing is asked, read or printed: no stored output depends on what somebody guessed.
"""

import json
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

from ..plots.text import two_digits
from ..recordings import files

FILE = "guesses.json"
GUESSED = "guessed"  # the tag of a cell whose result the reader guesses first
COMPARED: dict[str, str] = {}  # the questions of this notebook, and what was printed for each


@dataclass(frozen=True)
class Guess:
    """A question and the unit of its answer, "" for an answer in words."""

    question: str
    unit: str = ""

    def keep(self, answer: str) -> None:
        """Write an answer to the reader's file. Raises ValueError for a file that holds no guesses, and OSError."""
        answers = kept() | {self.question: answer.strip().removesuffix(self.unit).strip()}
        files.write_text(Path(FILE), json.dumps(answers, ensure_ascii=False, indent=1) + "\n")

    def compare(self, value: float | str) -> None:
        """Print the answer beside the value, a number in the question's unit or words; nothing where none was given."""
        if can_answer() and (answer := kept().get(self.question)):
            here = value if isinstance(value, str) else two_digits(value)
            COMPARED[self.question] = (f"Your guess: {answer} {self.unit}".rstrip()
                                       + f". Here: {here} {self.unit}".rstrip() + ".")
            print(COMPARED[self.question])


def guess(question: str, unit: str = "") -> Guess:
    """Ask for a guess in a line with a text field; what is entered there is kept, a new answer takes its place.

    Raises ValueError when the file of earlier guesses holds something else.
    """
    asked = Guess(question, unit)
    if can_answer():
        from IPython.display import display

        display(field(asked))
    return asked


def your_guesses() -> None:
    """Print the questions answered in this notebook, each with its answer and its value."""
    for question, line in COMPARED.items():
        print(f"{question}\n    {line}")


def field(asked: Guess):
    """The widget that asks: a `Text`, empty or with the earlier answer, which keeps what is entered."""
    from ipywidgets import Layout, Text

    hint = f"your guess, {asked.unit}, then Enter" if asked.unit else "your guess, then Enter"
    text = Text(kept().get(asked.question, ""), continuous_update=False, placeholder=hint, description=asked.question,
                style={"description_width": "initial"}, layout=Layout(width="95%"))
    text.observe(lambda change: asked.keep(change.new), names="value")
    return text


def kept() -> dict[str, str]:
    """The reader's answers by question. Raises ValueError for a file that holds something else."""
    path = Path(FILE)
    if not path.exists():
        return {}
    try:
        answers = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        answers = None
    if not isinstance(answers, dict) or not all(isinstance(answer, str) for answer in answers.values()):
        raise ValueError(f"{FILE}: not a file of guesses; rename or delete it, and guess again")
    return answers


def can_answer() -> bool:
    """Whether this cell runs in a notebook with somebody before it: what runs notebooks alone takes no input."""
    from IPython import get_ipython

    kernel = getattr(get_ipython(), "kernel", None)
    return bool(kernel and kernel.get_parent("shell")["content"].get("allow_stdin"))


def without_guessed_outputs(notebook: dict) -> dict:
    """A notebook, as read from its file, without the outputs of the cells whose result is to be guessed first."""
    cleared = deepcopy(notebook)
    for cell in cleared["cells"]:
        if GUESSED in cell["metadata"].get("tags", ()):
            cell.update(outputs=[], execution_count=None)
    return cleared
