"""`python -m vislam_edu exercises`: submissions graded, the known mistakes as a table."""

import argparse
import importlib.util
import tempfile
from datetime import datetime
from pathlib import Path

from ...cli import say
from ...cli.arguments import OptionError, number, whole
from ...recordings import files
from ..checks import museum
from ..grading import collecting, grading, points, report, sandbox


def add_arguments(parser):
    """The options of `exercises`. parser : argparse.ArgumentParser."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--report", type=Path, metavar="PATH",
                      help="run a submitted notebook, or all in a folder, and say which checks passed; this runs "
                           "their code: docs/teaching.md says what protects you")
    what.add_argument("--museum", action="store_true", help="print every exercise, its mistakes and their hints")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR",
                        help="where --report writes exercises.csv and .json, matrix.csv, points.csv, similar.csv, "
                             "summary.txt and feedback/ (default: here); what an interrupted run has graded is "
                             "kept there too")
    parser.add_argument("--limit", type=number(0, 10**6, low_allowed=False), default=grading.LIMIT, metavar="S",
                        help=f"seconds that one submitted notebook may take (default: {grading.LIMIT:g})")
    parser.add_argument("--jobs", type=whole(1, 256), default=1, metavar="N", help="notebooks at a time (default: 1)")
    parser.add_argument("--sandbox", action="store_true",
                        help="run each notebook in bubblewrap, podman or docker, without network and with the "
                             "submissions read-only; refuse where none of them works")
    parser.add_argument("--image", default=sandbox.IMAGE, metavar="NAME",
                        help=f"for podman and docker: an image that has this package (default: {sandbox.IMAGE})")
    parser.add_argument("--roster", type=Path, metavar="FILE",
                        help="CSV with the students: Canvas's gradebook, Moodle's participants, or name, id, email")
    parser.add_argument("--points", type=Path, metavar="FILE",
                        help="CSV with the columns exercise and points (default: one point for each exercise found)")
    parser.add_argument("--for", choices=points.SYSTEMS, default="csv", dest="system",
                        help="also write what this system takes: canvas.csv, moodle.csv, or gradescope/ with a "
                             "results.json for each student (default: points.csv alone)")
    parser.add_argument("--assignment", default="vislam_edu", metavar="NAME",
                        help="its name in that system; for Canvas with its number, as in 'Chapter 3 (4711)'")
    parser.add_argument("--due", type=_time, metavar="TIME", help="when it was due: 2026-05-01T23:59")
    parser.add_argument("--late", type=number(0, 100), default=0.0, metavar="PERCENT",
                        help="of the points, that each day after --due costs, begun days counted (default: 0)")
    parser.add_argument("--several", choices=("newest", "best"), default="newest",
                        help="which of a student's notebooks of a chapter counts (default: %(default)s)")


def _time(text: str) -> datetime:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no time; write it as 2026-05-01T23:59") from None


def run(arguments) -> int:
    """Do what the arguments ask for; returns the exit status. Raises OSError for paths that do not work."""
    if arguments.museum:
        say(museum.table())
    else:
        _report(arguments)
    return 0


def _report(arguments) -> None:
    if importlib.util.find_spec("IPython") is None:
        raise OptionError("IPython is needed to run notebooks: python -m pip install ipykernel")
    collecting.notebooks(arguments.report)  # before anything is made
    people = points.roster(arguments.roster) if arguments.roster else []
    worth = points.worth(arguments.points) if arguments.points else None
    if arguments.system in ("canvas", "moodle") and not people:
        raise OptionError(f"exercises --for {arguments.system}: --roster names the file with the students' ids")
    chosen = _sandbox(arguments) if arguments.sandbox else None
    with files.made_folder(arguments.out):
        submissions = collecting.graded(arguments.report, arguments.out, arguments.limit, arguments.jobs, chosen)
        report.write(submissions, arguments.out)
        rows, worth = points.rows(submissions, people, worth, arguments.due, arguments.late,
                                  arguments.several == "best")
        written = points.write(rows, worth, arguments.out, arguments.system, arguments.assignment)
        (arguments.out / collecting.KEPT).unlink()
    say(report.table(submissions) + "\n\n" + report.summary(submissions))
    say(f"written to {arguments.out}: exercises.csv, exercises.json, matrix.csv, {', '.join(written)}, similar.csv, "
          "summary.txt, feedback")


def _sandbox(arguments) -> sandbox.Sandbox:
    folder = arguments.report if arguments.report.is_dir() else arguments.report.parent
    with tempfile.TemporaryDirectory(prefix="vislam_edu-") as scratch:
        return sandbox.find(folder.resolve(), Path(scratch), arguments.image)
