"""Reading a pickle of numpy arrays in plain containers without numpy, and without running anything that it asks for.

A pickle is a program. Here it may call three names, and each stands for a small class below: numpy itself never sees
the file's bytes before dtype, shape and size have been checked. Only opcodes that such a pickle needs are known.
"""

import pickle
from collections.abc import Callable
from math import prod
from typing import Any, BinaryIO, ClassVar

import numpy as np

from ..drive import DriveError

_LONG = 1 << 16  # bytes; Python writes longer ones outside of a pickle's frames
_OPCODES = b"".join([
    pickle.PROTO, pickle.FRAME, pickle.STOP, pickle.MARK, pickle.POP, pickle.POP_MARK, pickle.NONE, pickle.NEWTRUE,
    pickle.NEWFALSE, pickle.INT, pickle.BININT, pickle.BININT1, pickle.BININT2, pickle.LONG, pickle.LONG1, pickle.LONG4,
    pickle.FLOAT, pickle.BINFLOAT, pickle.STRING, pickle.BINSTRING, pickle.SHORT_BINSTRING, pickle.BINBYTES,
    pickle.SHORT_BINBYTES, pickle.BINBYTES8, pickle.UNICODE, pickle.BINUNICODE, pickle.SHORT_BINUNICODE,
    pickle.BINUNICODE8, pickle.TUPLE, pickle.EMPTY_TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3,
    pickle.EMPTY_LIST, pickle.LIST, pickle.APPEND, pickle.APPENDS, pickle.EMPTY_DICT, pickle.DICT, pickle.SETITEM,
    pickle.SETITEMS, pickle.PUT, pickle.BINPUT, pickle.LONG_BINPUT, pickle.MEMOIZE, pickle.GET, pickle.BINGET,
    pickle.LONG_BINGET, pickle.GLOBAL, pickle.STACK_GLOBAL, pickle.REDUCE, pickle.BUILD])


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
    """Stands for `numpy.ndarray`: what the file says of an array, made into one by `to_numpy`."""

    state: tuple

    def __setstate__(self, state: tuple) -> None:
        self.state = state

    def to_numpy(self) -> Any:
        """The array, or the list of its objects. Raises DriveError where shape, type and bytes do not fit."""
        _, shape, dtype, fortran, data = self.state
        if not isinstance(dtype, _Dtype):
            raise DriveError("its pickle holds an array without a type")
        if dtype.code[0] == "O":
            return data if isinstance(data, list) else []
        kind = np.dtype(dtype.order.replace("|", "=") + dtype.code)
        size = prod(shape) * kind.itemsize
        raw = data.encode("latin1") if isinstance(data, str) else data  # as Python 2 wrote it
        raw = raw.read() if isinstance(raw, _Stored) else raw
        if not all(isinstance(n, int) and n >= 0 for n in shape) or not isinstance(raw, bytes) or len(raw) != size:
            raise DriveError(f"its pickle holds an array of shape {shape} whose bytes do not fit")
        return np.frombuffer(raw, kind).reshape(shape, order="F" if fortran else "C")


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _scalar(dtype: _Dtype, raw: Any) -> Any:
    array = _Array()
    array.state = (1, (), dtype, False, raw)
    return array.to_numpy()


# numpy moved its core from numpy.core to numpy._core in version 2; files of both exist
_ADMITTED: dict[tuple[str, str], Any] = {("numpy", "ndarray"): _Array, ("numpy", "dtype"): _Dtype} | {
    (f"numpy.{core}.multiarray", name): stand_in
    for core in ("core", "_core") for name, stand_in in (("_reconstruct", _reconstruct), ("scalar", _scalar))}


_build = pickle._Unpickler.dispatch[pickle.BUILD[0]]


class _Unpickler(pickle._Unpickler):
    """The pure Python unpickler, whose memo is a dictionary: an index of 2^30 in a file costs one entry, not 8 GB."""

    dispatch: ClassVar[Any] = {code: work for code, work in pickle._Unpickler.dispatch.items()
                               if code in _OPCODES}

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

    dispatch[pickle.BUILD[0]] = load_build


class _Stored:
    """Bytes that stay in the file until they are read."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.file, self.start, self.size = file, file.tell(), size
        file.seek(size, 1)

    def read(self) -> bytes:
        """The bytes, fewer where the file is cut short."""
        self.file.seek(self.start)
        return self.file.read(self.size)


class _Lazy(_Unpickler):
    """Leaves long bytes in the file: a list of ten thousand images takes no memory."""

    dispatch: ClassVar[Any] = dict(_Unpickler.dispatch)

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, encoding="latin1")
        self.file = file

    def _long_bytes(self, size: int) -> None:
        in_a_frame = vars(self)["_unframer"].current_frame is not None
        short = in_a_frame or size < _LONG
        self.append(self.read(size) if short else _Stored(self.file, size))  # type: ignore[attr-defined]

    def load_binbytes(self) -> None:
        self._long_bytes(int.from_bytes(self.read(4), "little"))  # type: ignore[attr-defined]

    def load_binbytes8(self) -> None:
        self._long_bytes(int.from_bytes(self.read(8), "little"))  # type: ignore[attr-defined]

    dispatch[pickle.BINBYTES[0]] = load_binbytes
    dispatch[pickle.BINBYTES8[0]] = load_binbytes8


def load_lists(file: BinaryIO, *keys: str) -> list[list[Callable[[], np.ndarray]]]:
    """Lists of arrays of a pickled dictionary, each array a function that reads it. Raises DriveError."""
    try:
        value = _Lazy(file).load()
        value = value.to_numpy() if isinstance(value, _Array) else value
        value = value[0] if isinstance(value, list) and len(value) == 1 else value
        lists = [value[key].to_numpy() if isinstance(value[key], _Array) else value[key] for key in keys]
        return [[one.to_numpy for one in items] for items in lists]
    except DriveError:
        raise
    except Exception as error:
        raise DriveError(f"expected a pickled dictionary with lists of arrays {' and '.join(keys)} "
                         f"({type(error).__name__}: {error})") from None


def load(file: BinaryIO) -> Any:
    """What the pickle holds, arrays made. Raises DriveError."""
    try:
        return _plain(_Unpickler(file, encoding="latin1").load())
    except DriveError:
        raise
    except Exception as error:  # a damaged pickle can raise anything
        raise DriveError(f"its pickle is damaged or cut short ({type(error).__name__}: {error})") from None


def _plain(value: Any) -> Any:
    """The value with its arrays made: an array of one object is that object, a dictionary that of its values."""
    if isinstance(value, _Array):
        array = value.to_numpy()
        return _plain(array[0]) if isinstance(array, list) and len(array) == 1 else array
    if isinstance(value, dict):
        return {key: _plain(item) if isinstance(item, _Array) else item for key, item in value.items()}
    return value
