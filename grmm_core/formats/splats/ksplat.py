"""`.ksplat` files of the viewer GaussianSplats3D: sections of splats in buckets, at three levels of compression.

A header of 4096 bytes, one of 1024 for each section, then for each section the sizes of the buckets that are not full, the
buckets' centres and the splats. Level 0 has plain floats; level 1 positions in 16 bits around their bucket's centre and the
rest in half floats; level 2 likewise, with harmonics of a byte each between two bounds. Scales are linear, quaternions wxyz,
colors and opacity bytes. y is down, as in the PLY files that these are made from. Read only. Needs numpy only.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...files.access import bad_file, read_bytes
from ...files.format import Format
from .cloud import MAX_SPLATS, SH_C0, SplatCloud, finish_reading

KIND = ".ksplat file"
_HEADER, _SECTION_HEADER = 4096, 1024
_MAX_BYTES = 4 << 30
_MAX_SECTIONS = 4096
_SH_TERMS = (0, 3, 8)
_SH_BOUNDS = 1.5  # of level 2, where the header has none
_RANGES = (1, 32767, 32767)  # of positions on each side of a bucket's centre, where the section has none
_FLOATS = ("<f4", "<f2", "<f2")


@dataclass(frozen=True)
class _Section:
    count: int
    capacity: int  # of splats, as stored
    bucket_size: int
    bucket_count: int
    block: float  # metres, side of a bucket
    bucket_bytes: int
    steps: int
    full: int
    partial: int
    degree: int


def read_ksplat(path: Path, axes: str = "file") -> SplatCloud:
    """Read a `.ksplat` file.

    Args:
        path: The file.
        axes: "file" turns y up, "y_up" keeps the numbers.

    Raises:
        FileFormatError: Damaged, of another version, or a header that does not fit the file.
        FileAccessError: Missing, unreadable or too large.
    """
    data = read_bytes(path, _MAX_BYTES)
    if len(data) < _HEADER:
        raise bad_file(path, KIND, "it is truncated")
    major, minor, sections, total, level = struct.unpack_from("<BB2xI8xIH", data)
    if major != 0 or minor < 1:
        raise bad_file(path, KIND, f"its version is {major}.{minor}, and 0.1 and later ones of 0 are read")
    if level >= len(_FLOATS) or sections > _MAX_SECTIONS or not 1 <= total <= MAX_SPLATS:
        raise bad_file(path, KIND, f"it claims level {level}, {sections} sections and {total} splats")
    start = _HEADER + sections * _SECTION_HEADER
    if start > len(data):
        raise bad_file(path, KIND, "it is truncated")
    low, high = struct.unpack_from("<ff", data, 36)
    bounds = (low or -_SH_BOUNDS, high or _SH_BOUNDS)
    parts = []
    for number in range(sections):
        section = _read_section(path, data, _HEADER + number * _SECTION_HEADER, level)
        cloud, start = _decode(path, data, start, section, level, bounds)
        if section.count:
            parts.append(cloud)
    if not parts or sum(part.count for part in parts) != total:
        raise bad_file(path, KIND, f"its sections do not have the {total} splats that it claims")
    degree = max(part.degree for part in parts)
    parts = [part.with_degree(degree) for part in parts]
    joined = SplatCloud(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("means", "quats", "scales", "opacities", "sh"))
    )
    joined = finish_reading(path, KIND, joined)
    return joined if axes == "y_up" else joined.flipped()


def _read_section(path: Path, data: bytes, at: int, level: int) -> _Section:
    count, capacity, size, buckets, block, storage, steps, full, partial, degree = struct.unpack_from(
        "<IIIIfH2xI4xIIH", data, at
    )
    if count > capacity or degree >= len(_SH_TERMS) or full + partial > buckets or not np.isfinite(block):
        raise bad_file(path, KIND, "the header of a section contradicts itself")
    return _Section(count, capacity, size, buckets, block, storage, steps or _RANGES[level], full, partial, degree)


def _decode(
    path: Path, data: bytes, start: int, section: _Section, level: int, bounds: tuple[float, float]
) -> tuple[SplatCloud, int]:
    """Splats of a section that begins at a byte, and where the next one begins."""
    terms, real = _SH_TERMS[section.degree], _FLOATS[level]
    fields: list[Any] = [
        ("position", "<f4" if level == 0 else "<u2", 3),
        ("scale", real, 3),
        ("rotation", real, 4),
        ("rgba", "u1", 4),
    ]
    fields += [("sh", "u1" if level == 2 else real, (3 * terms,))] if terms else []
    record = np.dtype(fields)
    first = start + 4 * section.partial + section.bucket_bytes * section.bucket_count
    end = first + record.itemsize * section.capacity
    if end > len(data) or (section.bucket_count and section.bucket_bytes < 12):
        raise bad_file(path, KIND, "a section is longer than the file")
    rows = np.frombuffer(data, record, section.count, first)
    with np.errstate(invalid="ignore"):
        means = rows["position"].astype(np.float32)
        if level:
            means = (means - section.steps) * (section.block / 2.0 / section.steps) + _centres(path, data, start, section)
        rgba = rows["rgba"].astype(np.float32) / 255.0
        sh = np.empty((section.count, terms + 1, 3), np.float32)
        sh[:, 0] = (rgba[:, :3] - 0.5) / SH_C0
        if terms:
            rest = rows["sh"].astype(np.float32)
            rest = bounds[0] + rest / 255.0 * (bounds[1] - bounds[0]) if level == 2 else rest
            sh[:, 1:4] = rest[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)  # channel-major within each degree
            if terms > 3:
                sh[:, 4:9] = rest[:, 9:24].reshape(-1, 3, 5).transpose(0, 2, 1)
    scales, quats = rows["scale"].astype(np.float32), rows["rotation"].astype(np.float32)
    return SplatCloud(means.astype(np.float32), quats, scales, rgba[:, 3], sh), end


def _centres(path: Path, data: bytes, start: int, section: _Section) -> np.ndarray:
    """Centre of each splat's bucket, [N, 3]: full buckets come first, then those whose sizes are listed."""
    if not section.count:
        return np.zeros((0, 3), np.float32)
    listed = np.frombuffer(data, "<u4", section.partial, start).astype(np.int64)
    sizes = np.concatenate([np.full(section.full, section.bucket_size, np.int64), listed])
    if sizes.sum() < section.count or (listed > section.count).any():
        raise bad_file(path, KIND, "its buckets have fewer splats than its section")
    ends = np.cumsum(sizes)
    bucket = np.searchsorted(ends, np.arange(section.count), side="right")
    raw = np.frombuffer(data, np.uint8, section.bucket_bytes * section.bucket_count, start + 4 * section.partial)
    centres = raw.reshape(section.bucket_count, section.bucket_bytes)[:, :12].copy().view("<f4")
    return centres[bucket]


FORMAT = Format("ksplat", ".ksplat", "As the viewer GaussianSplats3D compresses splats", "splats", (".ksplat",), read_ksplat)
