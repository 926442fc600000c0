"""The command line: one file a command, each with `add_arguments(parser)` and `run(arguments)`.

Here lives what argparse needs, what a command prints, and the files that it writes. A command's module, and what that
needs, is imported when the command runs.
"""

import argparse
import sys
from importlib import import_module
from typing import NoReturn

BAD_INPUT, INTERRUPTED = 2, 130

COMMANDS = {  # each a module of this package: what it does
    "run": "the report's pipeline over a recording: figures, trajectories, numbers",
    "info": "what is in a recording",
    "audit": "compare a recording's sensors with each other, before it is filtered",
    "simulate": "make a recording with ground truth: a street loop",
    "consistency": "the filters over many simulated drives: are their covariances honest?",
    "exercises": "grade submitted notebooks, list the mistakes that checks know",
    "clinic": "an examination with unlabelled faults: hand out case files, grade the answers",
    "notebooks": "run the notebooks and store their outputs",
}


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error here does."""

    def error(self, message) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (--help explains)\n")


def parser(argv) -> Parser:
    """The parser for a command line: only the command that it names adds its options."""
    top = Parser(prog="python -m vislam_edu", description="Visual-inertial SLAM with an extended Kalman filter.",
                 epilog="Exit status: 0 done, 2 bad input (one line on stderr says what), 130 interrupted.")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if argv[:1] == [name]:
            import_module(f".{name}", __package__).add_arguments(command)
    return top


def dispatch(argv) -> int:
    """Parse and do; returns the exit status, errors come out as exceptions."""
    arguments = parser(argv).parse_args(argv)
    return import_module(f".{arguments.command}", __package__).run(arguments)


def main(argv=None) -> int:
    """The command line. Returns the exit status; bad input is one line on stderr, never a traceback."""
    argv = sys.argv[1:] if argv is None else list(argv)
    try:
        return dispatch(argv)
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    except OSError as error:
        message = f"{error.filename2 or error.filename or 'output'}: {error.strerror or error}"
    except ValueError as error:
        from ..drive import DriveError
        from .arguments import OptionError

        if not isinstance(error, DriveError | OptionError):
            raise
        message = str(error)
    print("vislam_edu: " + " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT
