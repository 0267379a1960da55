"""Read numpy data out of a pickle without running anything that is in it.

FLAME is distributed as Python pickles with chumpy and scipy objects inside. Unpickling executes whatever the file names, so
this reader names everything it accepts: numpy arrays, data types and scalars, sets, scipy's compressed sparse matrices and
chumpy's arrays. Each is rebuilt by code of ours; neither scipy nor chumpy is needed, and not even numpy's own unpickling
runs, which trusts what a file says of sizes. Any other global is refused and named. Used by `flame`; needs numpy only.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import numpy as np

from ..errors import FileFormatError

MAX_SPARSE_BYTES = 64 << 20  # made dense; FLAME's joint regressor takes 200 kB

_ARRAY_MODULES = ("numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
_BUILTINS = ("__builtin__", "builtins")
_SPARSE_CLASSES = {"csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "csr_array", "coo_array"}
_DTYPE_CODE = re.compile(r"[<>=|]?(?:b1|[iu][1248]|f[248]|[SU]\d{1,4}|O8?)\Z")
_MAX_DIMENSIONS = 8
_OPCODES = {opcode.code: opcode for opcode in pickletools.opcodes}
_Done = dict[int, tuple[Any, Any]]  # id of an object to the object and what it became


class _Accepted:
    """A global that a stream may name, and call. It has no attributes that the stream could set."""

    __slots__ = ("_function",)
    _function: Callable[..., Any]

    def __init__(self, function: Callable[..., Any]) -> None:
        object.__setattr__(self, "_function", function)

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise AttributeError(name)

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)


class _Rebuilt:
    """Collects the state of a foreign object; `to_plain` turns it into plain data once the whole stream is read."""

    def __init__(self, *_: Any) -> None:
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def to_plain(self, done: _Done) -> Any:
        raise ValueError("an object of an unknown kind")


class _DataType(_Rebuilt):
    """`numpy.dtype` of numbers, fixed-length text or objects."""

    def __init__(self, code: Any = None, *_: Any) -> None:
        if not isinstance(code, str) or not _DTYPE_CODE.match(code):
            raise ValueError("data type")
        self.code = code
        self.state = None

    def to_plain(self, done: _Done) -> np.dtype[Any]:
        dtype = np.dtype(object if "O" in self.code else self.code)
        if self.state is None:
            return dtype
        order = self.state[1]
        if order not in ("<", ">", "=", "|"):
            raise ValueError("byte order")
        return dtype.newbyteorder(order)


class _NumpyArray(_Rebuilt):
    """`numpy.ndarray`: version, shape, data type, order, data."""

    def to_plain(self, done: _Done) -> Any:
        shape, dtype, fortran, data = self.state[-4:]
        if not isinstance(dtype, _DataType):
            raise ValueError("data type")
        dtype = dtype.to_plain(done)
        if dtype.hasobject:
            if not isinstance(data, list):
                raise ValueError("array of objects")
            return plain(data, done)
        raw = data.encode("latin1") if isinstance(data, str) else data
        if not isinstance(raw, (bytes, bytearray)):
            raise ValueError("array data")
        shape = (shape,) if isinstance(shape, int) else tuple(shape)
        if len(shape) > _MAX_DIMENSIONS or any(type(n) is not int or n < 0 for n in shape):
            raise ValueError("array shape")
        if math.prod(shape) * dtype.itemsize != len(raw):
            raise ValueError("array size")
        return np.frombuffer(raw, dtype).reshape(shape, order="F" if fortran else "C")


class _ChumpyArray(_Rebuilt):
    """`chumpy.Ch` and its subclasses keep their value under ``x``, or ``a`` and an index ``idxs`` (`Select`)."""

    def to_plain(self, done: _Done) -> np.ndarray:
        state = self.state if isinstance(self.state, dict) else {}
        if "x" in state:
            return _array_of(state["x"], done)
        if "a" in state and "idxs" in state:
            taken = _array_of(state["a"], done).ravel()[_array_of(state["idxs"], done)]
            shape = plain(state.get("preferred_shape"), done)
            return taken if shape is None else taken.reshape(tuple(shape))
        raise FileFormatError("A chumpy object in the model file has no stored value; export the model as .npz instead.")


class _SparseMatrix(_Rebuilt):
    """`scipy.sparse` matrices in compressed or coordinate form, made dense."""

    layout = "csc"

    def to_plain(self, done: _Done) -> np.ndarray:
        state = self.state
        rows, columns = (int(n) for n in state.get("_shape", state.get("shape")))
        data = _array_of(state["data"], done)
        if rows < 0 or columns < 0 or rows * columns * 8 > MAX_SPARSE_BYTES:
            raise ValueError("sparse matrix size")
        dense = np.zeros((rows, columns), np.float64)
        if self.layout == "coo":
            coordinates = state.get("coords") or (state["row"], state["col"])
            row, column = (_array_of(c, done).astype(np.int64) for c in coordinates)
            np.add.at(dense, (row, column), data)
            return dense
        indices = _array_of(state["indices"], done).astype(np.int64)
        pointers = _array_of(state["indptr"], done).astype(np.int64)
        major_count = columns if self.layout == "csc" else rows
        if pointers.shape != (major_count + 1,) or (np.diff(pointers) < 0).any() or pointers[-1] != len(indices):
            raise ValueError("sparse matrix pointers")
        major = np.repeat(np.arange(major_count), np.diff(pointers))
        where = (indices, major) if self.layout == "csc" else (major, indices)
        np.add.at(dense, where, data)
        return dense


def _array_of(value: Any, done: _Done) -> np.ndarray:
    """An array or number of the stream. Lists are refused: nested ones could grow without bound."""
    result = plain(value, done)
    if not isinstance(result, (np.ndarray, int, float)):
        raise ValueError("no array")
    return np.asarray(result)


def plain(value: Any, done: _Done) -> Any:
    """Replace rebuilt objects by plain data, recursively through dicts, lists and tuples.

    What occurs several times is converted once: a small stream can nest shared lists so that a naive walk never ends.
    """
    if id(value) in done:
        return done[id(value)][1]
    if isinstance(value, _Rebuilt):
        result: Any = value.to_plain(done)
    elif isinstance(value, dict):
        result = {key: plain(item, done) for key, item in value.items()}
    elif isinstance(value, (list, tuple)):
        result = type(value)(plain(item, done) for item in value)
    else:
        return value
    done[id(value)] = (value, result)  # the original is kept alive, so that its id stays its own
    return result


def load_restricted(data: bytes, label: str) -> Any:
    """Unpickle `data` with the accepted globals only.

    Args:
        data: The file's bytes; protocols 0 to 5, strings of Python 2 read as latin-1.
        label: What the data is called in messages (the file name).

    Returns:
        Plain Python containers, numbers, strings and numpy arrays (read-only).

    Raises:
        FileFormatError: Damaged, or it names anything that is not accepted; nothing of it has run.
    """
    _check_sizes(data, label)
    try:
        return plain(_Unpickler(data, label).load(), {})
    except FileFormatError:
        raise
    except MemoryError as error:
        raise FileFormatError(f"{label} asks for more memory than there is; it is damaged or not a model file.") from error
    # A hostile stream can make the unpickler raise nearly any exception class; none of them is a defect of ours.
    except Exception as error:
        raise FileFormatError(f"{label} is not a readable model file; get it again from where it came from.") from error


def _check_sizes(data: bytes, label: str) -> None:
    """Walk the opcodes without executing them and refuse memo indices that would make the unpickler allocate without bound."""
    try:
        for name, argument, position in _opcodes(data):
            if name in ("EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID"):
                raise FileFormatError(f"{label} uses the pickle feature {name}, which is refused; it is no FLAME file.")
            if name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument) > position:
                raise FileFormatError(f"{label} is not a readable model file; get it again from where it came from.")
    except FileFormatError:
        raise
    except Exception as error:  # pickletools raises ValueError, IndexError, UnicodeDecodeError, OverflowError, struct.error ...
        raise FileFormatError(f"{label} is not a pickle or is truncated; get it again from where it came from.") from error


def _opcodes(data: bytes) -> Iterator[tuple[str, Any, int]]:
    """Name, argument and position of each opcode.

    `pickletools.genops` does the same, but takes Python 2's strings for ASCII, and arrays are stored as such strings.
    """
    stream = io.BytesIO(data)
    name = ""
    while name != "STOP":
        position = stream.tell()
        opcode = _OPCODES[stream.read(1).decode("latin-1")]
        name = opcode.name
        if name == "STRING":
            if not stream.readline().endswith(b"\n"):
                raise ValueError("truncated")
            yield name, None, position
        else:
            yield name, opcode.arg.reader(stream) if opcode.arg else None, position


class _Unpickler(pickle.Unpickler):
    """Resolves a global to a builder of ours or refuses it."""

    def __init__(self, data: bytes, label: str) -> None:
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._label = label

    def find_class(self, module: str, name: str) -> Any:
        builder = _builder(module, name)
        if builder is None:
            raise FileFormatError(f"{self._label} asks to run {module}.{name}, which no head model needs; nothing of it ran.")
        return builder


def _builder(module: str, name: str) -> _Accepted | type | None:
    if module in _ARRAY_MODULES:
        return _ARRAY_GLOBALS.get(name)
    if module == "_codecs" and name == "encode":
        return _ENCODE
    if module in ("copy_reg", "copyreg") and name == "_reconstructor":
        return _RECONSTRUCTOR
    if module in _BUILTINS:
        return {"object": _OBJECT, "set": _SET, "frozenset": _SET}.get(name)
    # a class of its own for each mention: what a stream does to it ends with the stream
    if module.partition(".")[0] == "chumpy":
        return type("_Chumpy", (_ChumpyArray,), {})
    if module.startswith("scipy.sparse") and name in _SPARSE_CLASSES:
        return type("_Sparse", (_SparseMatrix,), {"layout": name[:3]})
    return None


def _refuse(*_: Any) -> NoReturn:
    raise ValueError("a class that may only be named")


def _reconstruct_array(subtype: Any, shape: Any, _code: Any) -> _NumpyArray:
    """Numpy pickles an empty array and fills it by __setstate__; a size here would only serve to exhaust memory."""
    if subtype is not _NDARRAY or tuple(shape) != (0,):
        raise ValueError("array reconstruction")
    return _NumpyArray()


def _from_buffer(buffer: Any, dtype: Any, shape: Any, order: Any) -> _NumpyArray:
    """Protocol 5 arrays."""
    if not isinstance(dtype, _DataType) or order not in ("C", "F"):
        raise ValueError("array buffer")
    array = _NumpyArray()
    array.state = (shape, dtype, order == "F", buffer)
    return array


def _scalar(dtype: Any, data: Any = b"") -> Any:
    """A numpy scalar as Python's number or text."""
    array = _NumpyArray()
    array.state = ((), dtype, False, data)
    return array.to_plain({}).item()


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise ValueError("encoding")
    return text.encode("latin1")


def _set(items: Any = ()) -> set[Any]:
    if not isinstance(items, (list, tuple)):
        raise ValueError("set")
    return set(items)


def _reconstruct_object(cls: Any, base: Any, _state: Any) -> Any:
    """`copy_reg._reconstructor` of protocols 0 and 1, for the classes above only."""
    if not (isinstance(cls, type) and issubclass(cls, _Rebuilt)) or base is not _OBJECT:
        raise ValueError("object reconstruction")
    return cls()


_NDARRAY = _Accepted(_refuse)
_OBJECT = _Accepted(_refuse)
_ENCODE = _Accepted(_encode)
_SET = _Accepted(_set)
_RECONSTRUCTOR = _Accepted(_reconstruct_object)
_ARRAY_GLOBALS = {
    "ndarray": _NDARRAY, "_reconstruct": _Accepted(_reconstruct_array), "dtype": _Accepted(_DataType),
    "scalar": _Accepted(_scalar), "_frombuffer": _Accepted(_from_buffer),
}  # fmt: skip
