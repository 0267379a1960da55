"""SOG files: splats as lossless WebP pictures with a `meta.json`, zipped (`.sog`) or in a folder.

Version 2. One pixel is one splat: positions in 16 bits after a symmetric logarithm, scales and colors as indices to tables of
256 values, the three smallest components of quaternions in 8 bits with the fourth byte naming the largest, opacity as alpha;
higher harmonics as indices to a palette of coefficient rows. y is down, as in the PLY files that these are made from.

Pillow reads WebP outside of Blender (its decoder is the reference one), Blender's own image loader inside; `webp` writes it.
There is no Python library for the format itself. Higher harmonics are read but not written.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BackendError
from ...files.access import atomic_write, bad_file, read_bytes
from ...files.archive import member, read_members, read_neighbour
from ...files.format import Format
from .cloud import MAX_SPLATS, SplatCloud, check_expansion, exp_scale, finish_reading, log_scale, lost_harmonics
from .splat_file import to_byte
from .webp import encode_webp

Decoder = Callable[[bytes], np.ndarray]

KIND = "SOG file"
_LIMIT = 1 << 30
_META_LIMIT = 16 << 20
_MAX_PIXELS = 4 * MAX_SPLATS
_MODE_BASE = 252  # the fourth byte of a quaternion is this plus the index of its largest component
_ROOT_2 = 2.0**0.5
_PALETTE_COLUMNS = 64
_TABLE = 256
_KMEANS_ROUNDS = 8
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # components stored for each largest one, of w, x, y, z


def read_sog(path: Path, axes: str = "file", decode: Decoder | None = None) -> SplatCloud:
    """Read a `.sog` archive or a `meta.json` beside its pictures.

    Args:
        path: The file.
        axes: "file" turns y up, "y_up" keeps the numbers.
        decode: Decodes a picture to RGBA bytes [height, width, 4], top row first, where Pillow is not installed.

    Raises:
        FileFormatError: Damaged, of another version, or pictures that do not fit the description.
        BackendError: Neither Pillow nor `decode` is there.
        FileAccessError: Missing or unreadable.
    """
    if decode is None:
        _pillow(path)
    if path.suffix.lower() == ".json":
        contents: dict[str, bytes] | None = None
        text = read_bytes(path, _META_LIMIT)
    else:
        contents = read_members(path, KIND, _LIMIT)
        text = member(path, KIND, contents, "meta.json")
    meta = _Meta(path, text, contents, decode)
    count = meta.integer("count", 1, MAX_SPLATS)
    size = len(text) + sum(map(len, contents.values())) if contents is not None else _LIMIT
    check_expansion(path, KIND, count, 16 if "shN" in meta.document else 1, size)
    cloud = SplatCloud(
        _read_means(meta, count),
        _read_quats(meta, count),
        exp_scale(meta.table("scales")[meta.pixels("scales", 0, count)[:, :3]]),
        meta.pixels("sh0", 0, count)[:, 3].astype(np.float32) / 255.0,
        _read_harmonics(meta, count),
        antialiased=meta.document.get("antialias") is True,
    )
    cloud = finish_reading(path, KIND, cloud)
    return cloud if axes == "y_up" else cloud.flipped()


class _Meta:
    """The parsed `meta.json` with checked access to its tables and pictures."""

    def __init__(self, path: Path, text: bytes, contents: dict[str, bytes] | None, decode: Decoder | None) -> None:
        self.path, self.contents, self.decode = path, contents, decode
        self._pictures: dict[str, np.ndarray] = {}
        try:
            self.document = json.loads(text.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise bad_file(path, KIND, "its meta.json is not JSON") from error
        if not isinstance(self.document, dict) or self.document.get("version") != 2:
            raise bad_file(path, KIND, "its meta.json is not of version 2")

    def part(self, name: str) -> dict[str, Any]:
        """An object of the document."""
        part = self.document.get(name)
        if not isinstance(part, dict):
            raise bad_file(self.path, KIND, f"its meta.json has no {name}")
        return part

    def integer(self, name: str, low: int, high: int, part: str | None = None) -> int:
        """A whole number in a range."""
        value = (self.part(part) if part else self.document).get(name)
        if type(value) is not int or not low <= value <= high:
            raise bad_file(self.path, KIND, f"its {name} is {str(value)[:20]}, and {low} to {high} is read")
        return value

    def numbers(self, part: str, name: str, count: int) -> np.ndarray:
        """A list of finite numbers, [count] float64."""
        values = self.part(part).get(name)
        if not isinstance(values, list) or len(values) != count or not all(type(v) in (int, float) for v in values):
            raise bad_file(self.path, KIND, f"its {part}.{name} is not {count} numbers")
        try:
            array = np.array(values, np.float64)
        except OverflowError as error:
            raise bad_file(self.path, KIND, f"its {part}.{name} is not {count} numbers") from error
        if not np.isfinite(array).all():
            raise bad_file(self.path, KIND, f"its {part}.{name} is not {count} finite numbers")
        return array

    def table(self, part: str) -> np.ndarray:
        """The table of 256 values of a part, float32."""
        with np.errstate(over="ignore"):  # what becomes infinite is dropped later
            return self.numbers(part, "codebook", _TABLE).astype(np.float32)

    def picture(self, part: str, index: int) -> np.ndarray:
        """A picture as RGBA bytes, [height, width, 4]."""
        files = self.part(part).get("files")
        if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
            raise bad_file(self.path, KIND, f"its meta.json names no file for {part}")
        name = files[index]
        if name not in self._pictures:
            if self.contents is None:
                data = read_neighbour(self.path, KIND, name, _LIMIT)
            else:
                data = member(self.path, KIND, self.contents, name)
            pixels = self.decode(data) if self.decode else _decode(self.path, name, data)
            if pixels.ndim != 3 or pixels.shape[2] != 4 or pixels.dtype != np.uint8:
                raise bad_file(self.path, KIND, f"its picture {name[:60]!r} is not of bytes with four channels")
            self._pictures[name] = pixels
        return self._pictures[name]

    def pixels(self, part: str, index: int, count: int) -> np.ndarray:
        """The first `count` pixels of a picture, [count, 4] uint8."""
        pixels = self.picture(part, index).reshape(-1, 4)
        if pixels.shape[0] < count:
            raise bad_file(self.path, KIND, f"it has {count} splats and {pixels.shape[0]} pixels of {part}")
        return pixels[:count]


def _pillow(path: Path) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise BackendError(
            f"{path} is a SOG file, which needs the Python package Pillow; install it or save a .ply."
        ) from error
    return Image


def _decode(path: Path, name: str, data: bytes) -> np.ndarray:
    """WebP or PNG bytes to RGBA; the size is checked before anything is decoded."""
    image_module = _pillow(path)
    try:
        with image_module.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
            if image.width * image.height > _MAX_PIXELS:
                raise bad_file(path, KIND, f"its picture {name[:60]!r} has {image.width} x {image.height} pixels")
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, EOFError, image_module.DecompressionBombError) as error:
        raise bad_file(path, KIND, f"its picture {name[:60]!r} is damaged") from error


def _read_means(meta: _Meta, count: int) -> np.ndarray:
    low, high = meta.numbers("means", "mins", 3), meta.numbers("means", "maxs", 3)
    fine, coarse = (meta.pixels("means", i, count)[:, :3].astype(np.float64) for i in range(2))
    with np.errstate(over="ignore", invalid="ignore"):
        values = low + (high - low) * ((fine + 256.0 * coarse) / 65535.0)
        return (np.sign(values) * np.expm1(np.abs(values))).astype(np.float32)


def _read_quats(meta: _Meta, count: int) -> np.ndarray:
    pixels = meta.pixels("quats", 0, count)
    largest = pixels[:, 3].astype(np.int64) - _MODE_BASE
    if (largest < 0).any():
        raise bad_file(meta.path, KIND, "its quaternions name no largest component")
    small = (pixels[:, :3].astype(np.float32) / 255.0 - 0.5) * _ROOT_2
    quats = np.zeros((count, 4), np.float32)
    rows = np.arange(count)
    for k in range(3):
        quats[rows, _OTHERS[largest, k]] = small[:, k]
    quats[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - (small * small).sum(1)))
    return quats


def _read_harmonics(meta: _Meta, count: int) -> np.ndarray:
    base = meta.table("sh0")[meta.pixels("sh0", 0, count)[:, :3]][:, None, :]
    if "shN" not in meta.document:
        return base
    bands = meta.integer("bands", 1, 3, "shN")
    terms = (bands + 1) ** 2 - 1
    entries = meta.integer("count", 1, 1 << 16, "shN")
    palette = meta.picture("shN", 0)
    if palette.shape[1] != _PALETTE_COLUMNS * terms or palette.shape[0] * _PALETTE_COLUMNS < entries:
        raise bad_file(meta.path, KIND, "its palette of harmonics has another size than stated")
    rows = palette[:, :, :3].reshape(-1, terms, 3)[:entries]
    labels = meta.pixels("shN", 1, count)
    index = labels[:, 0].astype(np.int64) + 256 * labels[:, 1].astype(np.int64)
    if (index >= entries).any():
        raise bad_file(meta.path, KIND, "its splats refer to harmonics outside the palette")
    return np.concatenate([base, meta.table("shN")[rows][index]], 1)


def write_sog(path: str | os.PathLike[str], cloud: SplatCloud, axes: str = "file") -> list[str]:
    """Write a `.sog` archive of degree 0.

    Args:
        path: Target file.
        cloud: Splats, y up; higher harmonics are left out.
        axes: "file" turns y down, "y_up" keeps the numbers.

    Raises:
        ShapeError: The cloud is malformed.
        FileAccessError: The file cannot be written.
    """
    cloud = cloud.validated()
    cloud = cloud if axes == "y_up" else cloud.flipped()
    width = 4 * max(1, int(np.ceil((cloud.count / 16) ** 0.5)))
    logs = np.sign(cloud.means) * np.log1p(np.abs(cloud.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / np.maximum(high - low, 1e-12) * 65535.0).astype(np.int64)
    scale_table, scale_index = _quantise(log_scale(cloud.scales))
    color_table, color_index = _quantise(cloud.sh[:, 0])
    quats = cloud.quats
    largest = np.abs(quats).argmax(1)
    rows = np.arange(cloud.count)
    quats = quats * np.where(quats[rows, largest] < 0, -1.0, 1.0)[:, None]
    small = np.stack([quats[rows, _OTHERS[largest, k]] for k in range(3)], 1)
    opaque = np.full((cloud.count, 1), 255, np.uint8)
    alpha = to_byte(cloud.opacities * 255.0)[:, None]
    pictures = {
        "means_l.webp": np.concatenate([(steps & 255).astype(np.uint8), opaque], 1),
        "means_u.webp": np.concatenate([(steps >> 8).astype(np.uint8), opaque], 1),
        "scales.webp": np.concatenate([scale_index, opaque], 1),
        "quats.webp": np.concatenate(
            [to_byte((small / _ROOT_2 + 0.5) * 255.0), (largest[:, None] + _MODE_BASE).astype(np.uint8)], 1
        ),
        "sh0.webp": np.concatenate([color_index, alpha], 1),
    }
    meta = {
        "version": 2,
        "asset": {"generator": "GRMM for Blender"},
        "count": cloud.count,
        "antialias": cloud.antialiased,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_table.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_table.tolist(), "files": ["sh0.webp"]},
    }
    with atomic_write(path) as file, zipfile.ZipFile(file, "w") as archive:  # WebP is compressed already
        archive.writestr("meta.json", json.dumps(meta))
        for name, pixels in pictures.items():
            archive.writestr(name, _encode(pixels, width))
    return lost_harmonics(cloud)


def _encode(pixels: np.ndarray, width: int) -> bytes:
    """A lossless picture of pixels [N, 4], filled up to whole rows."""
    height = -(-pixels.shape[0] // width)
    canvas = np.zeros((height * width, 4), np.uint8)
    canvas[: pixels.shape[0]] = pixels
    return encode_webp(canvas.reshape(height, width, 4))


def _quantise(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The best 256 values for numbers [N, 3] by Lloyd's algorithm, ascending, and their indices [N, 3] uint8."""
    flat = np.sort(values.reshape(-1).astype(np.float64))
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    # Half of the start values by share and half evenly, so that the sparse ends are not left out.
    shares = flat[np.linspace(0, flat.size - 1, _TABLE // 2).astype(np.int64)]
    table = np.sort(np.concatenate([shares, np.linspace(flat[0], flat[-1], _TABLE - shares.size)]))
    for _ in range(_KMEANS_ROUNDS):
        edges = np.concatenate([[0], np.searchsorted(flat, (table[:-1] + table[1:]) / 2), [flat.size]])
        size = np.diff(edges)
        table = np.where(size > 0, np.diff(sums[edges]) / np.maximum(size, 1), table)
        table = np.sort(table)
    index = np.searchsorted((table[:-1] + table[1:]) / 2, values.reshape(-1)).astype(np.uint8)
    return table, index.reshape(values.shape)


FORMAT = Format(
    "sog", "SOG (.sog)", "Compressed pictures, as PlayCanvas uses", "splats", (".sog",), read_sog, write_sog,
    file_names=("meta.json",), needs={"PIL": "reading outside of Blender"},
)  # fmt: skip
