"""Tensor files in the safetensors format, read and written with numpy alone.

The format (8-byte header length, JSON header, raw little-endian data) is small enough that reading it ourselves costs less
than a dependency: stock Blender has numpy and nothing else, and hostile headers must give our typed errors. Files written
here open in the `safetensors` library and the other way round. Heads, weights and `.grmm` avatars all use this module.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, ShapeError
from .access import atomic_write, open_file

MAX_HEADER_BYTES = 64 << 20  # far above any file of ours; refuses lengths that lie
_LENGTH = struct.Struct("<Q")
_DTYPES: dict[str, np.dtype[Any]] = {
    "F64": np.dtype("<f8"),
    "F32": np.dtype("<f4"),
    "F16": np.dtype("<f2"),
    "I64": np.dtype("<i8"),
    "I32": np.dtype("<i4"),
    "I16": np.dtype("<i2"),
    "I8": np.dtype("i1"),
    "U64": np.dtype("<u8"),
    "U32": np.dtype("<u4"),
    "U16": np.dtype("<u2"),
    "U8": np.dtype("u1"),
    "BOOL": np.dtype("?"),
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def write_tensors(
    path: str | os.PathLike[str], tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Write named arrays and string metadata as one safetensors file, whole or not at all.

    Args:
        path: Target file.
        tensors: Name to array, any shape; 64/32/16-bit floats, integers or booleans.
        metadata: Strings stored under `__metadata__`; JSON inside them is the caller's.

    Raises:
        ShapeError: An array has a data type that the format cannot hold.
        FileAccessError: The file cannot be written.
    """
    header: dict[str, Any] = {}
    if metadata:
        header["__metadata__"] = dict(metadata)
    arrays: list[np.ndarray] = []
    offset = 0
    for name in sorted(tensors):
        # ascontiguousarray would turn a scalar into one element
        array = np.asarray(tensors[name], order="C")
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        if array.dtype not in _NAMES:
            raise ShapeError(f"Tensor {name!r} has data type {array.dtype}, which a tensor file cannot hold; convert it first.")
        header[name] = {
            "dtype": _NAMES[array.dtype],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + array.nbytes],
        }
        offset += array.nbytes
        arrays.append(array)
    encoded = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    encoded += b" " * (-len(encoded) % 8)
    with atomic_write(path) as file:
        file.write(_LENGTH.pack(len(encoded)))
        file.write(encoded)
        for array in arrays:
            file.write(array.tobytes())


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the string metadata without reading the data. Raises as `read_tensors`."""
    return _read(path, with_data=False)[1]


def read_tensors(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read a safetensors file.

    Returns:
        Arrays by name (writable, own memory) and the string metadata.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Not a safetensors file, truncated, or with a header that contradicts its data.
    """
    return _read(path, with_data=True)


def _read(path: str | os.PathLike[str], with_data: bool) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    path = Path(path)
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        header = _read_header(path, file.read(8), file, size)
        metadata = _read_string_map(path, header.pop("__metadata__", {}))
        start = file.tell()
        tensors: dict[str, np.ndarray] = {}
        for name, dtype, shape, begin, end in _entries(path, header, size - start):
            if with_data:
                file.seek(start + begin)
                raw = bytearray(file.read(end - begin))
                if len(raw) != end - begin:  # the file shrank while it was read
                    raise _corrupt(path, f"tensor {name!r} is truncated")
                tensors[name] = np.frombuffer(raw, dtype).reshape(shape)
        return tensors, metadata


def _read_header(path: Path, prefix: bytes, file: Any, size: int) -> dict[str, Any]:
    if len(prefix) < 8:
        raise _corrupt(path, "it is shorter than a header")
    (length,) = _LENGTH.unpack(prefix)
    if length < 2 or length > min(MAX_HEADER_BYTES, size - 8):
        raise _corrupt(path, "its header length does not fit the file")
    try:
        header = json.loads(file.read(length).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _corrupt(path, "its header is not JSON") from error
    if not isinstance(header, dict):
        raise _corrupt(path, "its header is not a JSON object")
    return header


def _read_string_map(path: Path, value: Any) -> dict[str, str]:
    if not isinstance(value, dict) or not all(isinstance(v, str) for v in value.values()):
        raise _corrupt(path, "its metadata is not a map of strings")
    return value


def _entries(path: Path, header: dict[str, Any], data_size: int) -> list[tuple[str, np.dtype[Any], tuple[int, ...], int, int]]:
    """Check every entry against the data, so that nothing is allocated on the word of a hostile header."""
    entries = []
    total = 0
    for name, entry in header.items():
        try:
            dtype = _DTYPES[entry["dtype"]]
            shape = tuple(entry["shape"])
            begin, end = entry["data_offsets"]
        except (KeyError, TypeError, ValueError) as error:
            raise _corrupt(path, f"the entry of tensor {name[:80]!r} is malformed") from error
        integers = (*shape, begin, end)
        if len(shape) > 16 or not all(type(i) is int and i >= 0 for i in integers):
            raise _corrupt(path, f"tensor {name[:80]!r} has an impossible shape")
        if not begin <= end <= data_size or math.prod(shape) * dtype.itemsize != end - begin:
            raise _corrupt(path, f"tensor {name[:80]!r} does not fit the file")
        total += end - begin
        entries.append((name, dtype, shape, begin, end))
    if total > data_size:
        raise _corrupt(path, "its tensors overlap")
    return entries


def _corrupt(path: Path, reason: str) -> FileFormatError:
    return FileFormatError(f"{path} is not a readable tensor file ({reason}); get the file again from where it came from.")
