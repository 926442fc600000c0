"""The command line: one file a command, each with `add_arguments(parser)` and `run(arguments)`.

Here lives what argparse needs, what a command prints, and the files that it writes. A command's module, and what that
needs, is imported when the command runs.
"""

import argparse
import contextlib
import io
import os
import signal
import sys
import traceback
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import NoReturn, TextIO

BAD_INPUT, INTERRUPTED = 2, 130

COMMANDS = {  # each a module of this package: what it does
    "run": "the report's pipeline over a recording: figures, trajectories, numbers",
    "info": "what is in a recording",
    "audit": "compare a recording's sensors with each other, before it is filtered",
    "track": "make a recording's tracks from its images",
    "simulate": "make a recording with ground truth: a street loop",
    "consistency": "the filters over many simulated drives: are their covariances honest?",
}
PLUGINS = "vislam_edu.commands"  # entry points of packages whose COMMANDS, a module each, are offered too


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error here does."""

    def error(self, message) -> NoReturn:
        raise SystemExit(_stopped(f"{self.prog}: {message} (--help explains)", BAD_INPUT))


def parser(argv) -> Parser:
    """The parser for a command line: only the command that it names adds its options."""
    top = Parser(prog="python -m vislam_edu", description="Visual-inertial SLAM with an extended Kalman filter.",
                 epilog="Exit status: 0 done, 2 bad input (one line on stderr says what), 130 interrupted.")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    for name, (package, text) in available().items():
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if argv[:1] == [name]:
            _module(name, package).add_arguments(command)
            command.set_defaults(package=package)
    return top


def available() -> dict[str, tuple[str, str]]:
    """Each command: the package whose module of that name it is, and what it does. The course adds its own."""
    packages = [__package__, *(point.value for point in entry_points(group=PLUGINS))]
    return {name: (package, text) for package in packages for name, text in import_module(package).COMMANDS.items()}


def dispatch(argv) -> int:
    """Parse and do; returns the exit status, errors come out as exceptions."""
    arguments = parser(argv).parse_args(argv)
    return _module(arguments.command, arguments.package).run(arguments)


def _module(name, package):
    return import_module(f".{name.replace('-', '_')}", package)


def main(argv=None, do=None) -> int:
    """The command line. Returns the exit status; bad input is one line on stderr, never a traceback.

    do : function of the list of arguments that does what they ask for and returns the exit status.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without the letters of a name shows question marks
    if sys.stderr is None:  # closed, as by 2>&-
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    try:
        with _terminable():
            return (do or dispatch)(sys.argv[1:] if argv is None else list(argv))
    except KeyboardInterrupt as error:
        return _stopped(f"interrupted; {str(error) or 'nothing was written'}", INTERRUPTED)
    except OSError as error:
        message = f"{error.filename2 or error.filename or 'output'}: {error.strerror or error}"
    except ModuleNotFoundError as error:
        message = f"this needs {error.name}, which is not installed: python -m pip install {error.name}"
    except MemoryError:
        message = "not enough memory for this; give a smaller recording or fewer landmarks (--every)"
    except Exception as error:  # the last resort: every kind of bad input should have its own sentence
        from ..drive import DriveError
        from .arguments import OptionError

        if _caused_by_interrupt(error):
            return _stopped("interrupted; nothing was written", INTERRUPTED)
        message = str(error)
        if not isinstance(error, DriveError | OptionError):
            at = traceback.extract_tb(error.__traceback__)[-1]
            message = (f"unforeseen {type(error).__name__} in {Path(at.filename).name}, line {at.lineno}: {error}; "
                       "please report it with the command that you entered")
    return _stopped(f"vislam_edu: {message}", BAD_INPUT)


@contextlib.contextmanager
def _terminable():
    """SIGTERM and SIGHUP interrupt as Ctrl-C does, so that what is half-written is cleaned up; nohup stays as it is."""
    def interrupt(*_):
        raise KeyboardInterrupt

    signals = [number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))
               and signal.getsignal(number) != signal.SIG_IGN]
    before = {}
    try:
        with contextlib.suppress(ValueError):  # not the main thread
            before = {number: signal.signal(number, interrupt) for number in signals}
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _caused_by_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: a package whose import it stops may say something else."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def say(text: object, file: TextIO | None = None, end: str = "\n") -> None:
    """Print text, on stdout by default, without the control characters that a file or its name may have brought."""
    print("".join(c if c.isprintable() or c == "\n" else "?" for c in str(text)), file=file, end=end)


def _stopped(message: str, status: int) -> int:
    """Say why on one line of stderr, where there is one, and return the exit status."""
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        say(" ".join(message.split()), file=sys.stderr)
    return status
