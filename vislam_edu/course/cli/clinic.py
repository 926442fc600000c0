"""`python -m vislam_edu clinic`: an examination served page by page, and graded with a secret key."""

import contextlib
import json
import os
import secrets
from pathlib import Path

from ...cli import say
from ...cli.arguments import OptionError, whole
from ...recordings.files import made_folder, write_csv, write_text

_WHO = ["student", "id", "number", "email"]


def add_arguments(parser):
    """The options of `clinic`. parser : argparse.ArgumentParser."""
    parser.add_argument("what", choices=("serve", "grade"),
                        help="serve: write links.csv and show each student a page, until Ctrl-C; grade: score the log")
    parser.add_argument("--key", type=Path, required=True, metavar="FILE",
                        help="the secret that the patients are drawn with; serve makes the file where it is missing")
    parser.add_argument("--students", nargs="+", default=[], metavar="NAME", help="for serve: names or numbers")
    parser.add_argument("--roster", type=Path, metavar="FILE", help="for serve: a CSV as for `exercises`")
    parser.add_argument("--patients", type=whole(1, 20), default=3, metavar="N", help="for each student (default: 3)")
    parser.add_argument("--level", type=int, choices=(1, 2, 3), default=2, help="default: 2")
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS",
                        help="of this computer, as the students reach it (default: 127.0.0.1, this computer alone)")
    parser.add_argument("--port", type=whole(0, 65535), default=8000, help="0: a free one (default: 8000)")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR",
                        help="where log.txt, links.csv, clinic.csv and clinic.json are (default: here)")


def run(arguments) -> int:
    """Serve or grade; returns the exit status. Raises OptionError for what is missing, or a changed log."""
    with made_folder(arguments.out):
        return _serve(arguments) if arguments.what == "serve" else _grade(arguments)


def _serve(arguments) -> int:
    from ..clinic import examination
    from ..grading import points

    people = [*map(points.Person, arguments.students), *(points.roster(arguments.roster) if arguments.roster else [])]
    if not people:
        raise OptionError("clinic serve: name the students with --students or --roster")
    names, students = [person.full for person in people], {}
    for person, name in zip(people, names):
        if names.count(name) > 1 and any(person.ids):
            name = f"{name} ({person.number or person.id or person.email})"
        if name in students or not name.strip() or not name.isprintable():
            raise OptionError(f"clinic serve: a student's name is printable, and no other student's; got {name!r}")
        students[name] = person.ids
    if not arguments.key.exists():
        with open(os.open(arguments.key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(secrets.token_hex(32) + "\n")
        say(f"a new key was written to {arguments.key}: keep it from the students")
    exam = examination.Examination(arguments.out / "log.txt", _key(arguments.key))
    exam.start(students, arguments.level, arguments.patients)
    with examination.server(exam, (arguments.host, arguments.port)) as server:
        base = f"http://{arguments.host}:{server.server_address[1]}"
        write_csv(arguments.out / "links.csv", [*_WHO, "link"],
                  ([name, *ids, f"{base}/{exam.token(name)}"] for name, ids in exam.students.items()))
        print(f"{len(exam.students)} students at {base}; their links: {arguments.out / 'links.csv'}. Ctrl-C ends it",
              flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
    return 0


def _grade(arguments) -> int:
    from ..clinic import examination

    log = arguments.out / "log.txt"
    if not log.exists():
        raise OptionError(f"clinic grade: {log} is missing; --out names the folder that `clinic serve` wrote into")
    exam = examination.Examination(log, _key(arguments.key))
    numbers = range(1, exam.patients + 1)
    graded = {student: [exam.grade(student, number) for number in numbers] for student in exam.students}
    rows = [[student, *exam.students[student], round(sum(one["total"] for one in scores), 3), 10 * exam.patients,
             *(one["total"] for one in scores),
             " ".join(f"{one['patient']}: {remark}" for one in scores for remark in one["remarks"])]
            for student, scores in graded.items()]
    write_csv(arguments.out / "clinic.csv",
              [*_WHO, "total", "maximum", *(f"patient {number}" for number in numbers), "remarks"], rows)
    write_text(arguments.out / "clinic.json", json.dumps(graded, indent=2, ensure_ascii=False) + "\n")
    for student, _, _, _, total, most, *_ in rows:
        say(f"{student:30} {total:>6} of {most}")
    say(f"written to {arguments.out / 'clinic.csv'} and {arguments.out / 'clinic.json'}")
    return 0


def _key(path: Path) -> str:
    key = path.read_text(encoding="utf-8").strip()
    if not key:
        raise OptionError(f"{path}: the key is empty, and without one everybody can look the patients up")
    return key
