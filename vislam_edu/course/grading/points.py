"""Points of each student, with names and ids from a roster, and the files that a course's system takes.

The names in a bulk download are read as Canvas makes them, "doejane_LATE_7_9_file.ipynb", and Moodle, a folder "Jane
Doe_7_assignsubmission_file_"; anything else is one folder, or one notebook, a student.
"""

import csv
import json
import math
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from ...cli.arguments import OptionError
from ...recordings.files import shown, write_csv, write_text
from ..checks.verdict import RIGHT
from ..exercises import EXERCISES
from .cells import POINTS
from .grading import Submission

SYSTEMS = ("csv", "canvas", "moodle", "gradescope")
DAY = 86_400.0  # s

_COLUMNS = {  # of a roster: what Canvas's gradebook, Moodle's list of participants and others call them
    "name": ("student", "name", "full name"), "first": ("first name", "firstname"),
    "last": ("last name", "lastname", "surname"), "id": ("id", "user id"),
    "number": ("sis user id", "id number", "student id"), "login": ("sis login id", "username", "login"),
    "email": ("email address", "email", "e-mail"), "section": ("section",), "submitted": ("submitted",)}


@dataclass(frozen=True)
class Person:
    """One student of the roster. id : Canvas's. number : the university's.

    submitted : time in ISO format, in place of the file's.
    """

    name: str = ""
    first: str = ""
    last: str = ""
    id: str = ""
    number: str = ""
    login: str = ""
    email: str = ""
    section: str = ""
    submitted: str = ""

    @property
    def full(self) -> str:
        return self.name or f"{self.first} {self.last}".strip()

    @property
    def ids(self) -> list[str]:
        return [self.id, self.number, self.email]

    @property
    def keys(self) -> set[str]:
        """What a folder or file of this student may be called."""
        last, comma, first = self.name.partition(",")
        names = (self.full, f"{self.last}{self.first}", f"{first}{last}" if comma else "", self.id, self.number,
                 self.login, self.email, self.email.partition("@")[0])
        return {_plain(name) for name in names} - {""}


def _plain(name: str) -> str:
    return "".join(c for c in unicodedata.normalize("NFKD", name.casefold()) if c.isalnum())


def _rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file, its columns in lower case. Raises OptionError, and OSError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise OptionError(f"{path}: not UTF-8: save it as CSV UTF-8") from None
    first = text.partition("\n")[0]
    reader = csv.DictReader(text.splitlines(), delimiter=";" if first.count(";") > first.count(",") else ",")
    return [{(key or "").strip().lower(): (value or "").strip() for key, value in row.items() if isinstance(value, str)}
            for row in reader]


def roster(path: Path) -> list[Person]:
    """The students of a CSV file: Canvas's gradebook, Moodle's participants, or columns name, id, email."""
    people = []
    for row in _rows(path):
        person = Person(**{key: next((row[name] for name in names if row.get(name)), "")
                           for key, names in _COLUMNS.items()})
        if person.full and "Points Possible" not in person.full:
            people.append(person)
        try:
            datetime.fromisoformat(person.submitted or "2026-01-01")
        except ValueError:
            raise OptionError(f"{path}: submitted must be a time such as 2026-05-01T23:59, got "
                              f"{shown(person.submitted)!r} for {shown(person.full)}") from None
    if not people:
        raise OptionError(f"{path}: no student in it; a roster has the columns name (or first name, last name), id, "
                          "email")
    return people


def worth(path: Path) -> dict[str, float]:
    """The points of each exercise from a CSV file with the columns exercise and points."""
    points = {}
    for number, row in enumerate(_rows(path), 2):
        name = row.get("exercise", "")
        try:
            points[name] = float(row.get("points", ""))
        except ValueError:
            raise OptionError(f"{path}, row {number}: points must be a number, got {row.get('points')!r}") from None
        if name not in EXERCISES or not 0 <= points[name] < math.inf:
            raise OptionError(f"{path}, row {number}: no exercise {name!r}, or points below zero")
    return points


@dataclass
class Row:
    """One student's points: `points` of each exercise, before `late` (days, begun) takes its share of the `total`."""

    student: str
    person: Person | None
    points: dict[str, float] = field(default_factory=dict)
    late: int = 0
    total: float = 0.0
    submissions: list[Submission] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def rows(submissions: Iterable[Submission], people: Sequence[Person] = (), points: Mapping[str, float] | None = None,
         due: datetime | None = None, penalty: float = 0.0, best: bool = False) -> tuple[list[Row], dict[str, float]]:
    """A row for each student of the roster and each other one, and what each exercise is worth.

    points : of the exercises that count; None: all that occur, one point each. penalty : percent of the points that
    each day after `due` costs, begun days counted. best : where a student handed in several notebooks of a chapter, the
    one with the most points counts, otherwise the newest.
    """
    submissions = list(submissions)
    if points is None:
        found = {result.exercise for submission in submissions for result in submission.results}
        points = {name: float(POINTS) for name in EXERCISES if name in found}
    own: dict[str, list[Submission]] = defaultdict(list)
    for submission in submissions:
        own[submission.student].append(submission)
    table = {person: Row(person.full, person) for person in people}
    others = []
    for student, files in own.items():
        matching = [person for person in people if files[0].student_id and files[0].student_id == person.id] or \
            [person for person in people if {_plain(student), _plain(files[0].student_name)} & person.keys]
        row = table[matching[0]] if len(matching) == 1 else Row(student, None)
        if people and row.person is None:
            row.remarks.append("several students of the roster have this name" if matching else "not in the roster")
        if row.person is None:
            others.append(row)
        row.submissions += files
    done = [*table.values(), *others]
    for row in done:
        _add_up(row, points, due, penalty, best)
    return done, dict(points)


def _add_up(row, points, due, penalty, best) -> None:
    if not row.submissions:
        row.remarks.append("nothing handed in")
    chapters: dict[int, list[Submission]] = defaultdict(list)
    for submission in row.submissions:
        if submission.problem:
            row.remarks.append(f"{submission.name}: {submission.problem}")
        for chapter in dict.fromkeys(result.chapter for result in submission.results):
            chapters[chapter].append(submission)

    def earned(submission, chapter) -> dict[str, float]:
        return {result.exercise: points.get(result.exercise, 0.0) * (result.status == RIGHT)
                for result in submission.results if result.chapter == chapter}

    row.submissions = []
    for chapter, versions in chapters.items():
        chosen = max(versions, key=lambda one: (
            sum(earned(one, chapter).values()) if best else 0.0, one.time, one.name))
        if chosen not in row.submissions:
            row.submissions.append(chosen)
        if len(versions) > 1:
            row.remarks.append(f"chapter {chapter}, {'best' if best else 'newest'} of {len(versions)}: {chosen.name}")
        own = earned(chosen, chapter)
        given = row.person.submitted if row.person else ""
        time = datetime.fromisoformat(given).timestamp() if given else chosen.time
        late = max(0, math.ceil((time - due.timestamp()) / DAY)) if due else 0
        row.late = max(row.late, late)
        row.points |= own
        row.total += sum(own.values()) * max(0.0, 1 - penalty / 100 * late)


def write(found: Sequence[Row], points: Mapping[str, float], folder: Path, system: str = "csv",
          assignment: str = "vislam_edu") -> list[str]:
    """Write points.csv and what a system takes: canvas.csv, moodle.csv, or Gradescope's results of each student.

    assignment : its name there; in Canvas with its number, as the gradebook shows it. Returns the names of the files.
    """
    maximum = sum(points.values())
    write_csv(folder / "points.csv", ["student", "id", "number", "email", *points, "days late", "total", "maximum",
                                      "notebooks", "remarks"], (
        [row.student, *(row.person or Person()).ids,
         *(_number(row.points[name]) if name in row.points else "" for name in points), row.late, _number(row.total),
         _number(maximum), "; ".join(one.name for one in row.submissions), "; ".join(row.remarks)] for row in found))
    people = [(row, row.person) for row in found if row.person]
    if system == "canvas":
        write_csv(folder / "canvas.csv", ["Student", "ID", "SIS User ID", "SIS Login ID", "Section", assignment], [
            ["Points Possible", "", "", "", "", _number(maximum)],
            *([one.full, one.id, one.number, one.login, one.section, _number(row.total)] for row, one in people)])
    elif system == "moodle":
        write_csv(folder / "moodle.csv", ["First name", "Last name", "ID number", "Email address", assignment,
                                          f"{assignment} (feedback)"], (
            [one.first or one.full, one.last, one.number, one.email, _number(row.total), "; ".join(row.remarks)]
            for row, one in people))
    elif system == "gradescope":
        (folder / "gradescope").mkdir(exist_ok=True)
        for row in found:
            write_text(folder / "gradescope" / f"{file_name(row.student)}.json",
                       json.dumps(results_json(row, points), indent=1) + "\n")
    return ["points.csv", *([] if system == "csv" else [system if system == "gradescope" else f"{system}.csv"])]


def results_json(row: Row, points: Mapping[str, float]) -> dict:
    """Gradescope's results.json of one student."""
    told = {result.exercise: result for submission in row.submissions for result in submission.results}
    return {"score": round(row.total, 4), "output": "; ".join(row.remarks), "visibility": "visible", "tests": [
        {"name": name, "score": row.points.get(name, 0.0), "max_score": most, "visibility": "visible",
         "status": "passed" if row.points.get(name, 0.0) >= most else "failed",
         "output": told[name].detail or told[name].status if name in told else "not in the notebook"}
        for name, most in points.items()]}


def file_name(student: str) -> str:
    """A student's name as a file may be called."""
    return re.sub(r"[^\w.-]", "_", shown(student, 80)).lstrip(".") or "_"


def _number(value: float) -> str:
    return f"{round(value, 2):g}"
