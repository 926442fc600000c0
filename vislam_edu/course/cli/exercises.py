"""`python -m vislam_edu exercises`: submissions graded, the known mistakes as a table."""

import importlib.util
import tempfile
from pathlib import Path

from ...cli.arguments import OptionError, number, whole
from ..checks import museum
from ..grading import collecting, grading, report, sandbox


def add_arguments(parser):
    """The options of `exercises`. parser : argparse.ArgumentParser."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--report", type=Path, metavar="PATH",
                      help="run a submitted notebook, or all in a folder, and say which checks passed; this runs "
                           "their code: docs/teaching.md says what protects you")
    what.add_argument("--museum", action="store_true", help="print every exercise, its mistakes and their hints")
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR",
                        help="where --report writes exercises.csv and .json, matrix.csv, summary.txt and feedback/ "
                             "(default: here); what an interrupted run has graded is kept there too")
    parser.add_argument("--limit", type=number(0, 10**6, low_allowed=False), default=grading.LIMIT, metavar="S",
                        help=f"seconds that one submitted notebook may take (default: {grading.LIMIT:g})")
    parser.add_argument("--jobs", type=whole(1, 256), default=1, metavar="N", help="notebooks at a time (default: 1)")
    parser.add_argument("--sandbox", action="store_true",
                        help="run each notebook in bubblewrap, podman or docker, without network and with the "
                             "submissions read-only; refuse where none of them works")
    parser.add_argument("--image", default=sandbox.IMAGE, metavar="NAME",
                        help=f"for podman and docker: an image that has this package (default: {sandbox.IMAGE})")


def run(arguments) -> int:
    """Do what the arguments ask for; returns the exit status. Raises OSError for paths that do not work."""
    if arguments.museum:
        print(museum.table())
    else:
        _report(arguments)
    return 0


def _report(arguments) -> None:
    if importlib.util.find_spec("IPython") is None:
        raise OptionError("IPython is needed to run notebooks: python -m pip install ipykernel")
    collecting.notebooks(arguments.report)  # before anything is made
    chosen = _sandbox(arguments) if arguments.sandbox else None
    arguments.out.mkdir(parents=True, exist_ok=True)
    submissions = collecting.graded(arguments.report, arguments.out, arguments.limit, arguments.jobs, chosen)
    report.write(submissions, arguments.out)
    (arguments.out / collecting.KEPT).unlink()
    print(report.table(submissions) + "\n\n" + report.summary(submissions))
    print(f"written to {arguments.out}: exercises.csv, exercises.json, matrix.csv, summary.txt, feedback")


def _sandbox(arguments) -> sandbox.Sandbox:
    folder = arguments.report if arguments.report.is_dir() else arguments.report.parent
    with tempfile.TemporaryDirectory(prefix="vislam_edu-") as scratch:
        try:
            return sandbox.find(folder.resolve(), Path(scratch), arguments.image)
        except sandbox.SandboxError as error:
            raise OptionError(f"exercises --sandbox: {error}") from None
