"""Which way up a photo's file is, for programs that show its pixels as they are stored, as Blender does.

`load` undoes the tag with Pillow, which Blender's Python lacks. Needs numpy only.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

_MOST = 1 << 20  # bytes of a file that are searched: cameras write the tag at its beginning
_ORIENTATION, _SHORT = 0x0112, 3
_START_OF_SCAN, _APP1 = 0xDA, 0xE1


def orientation_of(path: str | os.PathLike[str]) -> int:
    """EXIF 2.3 tag 0x0112 of a JPEG, PNG, WebP or TIFF file: 1 to 8; 1, upright, where there is none or it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MOST)
        return _in_tiff(_exif(data))
    except (OSError, struct.error, IndexError):
        return 1


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """A picture [H, W, ...], the first row on top, as its orientation means it to be seen."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def _exif(data: bytes) -> bytes:
    """The TIFF structure of a file, b"" where it has none."""
    if data[:2] == b"\xff\xd8":
        return _in_jpeg(data)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _in_chunks(data, 8, ">I4s", b"eXIf", lambda size: size + 4)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _in_chunks(data, 12, "<4sI", b"EXIF", lambda size: size + size % 2).removeprefix(b"Exif\0\0")
    return data if data[:4] in (b"II*\0", b"MM\0*") else b""


def _in_jpeg(data: bytes) -> bytes:
    place = 2
    while data[place] == 0xFF and data[place + 1] != _START_OF_SCAN:
        (size,) = struct.unpack_from(">H", data, place + 2)
        content = data[place + 4 : place + 2 + size]
        if data[place + 1] == _APP1 and content[:6] == b"Exif\0\0":
            return content[6:]
        place += 2 + size
    return b""


def _in_chunks(data: bytes, place: int, layout: str, wanted: bytes, beyond: Callable[[int], int]) -> bytes:
    while True:
        head = struct.unpack_from(layout, data, place)
        name, size = (head[1], head[0]) if isinstance(head[0], int) else head
        place += 8
        if name == wanted:
            return data[place : place + size]
        place += beyond(size)


def _in_tiff(data: bytes) -> int:
    """The tag in the first directory of a TIFF structure."""
    if data[:2] not in (b"II", b"MM"):
        return 1
    order = "<" if data[:2] == b"II" else ">"
    (place,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, place)
    for entry in range(count):
        tag, kind, _, value = struct.unpack_from(order + "HHIH", data, place + 2 + 12 * entry)
        if tag == _ORIENTATION and kind == _SHORT:
            return value if 1 <= value <= 8 else 1
    return 1
