"""`python -m vislam_edu audit`: compare a recording's sensors with each other, before it is filtered."""

import json
import sys
from pathlib import Path

from . import say
from .arguments import OptionError, add_recording, keep, read_recording


def add_arguments(parser):
    """The options of `audit`. parser : argparse.ArgumentParser."""
    add_recording(parser)
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write the figure here (png, pdf, svg)")
    parser.add_argument("--cured", type=Path, metavar="FILE", help="write the drive with all cures applied (npz)")
    parser.add_argument("--causal", action="store_true",
                        help="with --cured: leave out the cures that need the whole drive")


def run(arguments) -> int:
    """Audit the recording asked for and print what was found; returns the exit status."""
    from .. import recordings
    from ..audit import audit

    if arguments.figure and arguments.figure.suffix not in (".png", ".pdf", ".svg"):
        raise OptionError(f"{arguments.figure}: expected a name that ends in .png, .pdf or .svg")
    if arguments.cured:
        keep(arguments.cured, "--cured", arguments.recording, arguments.accelerometer, arguments.ground_truth)
    report = audit(read_recording(arguments))
    say(json.dumps(report.to_dict(), indent=2) if arguments.json else report)
    if arguments.figure:
        report.figure().savefig(arguments.figure, dpi=150)
        say(f"figure: {arguments.figure}", file=sys.stderr)
    if arguments.cured:
        recordings.save(report.cured(needs_future=not arguments.causal), arguments.cured)
        say(f"cured drive: {arguments.cured}", file=sys.stderr)
    return 0
