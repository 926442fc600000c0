"""What an answer may leave behind: functions of numpy or of this package that it has rebound, output, memory.

A check must judge the next answer as if the last one had never run.
"""

import builtins
import contextlib
import io
import math
import sys
import types
from collections.abc import Iterator
from unittest import mock

import numpy as np
import scipy.linalg

_OUTPUT = 2000  # characters that an answer may print in one check
_MEMORY = 4 * 2**30  # bytes that an answer may take
_THE_KERNELS = {"input", "display", "get_ipython", "exit", "quit"}  # builtins that a notebook's kernel sets itself
_CALLABLE = (types.FunctionType, types.BuiltinFunctionType, type, np.ufunc, property)


def _owners() -> Iterator[tuple[str, object]]:
    """Modules and classes whose functions a check relies on."""
    yield from (("builtins", builtins), ("math", math), ("np", np), ("np.linalg", np.linalg),
                ("scipy.linalg", scipy.linalg))
    for name, module in list(sys.modules.items()):
        if name.startswith("vislam_edu") and isinstance(module, types.ModuleType):
            yield name.removeprefix("vislam_edu."), module
            for key, value in list(vars(module).items()):
                if isinstance(value, type) and value.__module__ == name:
                    yield f"{name.removeprefix('vislam_edu.')}.{key}", value


_originals: dict[tuple[int, str], tuple[str, object, object]] = {}


def remember() -> None:
    """Note every function of the modules that are loaded now and not noted yet."""
    for name, owner in _owners():
        for key, value in list(vars(owner).items()):
            if (isinstance(value, _CALLABLE) or callable(value)) and not (owner is builtins and key in _THE_KERNELS):
                _originals.setdefault((id(owner), key), (f"{name}.{key}", owner, value))


def restored() -> list[str]:
    """Put back what was rebound or deleted since; returns the names, in order."""
    changed = []
    for (_, key), (name, owner, value) in _originals.items():
        if vars(owner).get(key) is not value:
            setattr(owner, key, value)
            changed.append(name)
    return sorted(changed)


class _Capped(io.TextIOBase):
    """Passes text on until there is too much of it."""

    def __init__(self, target):
        self.target, self.left = target, _OUTPUT

    def write(self, text):
        if self.left > 0:
            self.target.write(text[:self.left])
            if len(text) >= self.left:
                self.target.write("\n(the rest of what your function prints is left out)\n")
        self.left -= len(text)
        return len(text)

    def flush(self):
        self.target.flush()


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Output capped, nothing to type in, and memory limited where the system can."""
    with contextlib.redirect_stdout(_Capped(sys.stdout)), mock.patch("builtins.input", _no_input), _limited_memory():
        yield


def _no_input(*_):
    raise RuntimeError("input() waits for somebody who types, and in a check there is nobody: all that the function "
                       "needs comes as its arguments")


@contextlib.contextmanager
def _limited_memory() -> Iterator[None]:
    """At most _MEMORY more than now: then MemoryError, before the system ends the kernel. Only on Linux."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    before = soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = used + _MEMORY if soft == resource.RLIM_INFINITY else min(used + _MEMORY, soft)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
