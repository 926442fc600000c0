"""`python -m vislam_edu info`: what is in a recording."""

import sys

from . import say
from .arguments import add_recording, ground_truth_doubts, read_recording


def add_arguments(parser):
    """The options of `info`. parser : argparse.ArgumentParser."""
    add_recording(parser)


def run(arguments):
    """Print what is in the recording; returns the exit status."""
    from . import outputs

    drive = read_recording(arguments)
    say(outputs.description(drive))
    for doubt in ground_truth_doubts(arguments, drive):
        say(f"warning: {doubt}", file=sys.stderr)
    return 0
