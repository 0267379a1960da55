"""The glTF binary container: reading and writing `.glb`, accessors in and out.

Shared by the splat and the mesh side. Why not `trimesh` or `pygltflib`: stock Blender has numpy alone, trimesh's exporter
writes no named morph targets and neither knows the splat extension; what is needed of the container is one page. The tests
open our files with trimesh and with the Khronos validator. Needs numpy only.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..files.access import atomic_write, bad_file, read_bytes

KIND = "glTF file"
FLOAT, UINT32, UINT16, UINT8 = 5126, 5125, 5123, 5121
ARRAY_BUFFER, ELEMENT_BUFFER = 34962, 34963
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MAX_FILE_BYTES = 4 << 30
_MAX_ELEMENTS = 200_000_000
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_MAGIC = 0x46546C67


class GltfReader:
    """A parsed `.glb` or a `.gltf` with embedded buffers; every index and size is checked before use."""

    def __init__(self, path: Path, data: bytes | None = None, kind: str = KIND) -> None:
        self.path = path
        self.kind = kind
        data = read_bytes(path, _MAX_FILE_BYTES) if data is None else data
        self.binary: bytes | memoryview = b""
        text = self._split(data) if data[:4] == struct.pack("<I", _MAGIC) else data
        try:
            self.document = json.loads(bytes(text).decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise self.bad("it has no JSON") from error
        if not isinstance(self.document, dict):
            raise self.bad("its JSON is not an object")
        self._buffers: dict[int, Any] = {}

    def bad(self, reason: str) -> FileFormatError:
        """One sentence about this file."""
        return bad_file(self.path, self.kind, reason)

    def _split(self, data: bytes) -> memoryview:
        """JSON chunk; the binary chunk is kept."""
        if len(data) < 20:
            raise self.bad("it is truncated")
        _, version, length = struct.unpack_from("<III", data)
        if version != 2 or length > len(data):
            raise self.bad("it is of another version or truncated")
        view, offset, text = memoryview(data), 12, None
        while offset + 8 <= length:
            size, kind = struct.unpack_from("<II", data, offset)
            if size > length - offset - 8:
                raise self.bad("a chunk is longer than the file")
            if kind == _JSON and text is None:
                text = view[offset + 8 : offset + 8 + size]
            elif kind == _BIN and not self.binary:
                self.binary = view[offset + 8 : offset + 8 + size]
            offset += 8 + size + (-size % 4)
        if text is None:
            raise self.bad("it has no JSON")
        return text

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Entry `index` of the top-level list `kind` ("meshes", "accessors" ...)."""
        items = self.document.get(kind)
        if not isinstance(items, list) or type(index) is not int or not 0 <= index < len(items):
            raise self.bad(f"it refers to {kind} that it does not have")
        if not isinstance(items[index], dict):
            raise self.bad(f"an entry of {kind} is malformed")
        return items[index]

    def items(self, kind: str) -> list[dict[str, Any]]:
        """All entries of the top-level list `kind`, empty where there is none."""
        items = self.document.get(kind, [])
        if not isinstance(items, list):
            raise self.bad(f"its {kind} are malformed")
        return [self.item(kind, i) for i in range(len(items))]

    def integer(self, mapping: dict[str, Any], key: str, default: int | None = None) -> int:
        """A whole number that is not negative."""
        value = mapping.get(key, default)
        if type(value) is not int or not 0 <= value < 1 << 53:
            raise self.bad(f"{key} is {str(value)[:20]}")
        return value

    def accessor(self, index: Any) -> np.ndarray:
        """Values of an accessor, [count] or [count, width]: float32 where stored as floats or normalised, else integers."""
        entry = self.item("accessors", index)
        count = self.integer(entry, "count")
        code, width = entry.get("componentType"), _WIDTHS.get(str(entry.get("type")))
        if type(code) is not int or code not in _COMPONENTS or width is None or count > _MAX_ELEMENTS:
            raise self.bad("an accessor has an unknown type or an impossible count")
        dtype = np.dtype(_COMPONENTS[code])
        if "bufferView" in entry:
            values = self._view(entry, count, width, dtype)
        elif "sparse" in entry and count * width * dtype.itemsize <= _MAX_FILE_BYTES // 16:
            values = np.zeros((count, width), dtype)
        else:
            raise self.bad("an accessor has no data (it may be compressed by an extension, which is not read)")
        if "sparse" in entry:
            values = self._sparse(entry, values.copy(), count)
        if entry.get("normalized") and dtype.kind in "iu":
            values = np.maximum(values.astype(np.float32) / float(np.iinfo(dtype).max), -1.0)
        return values[:, 0] if width == 1 else values

    def _sparse(self, entry: dict[str, Any], values: np.ndarray, count: int) -> np.ndarray:
        sparse = entry["sparse"]
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(k), dict) for k in ("indices", "values")):
            raise self.bad("a sparse accessor is malformed")
        changed = self.integer(sparse, "count")
        code = sparse["indices"].get("componentType")
        if changed > count or type(code) is not int or code not in (UINT8, UINT16, UINT32):
            raise self.bad("a sparse accessor is malformed")
        rows = self._view(sparse["indices"], changed, 1, np.dtype(_COMPONENTS[code]))[:, 0].astype(np.int64)
        if (rows >= count).any():
            raise self.bad("a sparse accessor points outside")
        values[rows] = self._view(sparse["values"], changed, values.shape[1], values.dtype)
        return values

    def _view(self, entry: dict[str, Any], count: int, width: int, dtype: np.dtype[Any]) -> np.ndarray:
        """Strided rows [count, width] of a buffer view."""
        view = self.item("bufferViews", entry.get("bufferView"))
        if view.get("extensions"):
            raise self.bad("a buffer is compressed by an extension, which is not read")
        buffer = self._buffer(self.integer(view, "buffer"))
        start, length = self.integer(view, "byteOffset", 0), self.integer(view, "byteLength")
        offset = self.integer(entry, "byteOffset", 0)
        row = width * dtype.itemsize
        stride = self.integer(view, "byteStride", 0) or row
        needed = (count - 1) * stride + row if count else 0
        if start + length > len(buffer) or offset + needed > length or stride < row:
            raise self.bad("an accessor is longer than its data")
        if count == 0:
            return np.zeros((0, width), dtype)
        base = np.frombuffer(buffer, np.uint8, needed, start + offset)
        rows = np.lib.stride_tricks.as_strided(base, (count, row), (stride, 1))
        return np.ascontiguousarray(rows).view(dtype).reshape(count, width)

    def _buffer(self, index: int) -> Any:
        if index not in self._buffers:
            entry = self.item("buffers", index)
            uri = entry.get("uri")
            if uri is None:
                self._buffers[index] = self.binary
            elif isinstance(uri, str) and uri.startswith("data:") and ";base64," in uri[:100]:
                try:
                    self._buffers[index] = base64.b64decode(uri.split(",", 1)[1], validate=True)
                except (binascii.Error, ValueError) as error:
                    raise self.bad("a buffer is not base64") from error
            else:  # other files are not opened: a name from a data file could point anywhere
                raise self.bad("its data lies in another file; save it as one .glb")
        return self._buffers[index]


class GltfWriter:
    """Collects buffers and JSON and writes one `.glb`."""

    def __init__(self) -> None:
        self.document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "GRMM for Blender"}}
        self._chunks: list[bytes] = []
        self._size = 0

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append to a top-level list and return the index."""
        self.document.setdefault(kind, []).append(entry)
        return len(self.document[kind]) - 1

    def add_bytes(self, data: bytes, target: int | None = None) -> int:
        """Append raw bytes as a buffer view and return its index."""
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        padded = data + b"\0" * (-len(data) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return self.add("bufferViews", view)

    def add_array(self, array: np.ndarray, target: int | None = ARRAY_BUFFER, bounds: bool = False) -> int:
        """Append an array [N] or [N, width] of float32, uint32 or uint8 as an accessor and return its index."""
        array = np.asarray(array)
        code, dtype = (UINT32, "<u4") if array.dtype.kind in "iu" else (FLOAT, "<f4")
        if array.dtype == np.uint8:
            code, dtype = UINT8, "<u1"
        array = np.ascontiguousarray(array, dtype)
        width = 1 if array.ndim == 1 else array.shape[1]
        entry: dict[str, Any] = {
            "bufferView": self.add_bytes(array.tobytes(), target),
            "componentType": code,
            "count": int(array.shape[0]),
            "type": {count: name for name, count in _WIDTHS.items()}[width],
        }
        if bounds:
            rows = array.reshape(array.shape[0], width)
            entry["min"], entry["max"] = rows.min(0).astype(float).tolist(), rows.max(0).astype(float).tolist()
        return self.add("accessors", entry)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or not at all. Raises `FileAccessError`."""
        with atomic_write(path) as file:
            file.writelines(self.parts())

    def parts(self) -> Iterator[bytes]:
        """The bytes of the file, part by part."""
        self.document["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        yield struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + self._size)
        yield struct.pack("<II", len(text), _JSON) + text
        yield struct.pack("<II", self._size, _BIN)
        yield from self._chunks
