"""Named arrays out of `.npz` files that nobody vouches for.

Called by the readers of FLAME models, performances, avatars and capture data. `numpy.load` allocates what an array's header
claims before it looks at the data, so a 1 kB file can ask for terabytes; here the claim is first compared with the size that
the archive states, and that with a limit. Pickled objects are refused. Needs numpy only.
"""

from __future__ import annotations

import ast
import math
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .access import bad_file
from .archive import open_archive

MAX_ARRAY_BYTES = 1 << 30
_MAX_MEMBERS = 10_000
_MAX_HEADER = 1 << 16
_KIND = "npz file"


def read_npz(
    path: Path, names: Iterable[str] | None = None, max_bytes: int = MAX_ARRAY_BYTES
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Read arrays of a `.npz` file without running or over-allocating anything.

    Args:
        path: The file.
        names: Arrays to read; None reads all. Those that the file lacks are left out.
        max_bytes: Limit of all arrays together, unpacked.

    Returns:
        Arrays by name, and the names of all arrays in the file.

    Raises:
        FileFormatError: Not an npz file, truncated, lying about its sizes, or holding Python objects.
        FileAccessError: Missing or unreadable.
    """
    with open_archive(path, _KIND) as archive:
        entries = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        members = {info.filename.removesuffix(".npy"): info for info in entries}
        if len(entries) > _MAX_MEMBERS:
            raise bad_file(path, _KIND, f"it has {len(entries)} arrays")
        wanted = list(members) if names is None else [name for name in names if name in members]
        total = sum(members[name].file_size for name in wanted)
        if total > max_bytes:
            raise bad_file(path, _KIND, f"its arrays would take {total} bytes, more than the {max_bytes} that are read")
        return {name: _read_array(path, archive, members[name], name) for name in wanted}, tuple(members)


def _read_array(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> np.ndarray:
    with archive.open(info) as file:
        try:
            shape, fortran, dtype = _read_header(file)
        except (ValueError, TypeError, KeyError, SyntaxError, RecursionError, MemoryError) as error:
            raise bad_file(path, _KIND, f"the header of array {name[:60]!r} is damaged") from error
        if dtype.hasobject:
            raise bad_file(path, _KIND, f"array {name[:60]!r} holds Python objects, which are never loaded")
        size = math.prod(shape) * dtype.itemsize
        if size > info.file_size:
            raise bad_file(path, _KIND, f"array {name[:60]!r} claims {size} bytes and has {info.file_size}")
        data = bytearray(file.read(size))
    if len(data) != size:
        raise bad_file(path, _KIND, f"array {name[:60]!r} is truncated")
    array = np.frombuffer(data, dtype) if size else np.zeros(0, dtype)
    return array.reshape(shape[::-1]).transpose() if fortran else array.reshape(shape)


def _read_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and type of a `.npy` member. numpy's own reader tokenises hostile headers with errors of its own kinds."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0), (3, 0)):
        raise ValueError("unknown version")
    width = 2 if version == (1, 0) else 4
    length = int.from_bytes(file.read(width), "little")
    if length > _MAX_HEADER:
        raise ValueError("header length")
    header = ast.literal_eval(file.read(length).decode("utf-8"))
    shape, descr = header["shape"], header["descr"]
    if not isinstance(descr, str) or not isinstance(shape, tuple) or len(shape) > 16:
        raise ValueError("structured array")
    if any(type(n) is not int or n < 0 for n in shape):
        raise ValueError("shape")
    return shape, bool(header["fortran_order"]), np.dtype(descr)
