"""A reader of uncompressed OpenEXR files, single and multi part, for tests: `read_exr(path)` -> {channel: [H, W]}."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_TYPES = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
_MULTIPART = 0x1000


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Return every channel under its full name; in multi-part files "PART.CHANNEL" unless the channel says its layer itself."""
    data = path.read_bytes()
    magic, version = struct.unpack_from("<iI", data, 0)
    assert magic == 20000630
    multipart = bool(version & _MULTIPART)
    position = 8
    headers = []
    while True:
        header, position = _header(data, position)
        if not header:
            break
        headers.append(header)
        if not multipart:
            break
    tables = []
    for header in headers:
        x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
        count = y1 - y0 + 1
        tables.append((header, x1 - x0 + 1, y0, struct.unpack_from(f"<{count}Q", data, position)))
        position += 8 * count
    channels: dict[str, np.ndarray] = {}
    for header, width, y0, offsets in tables:
        assert header["compression"] == b"\0", "save with codec NONE"
        names = _channels(header["channels"])
        prefix = header["name"].decode() if "name" in header else ""
        full = {name: name if "." in name or not prefix else f"{prefix}.{name}" for name, _ in names}
        for name, dtype in names:
            channels[full[name]] = np.empty((len(offsets), width), dtype)
        for offset in offsets:
            if multipart:
                offset += 4
            y, _size = struct.unpack_from("<ii", data, offset)
            offset += 8
            for name, dtype in names:
                channels[full[name]][y - y0] = np.frombuffer(data, dtype, width, offset)
                offset += width * dtype.itemsize
    return channels


def _header(data: bytes, position: int) -> tuple[dict[str, bytes], int]:
    header = {}
    while data[position]:
        end = data.index(b"\0", position)
        name = data[position:end].decode()
        position = data.index(b"\0", end + 1) + 1
        (size,) = struct.unpack_from("<i", data, position)
        header[name] = data[position + 4 : position + 4 + size]
        position += 4 + size
    return header, position + 1


def _channels(block: bytes) -> list[tuple[str, np.dtype]]:
    found, position = [], 0
    while block[position]:
        end = block.index(b"\0", position)
        (kind,) = struct.unpack_from("<i", block, end + 1)
        found.append((block[position:end].decode(), _TYPES[kind]))
        position = end + 17
    return found


def layers_of(channels: dict[str, np.ndarray], layer: str) -> dict[str, np.ndarray]:
    """Group EXR channels "Layer.Pass.C" to {"Pass": [H, W, C]} in the order of the pass's letters."""
    order = "RGBAXYZW"
    passes: dict[str, dict[str, np.ndarray]] = {}
    for name, values in channels.items():
        parts = name.removeprefix(f"{layer}.").split(".")
        passes.setdefault(parts[0], {})[parts[-1]] = values
    return {name: np.stack([part[c] for c in sorted(part, key=order.index)], -1) for name, part in passes.items()}
