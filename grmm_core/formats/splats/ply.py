"""PLY files: the container, and 3DGS splats in it.

`read_elements` returns every element of a binary or text PLY as a structured array and is shared with the CAP4D reader;
`read_ply` and `write_ply` are the 3DGS layout, with `binding_0` also GaussianAvatars'.

Why not the library `plyfile`: it is well kept and reads these files, but stock Blender has numpy alone, and a header that
claims more rows than the file has must be refused before anything is allocated. The tests open our files with it. Needs numpy
only.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np

from ...files.access import atomic_write, bad_file, open_file
from ...files.format import Format
from .cloud import MAX_DEGREE, SplatCloud, exp_scale, finish_reading, log_scale, logit, sigmoid

KIND = "PLY file"
_MAX_HEADER = 4 << 20  # CAP4D files have three elements for every frame
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_Y_DOWN_COMMENT = "axes: x right, y down, z forward"
_Y_UP_COMMENT = "axes: x right, y up, z backward"
_WRITE_CHUNK = 1 << 16
_NEEDED = ("x", "y", "z", "opacity", *(f"{a}_{i}" for a in ("f_dc", "scale", "rot") for i in range(3)), "rot_3")


@dataclass
class PlyFile:
    """Elements by name in file order, each a structured array [rows], and the comments of the header."""

    elements: dict[str, np.ndarray]
    comments: list[str]


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str | None]]  # name, type, type of the list's length or None

    @property
    def has_lists(self) -> bool:
        return any(length is not None for _, _, length in self.properties)


def read_elements(path: Path, kind: str = KIND, data: bytes | None = None) -> PlyFile:
    """Read all elements of a PLY file.

    Lists are read where all of an element have the same length (triangles), as fields of shape [length].

    Args:
        path: The file, or the archive that `data` came from.
        kind: What the file was taken for, for messages.
        data: The file's bytes where they were read elsewhere.

    Raises:
        FileFormatError: Damaged, truncated, or a header that does not fit the file.
        FileAccessError: Missing or unreadable.
    """
    if data is not None:
        return _read_file(path, kind, io.BytesIO(data), len(data))
    with open_file(path) as file:
        return _read_file(path, kind, file, os.fstat(file.fileno()).st_size)


def _read_file(path: Path, kind: str, file: BufferedIOBase, size: int) -> PlyFile:
    order, elements, comments = _read_header(path, kind, file)
    if order == "=":
        return PlyFile(_read_text(path, kind, file, elements), comments)
    arrays = {}
    for element in elements:
        dtype = _element_dtype(path, kind, file, element, order)
        if element.count * dtype.itemsize > size - file.tell():
            raise bad_file(path, kind, f"its header claims {element.count} rows of {element.name!r}, more than it has")
        rows = np.empty(element.count, dtype)
        if file.readinto(rows.view(np.uint8).data) != rows.nbytes:
            raise bad_file(path, kind, "it is truncated")
        arrays[element.name] = _check_lists(path, kind, element, rows)
    return PlyFile(arrays, comments)


def read_layout(path: Path) -> dict[str, tuple[str, ...]]:
    """Names of the elements and their properties in the header of a PLY file. Raises as `read_elements`."""
    with open_file(path) as file:
        return {element.name: tuple(row[0] for row in element.properties) for element in _read_header(path, KIND, file)[1]}


def _read_header(path: Path, kind: str, file: BufferedIOBase) -> tuple[str, list[_Element], list[str]]:
    if file.readline(16).strip() != b"ply":
        raise bad_file(path, kind, "it does not start with 'ply'")
    order: str | None = None
    elements: list[_Element] = []
    comments: list[str] = []
    while True:
        line = file.readline(_MAX_HEADER)
        if not line or file.tell() > _MAX_HEADER:
            raise bad_file(path, kind, "its header has no end")
        words = line.decode("ascii", "replace").split()
        if words == ["end_header"]:
            break
        keyword = words[0] if words else "comment"
        if keyword in ("comment", "obj_info"):
            comments.append(" ".join(words[1:]))
        elif keyword == "format" and len(words) == 3 and words[1] in _FORMATS:
            order = _FORMATS[words[1]]
        elif keyword == "element" and len(words) == 3 and words[2].isdecimal() and len(words[2]) < 14:
            elements.append(_Element(words[1], int(words[2]), []))
        elif keyword == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            elements[-1].properties.append((words[2], _TYPES[words[1]], None))
        elif keyword == "property" and elements and len(words) == 5 and words[1] == "list" and set(words[2:4]) <= set(_TYPES):
            elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
        else:
            raise bad_file(path, kind, f"its header has the line {line[:60].decode('ascii', 'replace').strip()!r}")
    names = [element.name for element in elements]
    if order is None or len(set(names)) != len(names):
        raise bad_file(path, kind, "its header states no format or an element twice")
    for element in elements:
        fields = [name for name, _, _ in element.properties]
        if not fields or len(set(fields)) != len(fields):
            raise bad_file(path, kind, f"its element {element.name!r} is malformed")
    return order, elements, comments


def _element_dtype(path: Path, kind: str, file: BufferedIOBase, element: _Element, order: str) -> np.dtype[Any]:
    """Row type; the length of a list is taken from the first row and checked for the others afterwards."""
    fields: list[tuple[Any, ...]] = []
    start = file.tell()
    for name, code, length_code in element.properties:
        if length_code is None:
            fields.append((name, order + code))
            continue
        length_type = np.dtype(order + length_code)
        offset = np.dtype(fields).itemsize if fields else 0
        file.seek(start + offset)
        raw = file.read(length_type.itemsize)
        file.seek(start)
        length = int(np.frombuffer(raw, length_type)[0]) if len(raw) == length_type.itemsize and element.count else 0
        if length_type.kind == "f" or not 0 <= length <= 256:
            raise bad_file(path, kind, f"its list {name!r} has {length} entries")
        fields += [(f"{name}#", order + length_code), (name, order + code, (length,))]
    return np.dtype(fields)


def _check_lists(path: Path, kind: str, element: _Element, rows: np.ndarray) -> np.ndarray:
    for name, _, length in element.properties:
        if length is not None and (rows[f"{name}#"] != rows[name].shape[1]).any():
            raise bad_file(path, kind, f"its list {name!r} mixes lengths, which is not read")
    return rows


def _read_text(path: Path, kind: str, file: BufferedIOBase, elements: list[_Element]) -> dict[str, np.ndarray]:
    arrays = {}
    for element in elements:
        if element.has_lists:
            for _ in range(element.count):
                if not file.readline():
                    raise bad_file(path, kind, "it is truncated")
            continue
        width = len(element.properties)
        dtype = np.dtype([(name, code) for name, code, _ in element.properties])
        lines: list[np.ndarray] = []
        for _ in range(element.count):
            line = file.readline(1 << 16)
            if not line:
                raise bad_file(path, kind, f"its header claims {element.count} rows of {element.name!r}, more than it has")
            try:
                values = [float(word) for word in line.split()]
            except ValueError as error:
                raise bad_file(path, kind, f"a row of {element.name!r} is not numbers") from error
            if len(values) != width:
                raise bad_file(path, kind, f"a row of {element.name!r} has {len(values)} values and not {width}")
            lines.append(np.array(values))
        rows = np.zeros(element.count, dtype)
        table = np.array(lines).reshape(element.count, width)
        with np.errstate(invalid="ignore", over="ignore"):
            for column, (name, _, _) in enumerate(element.properties):
                rows[name] = table[:, column]
        arrays[element.name] = rows
    return arrays


def columns(rows: np.ndarray, names: list[str]) -> np.ndarray:
    """Scalar fields as one float32 array [rows, len(names)]; a view where they are neighbouring floats."""
    fields = rows.dtype.fields or {}
    offsets = [fields[name][1] for name in names]
    neighbours = rows.shape[0] > 0 and offsets == list(range(offsets[0], offsets[0] + 4 * len(names), 4))
    if neighbours and all(fields[name][0] == np.dtype("<f4") for name in names):
        return np.ndarray((rows.shape[0], len(names)), np.float32, rows, offsets[0], (rows.strides[0], 4))
    result = np.empty((rows.shape[0], len(names)), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for i, name in enumerate(names):
            result[:, i] = rows[name]
    return result


def read_ply(path: Path, axes: str = "file") -> SplatCloud:
    """Read a 3DGS or GaussianAvatars PLY.

    Args:
        path: The file.
        axes: "file": y down as 3DGS captures have it, unless the file's comment says otherwise; splats bound to triangles are
            never turned. "y_up" or "y_down" over this.

    Raises:
        FileFormatError: Not a splat PLY, or damaged.
        FileAccessError: Missing or unreadable.
    """
    file = read_elements(path)
    if "vertex" not in file.elements:
        raise bad_file(path, KIND, "it has no element 'vertex'")
    cloud = splats_from_rows(path, file.elements["vertex"])
    y_up = axes == "y_up" or (axes == "file" and (cloud.binding is not None or _Y_UP_COMMENT in file.comments))
    return cloud if y_up else cloud.flipped()


def splats_from_rows(path: Path, rows: np.ndarray, kind: str = "splat PLY") -> SplatCloud:
    """Splats of the element `vertex`: x y z, f_dc, f_rest, opacity, scale, rot and optionally binding. Raises as `read_ply`."""
    names = set(rows.dtype.names or ())
    missing = [name for name in _NEEDED if name not in names]
    if missing:
        raise bad_file(path, kind, f"it has no column {missing[0]!r}, so it is a point cloud or mesh and not 3DGS splats")
    if any(rows.dtype[name].subdtype is not None for name in names):
        raise bad_file(path, kind, "a column is a list")
    sh, warnings = _harmonics(path, kind, rows, names)
    binding = None
    binding_name = next((name for name in ("binding_0", "binding") if name in names), None)
    if binding_name:
        with np.errstate(invalid="ignore"):  # a signalling NaN
            values = rows[binding_name].astype(np.float64)
        if not ((values >= 0) & (values < 1 << 31) & (values == np.floor(values))).all():
            raise bad_file(path, kind, "its binding is not a triangle number for every splat")
        binding = values.astype(np.int32)
    cloud = SplatCloud(
        columns(rows, ["x", "y", "z"]).copy(),
        columns(rows, [f"rot_{i}" for i in range(4)]),
        exp_scale(columns(rows, [f"scale_{i}" for i in range(3)])),
        sigmoid(columns(rows, ["opacity"])[:, 0]),
        sh,
        binding,
        warnings=warnings,
    )
    return finish_reading(path, kind, cloud)


def _harmonics(path: Path, kind: str, rows: np.ndarray, names: set[str]) -> tuple[np.ndarray, list[str]]:
    """Spherical harmonics [N, K, 3] out of f_dc and the channel-major f_rest; degrees above 3 are cut off."""
    rest = sum(1 for name in names if re.fullmatch(r"f_rest_\d+", name))
    per_channel = rest // 3
    degree = round((per_channel + 1) ** 0.5) - 1
    if rest != 3 * ((degree + 1) ** 2 - 1) or any(f"f_rest_{i}" not in names for i in range(rest)):
        raise bad_file(path, kind, f"{rest} columns f_rest fit no degree of spherical harmonics")
    kept = (min(degree, MAX_DEGREE) + 1) ** 2
    sh = np.empty((rows.shape[0], kept, 3), np.float32)
    sh[:, 0] = columns(rows, [f"f_dc_{channel}" for channel in range(3)])
    for channel in range(3) if kept > 1 else ():
        first = channel * per_channel
        sh[:, 1:, channel] = columns(rows, [f"f_rest_{first + k}" for k in range(kept - 1)])
    if degree > MAX_DEGREE:
        return sh, [f"Spherical harmonics of degree {degree} were cut to degree {MAX_DEGREE}."]
    return sh, []


def write_ply(path: str | os.PathLike[str], cloud: SplatCloud, axes: str = "file") -> None:
    """Write a 3DGS PLY, binary little endian, all columns float32; with `binding` GaussianAvatars' `binding_0` is added.

    Args:
        path: Target file.
        cloud: Splats, y up.
        axes: "file": y down as 3DGS viewers expect it, except for splats bound to triangles. "y_up" or "y_down" over this.

    Raises:
        ShapeError: The cloud is malformed.
        FileAccessError: The file cannot be written.
    """
    cloud = cloud.validated()
    y_down = axes == "y_down" or (axes == "file" and cloud.binding is None)
    comment = "" if cloud.binding is not None else f"comment {_Y_DOWN_COMMENT if y_down else _Y_UP_COMMENT}\n"
    with atomic_write(path) as file:
        file.writelines(ply_parts(cloud.flipped() if y_down else cloud, comment))


def ply_parts(cloud: SplatCloud, comment: str = "") -> Iterator[bytes]:
    """The bytes of a 3DGS PLY, part by part: the cloud's numbers as they are, behind a header with a line of comment."""
    rest = cloud.sh.shape[1] - 1
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(3 * rest)]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    names += ["binding_0"] if cloud.binding is not None else []
    header = f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {cloud.count}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    yield header.encode("ascii")
    for start in range(0, cloud.count, _WRITE_CHUNK):
        part = cloud.select(slice(start, start + _WRITE_CHUNK))
        rows = np.zeros((part.count, len(names)), "<f4")
        rows[:, 0:3] = part.means
        rows[:, 6:9] = part.sh[:, 0]
        rows[:, 9 : 9 + 3 * rest] = part.sh[:, 1:].transpose(0, 2, 1).reshape(part.count, -1)
        at = 9 + 3 * rest
        rows[:, at] = logit(part.opacities)
        rows[:, at + 1 : at + 4] = log_scale(part.scales)
        rows[:, at + 4 : at + 8] = part.quats
        if part.binding is not None:
            rows[:, at + 8] = part.binding
        yield rows.tobytes()


FORMAT = Format(
    "ply", "3DGS (.ply)", "Uncompressed, as written by 3D Gaussian Splatting; read by nearly every splat program", "splats",
    (".ply",), read_ply, write_ply,
)  # fmt: skip
