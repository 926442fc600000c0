"""Files as named arrays, read without running anything that they contain.

Arrays are read with `allow_pickle=False`. The one published layout that is a pickle is read by an unpickler
that knows numpy arrays and plain containers and nothing else.
"""

from __future__ import annotations

import os
import pickle
import zipfile
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy._core.multiarray import _reconstruct, scalar

from ..drive import DriveError

_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# numpy moved its core from numpy.core to numpy._core in version 2; files of both exist
_ADMITTED = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy.core.multiarray", "scalar"): scalar,
    ("numpy._core.multiarray", "scalar"): scalar,
}


class Fields:
    """The arrays of a file by key, each error naming the key."""

    def __init__(self, mapping):
        self._mapping = mapping

    def __contains__(self, key):
        return key in self._mapping

    def key(self, *names):
        """The one of these names that the file has."""
        for name in names:
            if name in self._mapping:
                return name
        present = ", ".join(map(str, self._mapping)) or "nothing"
        raise DriveError(f"{' or '.join(names)}: missing; the file has {present}")

    def text(self, name):
        """What the file holds under this name, as plain Python: a string, or a list of them."""
        return np.asarray(self._read(self.key(name))).tolist()

    def numbers(self, name):
        """An array of numbers, any shape. Raises DriveError for anything else."""
        value = self._read(self.key(name))
        try:
            value = np.asarray(value)
        except ValueError as error:
            raise DriveError(f"{name}: {error}") from None
        if value.dtype.kind not in "fiu":
            raise DriveError(f"{name}: holds {value.dtype}, expected an array of numbers")
        return value

    def number(self, name):
        """One number. Raises DriveError for several."""
        value = self.numbers(name)
        if value.size != 1:
            raise DriveError(f"{name}: shape {value.shape}, expected one number")
        return value.item()

    def _read(self, name):
        try:
            return self._mapping[name]
        except (ValueError, EOFError, OSError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
            raise DriveError(f"{name}: cannot be read ({error})") from None


@contextmanager
def errors_name(path):
    """Puts the file's name in front of every DriveError; failures of the file system become one."""
    try:
        yield
    except DriveError as error:
        raise DriveError(f"{path}: {error}") from None
    except IsADirectoryError:
        raise DriveError(f"{path}: is a directory, expected a file") from None
    except FileNotFoundError:
        raise DriveError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise DriveError(f"{path}: not a text file") from None
    except OSError as error:
        raise DriveError(f"{path}: cannot be read ({error.strerror or error})") from None


@contextmanager
def open_fields(path):
    """The fields of an npz, or of a .npy that holds a pickled dictionary."""
    with open(path, "rb") as file:
        if file.peek(6)[:6] == b"\x93NUMPY":
            yield Fields(_pickled_dictionary(file))
            return
        try:
            npz = np.load(file, allow_pickle=False)
        except (ValueError, EOFError, zipfile.BadZipFile):
            raise DriveError("neither an npz nor a npy file, or cut short") from None
        with npz:
            yield Fields(npz)


def _pickled_dictionary(file):
    try:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = _READ_HEADER[version](file)
    except (KeyError, ValueError):
        raise DriveError("its npy header cannot be read") from None
    if not dtype.hasobject:
        raise DriveError(f"holds an array of {dtype}, shape {shape}; expected a pickled dictionary of arrays")
    try:
        value = _ArrayUnpickler(file).load()
    except DriveError:
        raise
    except Exception as error:  # a damaged pickle can raise anything
        raise DriveError(f"its pickle is damaged or cut short ({type(error).__name__}: {error})") from None
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    if not isinstance(value, dict):
        raise DriveError(f"its pickle holds a {type(value).__name__}, expected a dictionary of arrays")
    return value


class _ArrayUnpickler(pickle.Unpickler):
    """Unpickles numpy arrays and plain containers; any other name is refused before it is even imported."""

    def find_class(self, module, name):
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise DriveError(f"its pickle asks for {module}.{name}, which could run code; nothing of it was "
                             f"run, only numpy arrays in plain containers are read") from None


@contextmanager
def replacing(path):
    """A binary file that takes the place of `path` when it is complete."""
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            yield file
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
