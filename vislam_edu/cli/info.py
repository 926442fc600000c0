"""`python -m vislam_edu info`: what is in a recording."""

from .arguments import add_recording, read_recording


def add_arguments(parser):
    """The options of `info`. parser : argparse.ArgumentParser."""
    add_recording(parser)


def run(arguments):
    """Print what is in the recording; returns the exit status."""
    from . import outputs

    print(outputs.description(read_recording(arguments)))
    return 0
