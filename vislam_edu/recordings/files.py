"""Files as named arrays, read without running anything that they contain.

Arrays are read with `allow_pickle=False`. The one published layout that is a pickle is read by an unpickler
that knows numpy arrays and plain containers and nothing else (`unpickling`).
"""

from __future__ import annotations

import csv
import glob
import io
import os
import platform
import shutil
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from math import prod
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..drive import DriveError
from . import unpickling
from .unpickling import StoredArray

LARGEST = 3 << 29  # bytes of all arrays of a file together: dataset 10, the largest of the course, has 1.3e9
_NOT_RECORDINGS = {  # first bytes of files that are met in place of a recording
    b"MATLAB": "a MATLAB file; read it with scipy.io.loadmat and store its arrays with numpy.savez",
    b"\x89HDF": "an HDF5 or MATLAB 7.3 file; store its arrays with numpy.savez",
    b"version https://git-lfs": "a Git LFS pointer, not the recording itself; fetch that with: git lfs pull",
    b"<": "a web page (HTML or XML), not the recording itself; download the file behind it",
}
_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def shown(text: object, most: int = 200) -> str:
    """Text from a file as it may be printed: one line, no control characters, at most `most` characters."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= most else line[:most - 3] + "..."


def _kind(dtype: np.dtype) -> str:
    return "Python objects (store them with astype(float))" if dtype.hasobject else str(dtype)


class Fields:
    """The arrays of a file by key, each error naming the key. mapping : of keys to what is there or what finds it."""

    def __init__(self, mapping):
        self._mapping = mapping

    def __contains__(self, key):
        return key in self._mapping

    def key(self, *names):
        """The one of these names that the file has."""
        for name in names:
            if name in self._mapping:
                return name
        present = shown(", ".join(map(str, self._mapping)) or "nothing")
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
            raise DriveError(f"{name}: holds {_kind(value.dtype)}, expected an array of numbers")
        return value

    def empty(self, name):
        """Whether the file has nothing under this name: None, or a list or an array without an entry."""
        value = self._stored(name)
        return value is None or 0 in (value.shape if isinstance(value, StoredArray) else np.shape(value))

    def arrays(self, name):
        """A list of `StoredArray`s. Raises DriveError for anything else."""
        value = self._stored(self.key(name))
        if not isinstance(value, list) or not all(isinstance(item, StoredArray) for item in value):
            raise DriveError(f"{name}: expected a list of arrays")
        return value

    def pieces(self, name):
        """Shape of an array of numbers, and its numbers a piece at a time, the last index running fastest.

        None where it has to be read whole: it is in Fortran order, or holds something else.
        """
        value = self._stored(self.key(name))
        if not isinstance(value, StoredArray) or value.fortran or value.dtype.kind not in "fiu":
            return None
        return value.shape, _guarded(name, value.pieces())

    def number(self, name):
        """One number. Raises DriveError for several."""
        value = self.numbers(name)
        if value.size != 1:
            raise DriveError(f"{name}: shape {value.shape}, expected one number")
        return value.item()

    def _stored(self, name):
        with errors_name_field(name):
            value = self._mapping[name]
            return value() if isinstance(value, partial) else value

    def _read(self, name):
        value = self._stored(name)
        with errors_name_field(name):
            return value.read() if isinstance(value, StoredArray) else value


@contextmanager
def errors_name_field(name):
    """Puts the field's name in front of every error; whatever a damaged member raises becomes a DriveError."""
    try:
        yield
    except DriveError as error:
        raise DriveError(f"{name}: {error}") from None
    except Exception as error:
        raise DriveError(f"{name}: cannot be read ({error or type(error).__name__})") from None


def _guarded(name, pieces):
    with errors_name_field(name):
        yield from pieces


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


def open_regular(path: Path) -> BinaryIO:
    """The file, open to read bytes. Raises DriveError for a pipe or a device, which could deliver bytes for ever."""
    if not path.is_file() and path.exists() and not path.is_dir():
        raise DriveError("is not a regular file")
    return open(path, "rb")


@contextmanager
def open_fields(path):
    """`fields_of` a file that is open as long as the context lasts."""
    with open_regular(path) as file:
        yield fields_of(file)


def fields_of(file: BinaryIO) -> Fields:
    """The fields of an npz, of a .npy that holds a pickled dictionary, or of a bare pickle of one; read when used."""
    start = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
    file.seek(0)
    if start.startswith((b"\x93NUMPY", b"\x80")):
        return Fields(_pickled_dictionary(file, bare=start[:1] == b"\x80"))
    for first, what in _NOT_RECORDINGS.items():
        if start.startswith(first):
            raise DriveError(f"is {what}")
    try:
        return Fields(_members(zipfile.ZipFile(file)))
    except DriveError:
        raise
    except Exception:  # a damaged archive can raise anything
        raise DriveError("neither an npz nor a npy file, or cut short") from None


def _members(archive: zipfile.ZipFile) -> dict[str, Callable[[], StoredArray]]:
    """What finds each array of an npz, by key. Raises DriveError where all together are too large."""
    infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    size = sum(info.file_size for info in infos.values())
    if size > LARGEST:
        raise DriveError(f"its arrays take {size / 2**30:.1f} GB, more than the {LARGEST / 2**30:g} GB that a "
                         "recording may have")
    return {name: partial(_member, archive, info) for name, info in infos.items()}


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> StoredArray:
    """An array of an npz. What it claims to hold is checked before memory is taken for it."""
    with archive.open(info) as member:
        shape, fortran, dtype = npy_header(member)
        start = member.tell()
    if dtype.kind not in "fiubUS" or not 0 <= prod(shape) * dtype.itemsize <= info.file_size:
        raise DriveError(f"holds {_kind(dtype)} of shape {shape} in {info.file_size} bytes, expected an array of "
                         "numbers")

    def pieces() -> Iterator[np.ndarray]:
        with archive.open(info) as member:
            member.read(start)
            yield from unpickling.numbers(member, dtype, prod(shape))
    return StoredArray(shape, fortran, dtype, pieces)


def npy_header(file) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether in Fortran order, and dtype of an npy file, read from its start."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # headers of Python 2 warn
        return _READ_HEADER[np.lib.format.read_magic(file)](file)


def _pickled_dictionary(file, bare):
    try:
        shape, _, dtype = ((), False, np.dtype(object)) if bare else npy_header(file)
    except Exception:  # a damaged header can raise anything
        raise DriveError("its npy header cannot be read") from None
    if not dtype.hasobject:
        raise DriveError(f"holds an array of {dtype}, shape {shape}; expected a pickled dictionary of arrays")
    value = unpickling.load(file)
    if not isinstance(value, dict):
        raise DriveError(f"its pickle holds a {type(value).__name__}, expected a dictionary of arrays")
    return value


def part_of(folder: Path, name: str) -> Path:
    """Where this process may write what will be `name` in a folder; what dead processes left there is removed."""
    prefix = f".{name}.part-{platform.node()}-"
    for path in folder.glob(f"{glob.escape(prefix)}*"):
        number = path.name.removeprefix(prefix)
        if number.isdigit() and int(number) != os.getpid() and not _runs(int(number)):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return folder / f"{prefix}{os.getpid()}"


def _runs(process: int) -> bool:
    if os.name != "posix":  # Windows has no way of asking that is as harmless
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


@contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Make a folder, with its parents, for what the block writes; where making it or the block fails, what is empty
    of them goes again."""
    path = Path(os.path.realpath(path))  # or a folder that is left again by .. would be made
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with suppress(OSError):  # something else is there
            for folder in made:
                folder.rmdir()
        raise


@contextmanager
def replacing(path):
    """A binary file that takes the place of `path` when it is complete."""
    path = Path(path)
    part = part_of(path.parent, path.name)
    try:
        with open(part, "wb") as file:
            yield file
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """A text file, complete or not at all."""
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


def write_csv(path: Path, header: list[str], rows: Iterable[Iterable]) -> None:
    """A CSV file, complete or not at all; an apostrophe stands before what a spreadsheet would take for a formula."""
    with replacing(path) as binary, io.TextIOWrapper(binary, newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(header)
        out.writerows([_cell(value) for value in row] for row in rows)


def _cell(value):
    text = shown(value) if isinstance(value, str) else value
    return f"'{text}" if isinstance(text, str) and text.startswith(("=", "+", "-", "@")) else text
