"""Read numpy data out of a pickle without running anything that is in it.

FLAME is distributed as Python pickles with chumpy and scipy objects inside. Unpickling executes whatever the file names, so
this reader names everything it accepts: numpy arrays and scalars, scipy's compressed sparse matrices and chumpy's arrays,
each rebuilt by code of ours as a plain numpy array; neither scipy nor chumpy is needed. Any other global is refused and
named. Used by `flame`; needs numpy only.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import FileFormatError

MAX_ARRAY_BYTES = 4 << 30  # the largest FLAME array is 24 MB in double precision

_ARRAY_MODULES = ("numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
_SPARSE_CLASSES = {"csc_matrix", "csr_matrix", "coo_matrix", "csc_array", "csr_array", "coo_array"}


class _RebuiltArray:
    """Collects the state of a foreign array object; `to_numpy` turns it into an array."""

    def __init__(self, *_: Any) -> None:
        self.state: dict[Any, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = dict(state) if isinstance(state, dict) else {}

    def to_numpy(self) -> np.ndarray:
        raise FileFormatError("The model file holds an array of an unknown kind; get the file again from where it came from.")


class _ChumpyArray(_RebuiltArray):
    """`chumpy.Ch` and its subclasses keep their value under ``x``, or ``a`` and an index ``idxs`` (`Select`)."""

    def to_numpy(self) -> np.ndarray:
        if "x" in self.state:
            return np.asarray(plain(self.state["x"]))
        if "a" in self.state and "idxs" in self.state:
            values = np.asarray(plain(self.state["a"])).ravel()
            indices = np.asarray(plain(self.state["idxs"]))
            shape = self.state.get("preferred_shape")
            taken = values[indices]
            return taken.reshape(tuple(shape)) if shape is not None else taken
        raise FileFormatError("A chumpy object in the model file has no stored value; export the model as .npz instead.")


class _SparseMatrix(_RebuiltArray):
    """`scipy.sparse` matrices in compressed or coordinate form, made dense."""

    layout = "csc"

    def to_numpy(self) -> np.ndarray:
        shape = self.state.get("_shape", self.state.get("shape"))
        rows, columns = (int(n) for n in shape)
        data = np.asarray(plain(self.state["data"]))
        if rows < 0 or columns < 0 or rows * columns * 8 > MAX_ARRAY_BYTES:
            raise ValueError("sparse matrix size")
        dense = np.zeros((rows, columns), np.float64)
        if self.layout == "coo":
            coordinates = self.state.get("coords") or (self.state["row"], self.state["col"])
            np.add.at(dense, tuple(np.asarray(plain(c)).astype(np.int64) for c in coordinates), data)
            return dense
        indices = np.asarray(plain(self.state["indices"])).astype(np.int64)
        pointers = np.asarray(plain(self.state["indptr"])).astype(np.int64)
        major_count = columns if self.layout == "csc" else rows
        if pointers.shape != (major_count + 1,) or (np.diff(pointers) < 0).any():
            raise ValueError("sparse matrix pointers")
        major = np.repeat(np.arange(major_count), np.diff(pointers))
        where = (indices, major) if self.layout == "csc" else (major, indices)
        np.add.at(dense, where, data)
        return dense


def plain(value: Any, _done: dict[int, tuple[Any, Any]] | None = None) -> Any:
    """Replace rebuilt arrays by numpy arrays, recursively through dicts, lists and tuples.

    What occurs several times is converted once: a small stream can nest shared lists so that a naive walk never ends.
    """
    done = {} if _done is None else _done
    if id(value) in done:
        return done[id(value)][1]
    if isinstance(value, _RebuiltArray):
        result: Any = value.to_numpy()
    elif isinstance(value, dict):
        result = {key: plain(item, done) for key, item in value.items()}
    elif isinstance(value, (list, tuple)):
        result = type(value)(plain(item, done) for item in value)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        result = [plain(item, done) for item in value.ravel().tolist()]
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
        Plain Python containers, numbers, strings and numpy arrays.

    Raises:
        FileFormatError: Damaged, or it names anything that is not accepted; nothing of it has run.
    """
    _check_sizes(data, label)
    try:
        return plain(_Unpickler(data, label).load())
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
        for opcode, argument, position in pickletools.genops(data):
            if opcode.name in ("EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID"):
                raise FileFormatError(f"{label} uses the pickle feature {opcode.name}, which is refused; it is no FLAME file.")
            if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument) > position:
                raise FileFormatError(f"{label} is not a readable model file; get it again from where it came from.")
    except FileFormatError:
        raise
    except Exception as error:  # genops raises ValueError, IndexError, UnicodeDecodeError, OverflowError, struct.error ...
        raise FileFormatError(f"{label} is not a pickle or is truncated; get it again from where it came from.") from error


class _Unpickler(pickle.Unpickler):
    """Resolves a global to a builder of ours or refuses it."""

    def __init__(self, data: bytes, label: str) -> None:
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._label = label

    def find_class(self, module: str, name: str) -> Any:
        builder = _builder(module, name)
        if builder is None:
            raise FileFormatError(
                f"{self._label} asks to run {module}.{name}, which no head model needs; nothing of it ran."
            )
        return builder


def _builder(module: str, name: str) -> Callable[..., Any] | type | None:
    if module in _ARRAY_MODULES:
        return {"_reconstruct": _reconstruct_array, "ndarray": np.ndarray, "dtype": _dtype, "scalar": _scalar,
                "_frombuffer": _from_buffer}.get(name)  # fmt: skip
    if module == "_codecs" and name == "encode":
        return _encode
    if module in ("copy_reg", "copyreg") and name == "_reconstructor":
        return _reconstruct_object
    if module in ("__builtin__", "builtins") and name == "object":
        return object
    if module.partition(".")[0] == "chumpy":
        return type("_Chumpy", (_ChumpyArray,), {})
    if module.startswith("scipy.sparse") and name in _SPARSE_CLASSES:
        return type("_Sparse", (_SparseMatrix,), {"layout": name[:3]})
    return None


def _reconstruct_array(subtype: Any, shape: Any, _dtype_code: Any) -> np.ndarray:
    """Numpy pickles an empty array and fills it by __setstate__; a size here would only serve to exhaust memory."""
    if subtype is not np.ndarray or tuple(shape) != (0,):
        raise ValueError("array reconstruction")
    return np.ndarray((0,), np.uint8)


def _dtype(code: Any, *_: Any) -> np.dtype[Any]:
    if not isinstance(code, str) or len(code) > 8:
        raise ValueError("data type")
    return np.dtype(code)


def _scalar(dtype: Any, data: Any = b"") -> Any:
    raw = data.encode("latin1") if isinstance(data, str) else bytes(data)
    if not isinstance(dtype, np.dtype) or dtype.hasobject or len(raw) != dtype.itemsize:
        raise ValueError("scalar")
    return np.frombuffer(raw, dtype)[0]


def _from_buffer(buffer: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """Protocol 5 arrays."""
    if not isinstance(dtype, np.dtype) or dtype.hasobject or order not in ("C", "F"):
        raise ValueError("array buffer")
    return np.frombuffer(buffer, dtype).reshape(tuple(shape), order=order).copy()


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise ValueError("encoding")
    return text.encode("latin1")


def _reconstruct_object(cls: Any, base: Any, state: Any) -> Any:
    """`copy_reg._reconstructor` of protocols 0 and 1, for the classes above only."""
    if not (isinstance(cls, type) and issubclass(cls, _RebuiltArray)) or base is not object:
        raise ValueError("object reconstruction")
    return cls()
