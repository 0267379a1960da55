"""PlayCanvas's compressed PLY (`.compressed.ply`): four packed words a splat and the ranges of every 256 of them.

Positions and logarithms of scale take 11, 10 and 11 bits between the bounds of their chunk, rotations two bits for the largest
component and ten for each of the others, colors and opacity a byte each (older files without bounds for colors); an optional
element has harmonics of a byte each, -4 to 4. y is down, as in other PLY files. Read only. Needs numpy only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...files.access import bad_file
from ...files.format import Format
from .cloud import MAX_SPLATS, SH_C0, SplatCloud, exp_scale, finish_reading
from .ply import read_elements, read_layout

KIND = "compressed PLY"
_CHUNK = 256
_AXES, _SCALES, _COLORS = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
_PACKED = tuple(f"packed_{name}" for name in ("position", "rotation", "scale", "color"))
_ROOT_2 = 2.0**0.5
_SH_RANGE = 8.0
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # stored components for each largest one, of w, x, y, z


def read_compressed_ply(path: Path, axes: str = "file") -> SplatCloud:
    """Read a compressed PLY.

    Args:
        path: The file.
        axes: "file" turns y up, "y_up" keeps the numbers.

    Raises:
        FileFormatError: Damaged, or its elements do not fit each other.
        FileAccessError: Missing or unreadable.
    """
    elements = read_elements(path, KIND).elements
    chunks, rows = elements.get("chunk"), elements.get("vertex")
    if chunks is None or rows is None or not set(_PACKED) <= set(rows.dtype.names or ()):
        raise bad_file(path, KIND, "it has no chunks or no packed columns")
    count = len(rows)
    if not 1 <= count <= MAX_SPLATS or len(chunks) != -(-count // _CHUNK):
        raise bad_file(path, KIND, f"it has {len(chunks)} chunks for {count} splats")
    if any(rows.dtype[name] != np.uint32 for name in _PACKED):
        raise bad_file(path, KIND, "its packed columns are no words of 32 bits")
    position, rotation, scale, color = (rows[name] for name in _PACKED)
    rgb = np.stack([_field(color, shift, 8) for shift in (24, 16, 8)], 1)
    has_bounds = "min_r" in (chunks.dtype.names or ())
    base = _between(path, chunks, _COLORS, rgb) if has_bounds else rgb
    cloud = SplatCloud(
        _between(path, chunks, _AXES, _unpack(position)),
        _rotations(rotation),
        exp_scale(_between(path, chunks, _SCALES, _unpack(scale))),
        _field(color, 0, 8),
        _harmonics(path, elements.get("sh"), (base - 0.5) / SH_C0),
    )
    cloud = finish_reading(path, KIND, cloud)
    return cloud if axes == "y_up" else cloud.flipped()


def _field(words: np.ndarray, shift: int, bits: int) -> np.ndarray:
    """Bits of words as numbers from 0 to 1, [N] float32."""
    top = (1 << bits) - 1
    return ((words >> np.uint32(shift)) & np.uint32(top)).astype(np.float32) / np.float32(top)


def _unpack(words: np.ndarray) -> np.ndarray:
    return np.stack([_field(words, 21, 11), _field(words, 11, 10), _field(words, 0, 11)], 1)


def _between(path: Path, chunks: np.ndarray, names: tuple[str, ...], shares: np.ndarray) -> np.ndarray:
    """Values between the bounds of each splat's chunk, [N, 3]."""
    known = set(chunks.dtype.names or ())
    if not {f"{end}_{name}" for end in ("min", "max") for name in names} <= known:
        raise bad_file(path, KIND, f"its chunks have no bounds of {names[0]}")
    with np.errstate(invalid="ignore"):
        low, high = (np.stack([chunks[f"{end}_{name}"].astype(np.float32) for name in names], 1) for end in ("min", "max"))
        index = np.arange(len(shares)) // _CHUNK
        return low[index] * (1.0 - shares) + high[index] * shares


def _rotations(words: np.ndarray) -> np.ndarray:
    """Quaternions wxyz, [N, 4] float32."""
    small = (np.stack([_field(words, shift, 10) for shift in (20, 10, 0)], 1) - 0.5) * np.float32(_ROOT_2)
    largest = (words >> np.uint32(30)).astype(np.int64)
    quats = np.zeros((len(words), 4), np.float32)
    np.put_along_axis(quats, _OTHERS[largest], small, 1)
    rest = np.sqrt(np.maximum(0.0, 1.0 - (small * small).sum(1)))
    np.put_along_axis(quats, largest[:, None], rest[:, None], 1)
    return quats


def _harmonics(path: Path, rows: np.ndarray | None, base: np.ndarray) -> np.ndarray:
    """Harmonics [N, K, 3] of the constant ones and the optional element, which is channel-major."""
    if rows is None:
        return base[:, None, :].astype(np.float32)
    terms = len(rows.dtype.names or ()) // 3
    names = [f"f_rest_{k}" for k in range(3 * terms)]
    if terms not in (3, 8, 15) or set(names) != set(rows.dtype.names or ()) or len(rows) != len(base):
        raise bad_file(path, KIND, "its harmonics fit no degree")
    bytes_ = np.stack([rows[name] for name in names], 1).astype(np.float32)  # [N, 3 K]
    shares = np.where(bytes_ == 0, 0.0, np.where(bytes_ == 255, 1.0, (bytes_ + 0.5) / 256.0))
    rest = ((shares - 0.5) * _SH_RANGE).reshape(len(rows), 3, terms).transpose(0, 2, 1)
    return np.concatenate([base[:, None, :], rest], 1).astype(np.float32)


FORMAT = Format(
    "compressed-ply", "Compressed PLY (.ply)", "PlayCanvas's packed PLY", "splats", (), read_compressed_ply,
    recognises=lambda path, start: "packed_position" in read_layout(path).get("vertex", ()), shared_suffixes=(".ply",),
)  # fmt: skip
