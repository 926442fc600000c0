"""Reading a pickle of numpy arrays in plain containers without numpy, and without running anything that it asks for.

A pickle is a program. Here it may call three names, and each stands for a small class below: numpy itself never sees
the file's bytes before dtype, shape and size have been checked. Only opcodes that such a pickle needs are known.
"""

import io
import os
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from typing import Any, BinaryIO, ClassVar

import numpy as np

from ..drive import DriveError

_LONG = 1 << 16  # bytes; Python writes longer ones outside of a pickle's frames
PIECE = 1 << 20  # numbers read at a time
_OPCODES = b"".join([
    pickle.PROTO, pickle.FRAME, pickle.STOP, pickle.MARK, pickle.POP, pickle.POP_MARK, pickle.NONE, pickle.NEWTRUE,
    pickle.NEWFALSE, pickle.INT, pickle.BININT, pickle.BININT1, pickle.BININT2, pickle.LONG, pickle.LONG1, pickle.LONG4,
    pickle.FLOAT, pickle.BINFLOAT, pickle.STRING, pickle.BINSTRING, pickle.SHORT_BINSTRING, pickle.BINBYTES,
    pickle.SHORT_BINBYTES, pickle.BINBYTES8, pickle.UNICODE, pickle.BINUNICODE, pickle.SHORT_BINUNICODE,
    pickle.BINUNICODE8, pickle.TUPLE, pickle.EMPTY_TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3,
    pickle.EMPTY_LIST, pickle.LIST, pickle.APPEND, pickle.APPENDS, pickle.EMPTY_DICT, pickle.DICT, pickle.SETITEM,
    pickle.SETITEMS, pickle.PUT, pickle.BINPUT, pickle.LONG_BINPUT, pickle.MEMOIZE, pickle.GET, pickle.BINGET,
    pickle.LONG_BINGET, pickle.GLOBAL, pickle.STACK_GLOBAL, pickle.REDUCE, pickle.BUILD])


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array that stays in its file. pieces : reads its numbers in the order in which they are stored, (n,) each."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype
    pieces: Callable[[], Iterator[np.ndarray]]

    def read(self) -> np.ndarray:
        """The whole array. Raises DriveError where the file is cut short."""
        array, start = np.empty(prod(self.shape), self.dtype), 0
        for piece in self.pieces():
            array[start:start + len(piece)] = piece
            start += len(piece)
        return array.reshape(self.shape, order="F" if self.fortran else "C")


def numbers(file: Any, dtype: np.dtype, count: int) -> Iterator[np.ndarray]:
    """The next `count` numbers of an open file, a piece at a time. Raises DriveError where there are fewer."""
    while count:
        raw = file.read(min(count, PIECE) * dtype.itemsize)
        if not raw or len(raw) % dtype.itemsize:
            raise DriveError("is cut short")
        yield np.frombuffer(raw, dtype)
        count -= len(raw) // dtype.itemsize


class _Dtype:
    """Stands for `numpy.dtype`: kind, size and byte order of plain numbers or text, or O for an array of objects."""

    def __init__(self, code: str, *_: Any) -> None:
        if not (isinstance(code, str) and code[:1] in set("fiubUSOV") and code[1:].isdigit()) or code[0] == "V":
            raise DriveError(f"its pickle holds an array of {code!r}, expected numbers")
        self.code, self.order = code, "|"

    def __setstate__(self, state: tuple) -> None:
        _, self.order, *rest = state
        if self.order not in ("<", ">", "|", "=") or any(part for part in rest[:3] if part is not None):
            raise DriveError("its pickle describes an array of records, expected numbers")


class _Array:
    """Stands for `numpy.ndarray`: what the file says of an array."""

    state: tuple

    def __setstate__(self, state: tuple) -> None:
        self.state = state

    def stored(self) -> StoredArray | list:
        """The array, or the list of its objects. Raises DriveError where shape, type and bytes do not fit."""
        _, shape, dtype, fortran, data = self.state
        if not isinstance(dtype, _Dtype):
            raise DriveError("its pickle holds an array without a type")
        if dtype.code[0] == "O":
            return data if isinstance(data, list) else []
        kind = np.dtype(dtype.order.replace("|", "=") + dtype.code)
        raw = data.encode("latin1") if isinstance(data, str) else data  # as Python 2 wrote it
        raw = _InFile(io.BytesIO(raw), 0, len(raw)) if isinstance(raw, bytes) else raw
        if (not all(isinstance(n, int) and n >= 0 for n in shape) or not isinstance(raw, _InFile)
                or raw.size != prod(shape) * kind.itemsize):
            raise DriveError(f"its pickle holds an array of shape {shape} whose bytes do not fit")

        def pieces() -> Iterator[np.ndarray]:
            raw.file.seek(raw.start)
            return numbers(raw.file, kind, prod(shape))
        return StoredArray(shape, fortran, kind, pieces)


@dataclass(frozen=True)
class _InFile:
    """Bytes that stay in the file until they are asked for."""

    file: BinaryIO
    start: int
    size: int


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _scalar(dtype: _Dtype, raw: Any) -> Any:
    array = _Array()
    array.state = (1, (), dtype, False, raw)
    return _plain(array)


# numpy moved its core from numpy.core to numpy._core in version 2; files of both exist
_ADMITTED: dict[tuple[str, str], Any] = {("numpy", "ndarray"): _Array, ("numpy", "dtype"): _Dtype} | {
    (f"numpy.{core}.multiarray", name): stand_in
    for core in ("core", "_core") for name, stand_in in (("_reconstruct", _reconstruct), ("scalar", _scalar))}


_build = pickle._Unpickler.dispatch[pickle.BUILD[0]]


class _Unpickler(pickle._Unpickler):
    """The pure Python unpickler, whose memo is a dictionary: an index of 2^30 in a file costs one entry, not 8 GB.

    Long bytes stay in the file: ten thousand images, or the course's largest array, take no memory.
    """

    dispatch: ClassVar[Any] = {code: work for code, work in pickle._Unpickler.dispatch.items()
                               if code in _OPCODES}

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="latin1")
        self.file, self.end = file, os.fstat(file.fileno()).st_size
        self._file_read = self._read_what_is_there  # `file.read(n)` takes n bytes of memory, however short the file is

    def _read_what_is_there(self, size: int) -> bytes:
        return self.file.read(min(size, self.end - self.file.tell()))

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise DriveError(f"its pickle asks for {module}.{name}, which could run code; nothing of it was "
                             f"run, only numpy arrays in plain containers are read") from None

    def load_build(self) -> None:
        if not isinstance(vars(self)["stack"][-2], _Array | _Dtype):
            raise DriveError("its pickle changes something that is no array; nothing of it was run")
        _build(self)  # type: ignore[arg-type]

    def load_binbytes(self) -> None:
        self._long_bytes(int.from_bytes(self.read(4), "little"))  # type: ignore[attr-defined]

    def load_binbytes8(self) -> None:
        self._long_bytes(int.from_bytes(self.read(8), "little"))  # type: ignore[attr-defined]

    def _long_bytes(self, size: int) -> None:
        if size < _LONG or vars(self)["_unframer"].current_frame is not None:
            self.append(self.read(size))  # type: ignore[attr-defined]
            return
        start = self.file.tell()
        if start + size > self.end:
            raise EOFError("bytes end before they should")
        self.file.seek(size, 1)
        self.append(_InFile(self.file, start, size))  # type: ignore[attr-defined]

    dispatch[pickle.BUILD[0]] = load_build
    dispatch[pickle.BINBYTES[0]] = load_binbytes
    dispatch[pickle.BINBYTES8[0]] = load_binbytes8


def load(file: BinaryIO) -> Any:
    """What the pickle holds, numbers as `StoredArray`s, which the file must stay open for. Raises DriveError."""
    try:
        value = _plain(_Unpickler(file).load())
        if not isinstance(value, dict):
            return value
        made = {key: _plain(item) for key, item in value.items()}
        return {key: list(map(_plain, item)) if isinstance(item, list) else item for key, item in made.items()}
    except DriveError:
        raise
    except Exception as error:  # a damaged pickle can raise anything
        raise DriveError(f"its pickle is damaged or cut short ({type(error).__name__}: {error})") from None


def _plain(value: Any) -> Any:
    """What stands in the pickle for an array made into it; an array of one object is that object."""
    while isinstance(value, _Array):
        value = value.stored()
        if isinstance(value, list) and len(value) == 1:
            value = value[0]
    return value
