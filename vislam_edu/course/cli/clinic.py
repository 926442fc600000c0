"""`python -m vislam_edu clinic`: an examination handed out as case files and graded with a secret key."""

import json
import os
import secrets
from pathlib import Path

from ...cli import say
from ...cli.arguments import OptionError, whole
from ...recordings.files import made_folder, shown, write_csv, write_text


def add_arguments(parser):
    """The options of `clinic`. parser : argparse.ArgumentParser."""
    parser.add_argument("what", choices=("hand-out", "grade"),
                        help="hand-out: write one case file a student, with readings only; grade: score their answers")
    parser.add_argument("--key", type=Path, required=True, metavar="FILE",
                        help="the secret that the patients are drawn with; hand-out makes the file where it is missing")
    parser.add_argument("--students", nargs="+", default=[], metavar="NAME", help="for hand-out: names or numbers")
    parser.add_argument("--patients", type=whole(1), default=3, metavar="N", help="for each student (default: 3)")
    parser.add_argument("--level", type=int, choices=(1, 2, 3), default=2, help="default: 2")
    parser.add_argument("--answers", type=Path, metavar="DIR", help="for grade: the answered case files")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR",
                        help="where case files, or clinic.csv and clinic.json, are written (default: here)")


def run(arguments) -> int:
    """Hand out or grade; returns the exit status. Raises OptionError for what is missing or cannot be read."""
    with made_folder(arguments.out):
        return (_hand_out if arguments.what == "hand-out" else _grade)(arguments)


def _hand_out(arguments) -> int:
    from ..clinic import clinic

    if not arguments.students:
        raise OptionError("clinic hand-out: name the students with --students")
    unsafe = [name for name in arguments.students if not name.replace("-", "").replace("_", "").isalnum()]
    if unsafe:
        raise OptionError(f"clinic hand-out: a student's name is made of letters, digits, - and _; got {unsafe[0]!r}")
    if not arguments.key.exists():
        with open(os.open(arguments.key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(secrets.token_hex(32) + "\n")
        say(f"a new key was written to {arguments.key}: keep it from the students")
    key = _key(arguments.key)
    for student in arguments.students:
        path = arguments.out / f"case_{student}.json"
        if path.exists():
            say(f"{path}: is there already and may hold answers, left as it is")
            continue
        cases = [clinic.case(student, number, arguments.level, key) for number in range(1, arguments.patients + 1)]
        write_text(path, json.dumps({"student": student, "level": arguments.level, "cases": cases}, indent=1) + "\n")
        say(f"{len(cases)} patients for {student}: {path}")
    return 0


def _grade(arguments) -> int:
    from ..clinic import clinic

    if arguments.answers is None or not (files := sorted(arguments.answers.glob("*.json"))):
        raise OptionError("clinic grade: --answers names a directory with answered case files")
    key, rows = _key(arguments.key), []
    for file in files:
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            rows += [{"file": file.name, "student": str(content["student"]), "patient": case["number"]}
                     | clinic.grade(content["student"], case, content["level"], key) for case in content["cases"]]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OSError) as error:
            rows.append({"file": file.name, "problem": f"not a case file: {shown(error)}"})
    columns = ["file", "student", "patient", "total", "piece", "kind", "evidence", "cure", "thrift", "problem"]
    write_csv(arguments.out / "clinic.csv", columns, ([row.get(column, "") for column in columns] for row in rows))
    write_text(arguments.out / "clinic.json", json.dumps(rows, indent=2) + "\n")
    for row in rows:
        say(f"{row['file']:24} {row.get('patient', ''):>3} {row.get('total', ''):>6}  {row.get('problem', '')}")
    say(f"written to {arguments.out / 'clinic.csv'} and {arguments.out / 'clinic.json'}")
    return 0


def _key(path: Path) -> str:
    key = path.read_text(encoding="utf-8").strip()
    if not key:
        raise OptionError(f"{path}: the key is empty, and without one everybody can look the patients up")
    return key
