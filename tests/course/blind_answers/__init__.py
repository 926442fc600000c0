"""Answers to the exercises, written from their statements alone, before there was anything that explains them.

One text file a chapter, an exercise after `# name`, an answer after `## right` or `## wrong: what is wrong`. An answer
is the body of the function, or a line `~ old => new`, which changes the exercise's first right answer.
"""

from dataclasses import dataclass
from pathlib import Path

from vislam_edu.course.exercises import EXERCISES

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Blind:
    exercise: str
    cause: str  # "" where it is right
    body: str

    def function(self):
        scope = {}
        exec((FOLDER / "helpers.txt").read_text(encoding="utf-8"), scope)
        arguments = ", ".join(EXERCISES[self.exercise].arguments)
        lines = "\n".join("    " + line for line in self.body.splitlines())
        exec(f"def {self.exercise}({arguments}):\n{lines}\n", scope)
        return scope[self.exercise]


def read() -> list[Blind]:
    found = []
    for file in sorted(FOLDER.glob("chapter*.txt")):
        for section in file.read_text(encoding="utf-8").split("\n# ")[0:]:
            name, *parts = section.removeprefix("# ").split("\n## ")
            first = None
            for part in parts:
                kind, _, body = part.strip("\n").partition("\n")
                if body.startswith("~ "):
                    old, new = body[2:].split(" => ")
                    assert old in first, (name, kind, old)
                    body = first.replace(old, "" if new == "''" else new)
                first = first or body
                found.append(Blind(name.strip(), kind.removeprefix("right").removeprefix("wrong: "), body))
    return found
