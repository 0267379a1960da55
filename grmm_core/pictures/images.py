"""Picture files: PNG with 8 or 16 bits and OpenEXR with named float channels, written with numpy and zlib alone; EXR in.

Small writers of our own, because stock Blender's Python has no imaging library and the common one writes neither 16-bit
color PNG nor EXR. Pictures are read with Pillow where they are needed (fitting). Used by the command line and thumbnails.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping

import numpy as np

from ..errors import FileFormatError, RuntimeMissingError, ShapeError
from ..files.access import atomic_write_bytes, open_file

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_COLOR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}  # channels to the format's color type
_PNG_FILTER_UP = 2
_EXR_MAGIC = struct.pack("<ii", 20000630, 2)
_EXR_FLOAT = 2
_EXR_ZIP = 3
_EXR_LINES_PER_CHUNK = 16


def quantize(values: np.ndarray, bits: int = 8) -> np.ndarray:
    """Round values 0..1 to 8- or 16-bit integers; values outside are clipped."""
    top = (1 << bits) - 1
    scaled = np.clip(np.asarray(values, np.float32), 0.0, 1.0).astype(np.float64) * top + 0.5
    return scaled.astype(np.uint8 if bits == 8 else np.uint16)


def encode_png(pixels: np.ndarray) -> bytes:
    """Encode a picture as PNG.

    Args:
        pixels: uint8 or uint16, [H, W] or [H, W, C] with 1 to 4 channels: grey, grey + alpha, RGB, RGBA (straight alpha).

    Raises:
        ShapeError: Another shape or data type.
    """
    pixels = np.asarray(pixels)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in _PNG_COLOR_TYPES or pixels.dtype not in (np.uint8, np.uint16):
        raise ShapeError(f"A PNG cannot hold an array of shape {pixels.shape} and type {pixels.dtype}.")
    height, width, channels = pixels.shape
    raw = np.ascontiguousarray(pixels.astype(">u2" if pixels.dtype == np.uint16 else np.uint8))
    rows = raw.view(np.uint8).reshape(height, -1)
    filtered = np.empty((height, rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = _PNG_FILTER_UP
    filtered[0, 1:] = rows[0]
    filtered[1:, 1:] = rows[1:] - rows[:-1]  # unsigned wrap-around is the format's rule
    header = struct.pack(">IIBBBBB", width, height, 8 * pixels.dtype.itemsize, _PNG_COLOR_TYPES[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 6)), (b"IEND", b""))
    return _PNG_SIGNATURE + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def write_png(path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Write a PNG, whole or not at all. Arguments as `encode_png`. Raises `FileAccessError`, `ShapeError`."""
    atomic_write_bytes(path, encode_png(pixels))


def encode_exr(channels: Mapping[str, np.ndarray]) -> bytes:
    """Encode named float channels as a scan-line OpenEXR file, 32-bit float, ZIP compression.

    Args:
        channels: Name ("R", "depth.Z", ...) to [H, W] array; all of one size.

    Raises:
        ShapeError: No channel, or sizes differ.
    """
    names = sorted(channels, key=lambda name: name.encode())
    shapes = {np.shape(array) for array in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ShapeError(f"The channels of an EXR picture must be [H, W] and of one size, not {sorted(shapes)}.")
    height, width = shapes.pop()
    # Within a scan line the channels follow one another: [H, channel, W].
    lines = np.stack([np.asarray(channels[name], "<f4") for name in names], axis=1)
    channel_list = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _EXR_FLOAT, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    attributes = (
        ("channels", "chlist", channel_list),
        ("compression", "compression", bytes([_EXR_ZIP])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    )
    header = (
        _EXR_MAGIC
        + b"".join(
            name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
            for name, kind, value in attributes
        )
        + b"\0"
    )
    chunks = []
    for top in range(0, height, _EXR_LINES_PER_CHUNK):
        data = _zip_chunk(lines[top : top + _EXR_LINES_PER_CHUNK])
        chunks.append(struct.pack("<ii", top, len(data)) + data)
    offsets = len(header) + 8 * len(chunks) + np.cumsum([0, *(len(chunk) for chunk in chunks[:-1])])
    return header + offsets.astype("<u8").tobytes() + b"".join(chunks)


def write_exr(path: str | os.PathLike[str], channels: Mapping[str, np.ndarray]) -> None:
    """Write an EXR picture, whole or not at all. Arguments as `encode_exr`. Raises `FileAccessError`, `ShapeError`."""
    atomic_write_bytes(path, encode_exr(channels))


def read_exr_rgb(path: str | os.PathLike[str]) -> np.ndarray:
    """Read the color of an OpenEXR picture, linear RGB float32 [H, W, 3], with the OpenEXR package.

    Raises:
        FileAccessError: It is missing or cannot be read.
        FileFormatError: It is damaged or has no color.
        RuntimeMissingError: The package is missing.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise RuntimeMissingError("Reading EXR pictures needs the package OpenEXR; run pip install OpenEXR.") from error
    with open_file(path):  # what the package says about files that are not there is no sentence
        pass
    try:
        with OpenEXR.File(os.fspath(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise FileFormatError(f"{path} is no OpenEXR picture that can be read ({error}); save it again.") from error
    if not {"R", "G", "B"} <= channels.keys():
        raise FileFormatError(f"{path} has no channels R, G and B; save it as a color picture.")
    return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)


def _zip_chunk(lines: np.ndarray) -> bytes:
    """Compress scan lines as OpenEXR does: even and odd bytes apart, differences, deflate; raw where that is no smaller."""
    raw = np.frombuffer(lines.tobytes(), np.uint8)
    split = np.concatenate([raw[0::2], raw[1::2]])
    deltas = split.copy()
    deltas[1:] = split[1:] - split[:-1] + np.uint8(128)
    packed = zlib.compress(deltas.tobytes(), 4)
    return packed if len(packed) < raw.size else raw.tobytes()
