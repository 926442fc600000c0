"""`python -m vislam_edu exercises`: submissions graded, the museum as a table, stubs for authors."""

from pathlib import Path

from ..exercises import EXERCISES, grading, museum, report
from .arguments import number


def add_arguments(parser):
    """The options of `exercises`. parser : argparse.ArgumentParser."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--report", type=Path, metavar="PATH",
                      help="run a submitted notebook, or all in a folder, and say which checks passed; this runs "
                           "their code: see the README before you run strangers' notebooks")
    what.add_argument("--museum", action="store_true", help="print every exercise, its mistakes and their hints")
    what.add_argument("--stubs", type=int, choices=sorted({e.chapter for e in EXERCISES.values()}),
                      metavar="CHAPTER", help="print the exercise cells of a chapter, for authors")
    what.add_argument("--refresh", type=Path, metavar="NOTEBOOK",
                      help="for authors: bring the exercise cells of a notebook up to date, with nbgrader's metadata; "
                           "answers in them are lost")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR",
                        help="where --report writes exercises.csv and exercises.json (default: here)")
    parser.add_argument("--limit", type=number(0, low_allowed=False), default=grading.LIMIT, metavar="S",
                        help=f"seconds that one submitted notebook may take (default: {grading.LIMIT:g})")


def run(arguments) -> int:
    """Do what the arguments ask for; returns the exit status. Raises OSError for paths that do not work."""
    if arguments.museum:
        print(museum.table())
    elif arguments.stubs is not None:
        print(report.stubs(arguments.stubs))
    elif arguments.refresh is not None:
        print(f"{arguments.refresh}: changed {', '.join(report.refresh(arguments.refresh)) or 'nothing'}")
    else:
        arguments.out.mkdir(parents=True, exist_ok=True)
        submissions = report.graded(arguments.report, arguments.limit)
        print(report.table(submissions))
        report.write(submissions, arguments.out)
        print(f"written to {arguments.out / 'exercises.csv'} and {arguments.out / 'exercises.json'}")
    return 0
