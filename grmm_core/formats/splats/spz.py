"""SPZ files: packed splats, versions 2 and 3 (one gzip stream) and 4 (zstandard streams).

Layout of version 2 and 3: a header of 16 bytes, then positions, opacities, colors, scales, rotations and harmonics, each for
all splats. Positions are 24-bit fixed point, scales 8-bit logarithms, rotations either x, y, z as bytes (version 2) or the
three smallest components in 10 bits each (from 3 on), harmonics bytes with the channel innermost. Axes: x right, y up, z
backward.

Why not a library: the format's own bindings are not on PyPI, `gsply` needs numba, `gaussforge` is compiled and checks no sizes;
Blender has numpy and zlib. The tests open our files with readers from PyPI and npm. Version 4 is read and written where the
`zstandard` package is installed; nothing else needs it. Needs numpy only.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BackendError
from ...files.access import atomic_write_bytes, bad_file, read_bytes
from ...files.format import Format, Option
from .cloud import (
    MAX_DEGREE,
    MAX_SPLATS,
    SH_C0,
    SplatCloud,
    check_expansion,
    clipped_colors,
    exp_scale,
    finish_reading,
    log_scale,
)
from .splat_file import to_byte

KIND = "SPZ file"
MAGIC = 0x5053474E
_HEADER = struct.Struct("<IIIBBBB")
_HEADER_V4 = struct.Struct("<IIIBBBBI12x")
_TOC_ENTRY = struct.Struct("<QQ")
_SH_COUNTS = (0, 3, 8, 15, 24)
_COLOR_SCALE = 0.15  # range of the 8-bit colors: wider than 0..1, since higher harmonics can bring them back
_FLAG_ANTIALIASED = 1
_MAX_FRACTIONAL_BITS = 23
_SH_BITS = (5, 4)  # bits kept of the harmonics of degree 1 and of the others, so that they compress
_MAX_FILE_BYTES = 1 << 30
_DEFLATE_RATIO = 1032  # the most that deflate can expand
_HALF_ROOT = 0.5**0.5
_GZIP_WBITS = 31
_CHUNK = 1 << 16  # splats decoded at once: bounds memory


def read_spz(path: Path) -> SplatCloud:
    """Read an SPZ file of version 2, 3 or 4.

    Raises:
        FileFormatError: Damaged, of another version, or with a header that does not fit its data.
        BackendError: Version 4 and the `zstandard` package is not installed.
        FileAccessError: Missing, unreadable or larger than 1 GiB.
    """
    data = read_bytes(path, _MAX_FILE_BYTES)
    if data[:4] == struct.pack("<I", MAGIC):
        return _read_v4(path, data)
    return _read_gzip(path, data)


def _read_gzip(path: Path, data: bytes) -> SplatCloud:
    stream = zlib.decompressobj(_GZIP_WBITS)
    try:
        head = stream.decompress(data, _HEADER.size)
        if len(head) < _HEADER.size:
            raise bad_file(path, KIND, "it is truncated")
        magic, version, count, degree, bits, flags, _ = _HEADER.unpack(head)
        if magic != MAGIC:
            raise bad_file(path, KIND, "it has no SPZ header")
        if version not in (2, 3):
            raise bad_file(path, KIND, f"its version is {version}, and in a file of this form 2 and 3 are read")
        sizes = _stream_sizes(path, version, count, degree, bits, len(data))
        total = sum(sizes)
        if total > len(data) * _DEFLATE_RATIO:
            raise bad_file(path, KIND, f"its header claims {count} splats, more than it can hold")
        body = bytearray(stream.decompress(stream.unconsumed_tail, total))
        while len(body) < total and not stream.eof:  # the object may hand out its output in parts
            part = stream.decompress(stream.unconsumed_tail, total - len(body))
            if not part:
                break
            body += part
    except zlib.error as error:
        raise bad_file(path, KIND, "it is not compressed by gzip") from error
    if len(body) < total:
        raise bad_file(path, KIND, f"its header claims {count} splats, more than it has")
    parts, start = [], 0
    for size in sizes:
        parts.append(np.frombuffer(body, np.uint8, size, start))
        start += size
    return _decode(path, parts, version, count, degree, bits, flags)


def _read_v4(path: Path, data: bytes) -> SplatCloud:
    if len(data) < _HEADER_V4.size:
        raise bad_file(path, KIND, "it is truncated")
    _, version, count, degree, bits, flags, streams, toc = _HEADER_V4.unpack_from(data)
    if version != 4:
        raise bad_file(path, KIND, f"its version is {version}, and in a file of this form 4 is read")
    sizes = _stream_sizes(path, version, count, degree, bits, len(data))
    start = toc + streams * _TOC_ENTRY.size
    needed = 6 if degree else 5
    if not _HEADER_V4.size <= toc <= len(data) or streams < needed or start > len(data):
        raise bad_file(path, KIND, "its table of streams does not fit the file")
    decompressor = _zstandard(path).ZstdDecompressor()
    parts = []
    for i in range(6):
        if i >= streams:
            parts.append(np.zeros(0, np.uint8))
            continue
        packed, plain = _TOC_ENTRY.unpack_from(data, toc + i * _TOC_ENTRY.size)
        if plain != sizes[i] or packed > len(data) - start:
            raise bad_file(path, KIND, "its table of streams does not fit the file")
        raw = _unpack_zstd(path, decompressor, data[start : start + packed], plain)
        parts.append(np.frombuffer(raw, np.uint8))
        start += packed
    return _decode(path, parts, version, count, degree, bits, flags)


def _zstandard(path: Path) -> Any:
    try:
        import zstandard
    except ImportError as error:
        raise BackendError(
            f"{path} is an SPZ file of version 4, which needs the Python package zstandard; install it or save version 3."
        ) from error
    return zstandard


def _unpack_zstd(path: Path, decompressor: Any, packed: bytes, size: int) -> bytes:
    """Decompress at most `size` bytes, whatever the frame's own header claims."""
    import zstandard

    try:
        with decompressor.stream_reader(packed) as reader:
            raw = reader.read(size) if size else b""
    except (zstandard.ZstdError, MemoryError) as error:
        raise bad_file(path, KIND, "a stream is damaged") from error
    if len(raw) != size:
        raise bad_file(path, KIND, "a stream is truncated")
    return raw


def _stream_sizes(path: Path, version: int, count: int, degree: int, bits: int, file_bytes: int) -> list[int]:
    if degree >= len(_SH_COUNTS) or bits > _MAX_FRACTIONAL_BITS:
        raise bad_file(path, KIND, f"degree {degree} or {bits} fractional bits are impossible")
    if not 1 <= count <= MAX_SPLATS:
        raise bad_file(path, KIND, f"it has {count} splats, and 1 to {MAX_SPLATS} are read")
    check_expansion(path, KIND, count, _SH_COUNTS[min(degree, MAX_DEGREE)] + 1, file_bytes)
    rotation = 3 if version == 2 else 4
    return [count * n for n in (9, 1, 3, 3, rotation, 3 * _SH_COUNTS[degree])]


def _decode(path: Path, parts: list[np.ndarray], version: int, count: int, degree: int, bits: int, flags: int) -> SplatCloud:
    positions, alphas, colors, scales, rotations, harmonics = (part.reshape(count, -1) for part in parts)
    kept = _SH_COUNTS[min(degree, MAX_DEGREE)]
    cloud = SplatCloud(
        np.empty((count, 3), np.float32),
        np.empty((count, 4), np.float32),
        np.empty((count, 3), np.float32),
        alphas[:, 0] / np.float32(255.0),
        np.empty((count, kept + 1, 3), np.float32),
        antialiased=bool(flags & _FLAG_ANTIALIASED),
    )
    for start in range(0, count, _CHUNK):
        rows = slice(start, start + _CHUNK)
        octets = positions[rows].reshape(-1, 3).astype(np.int32)
        fixed = octets[:, 0] | (octets[:, 1] << 8) | (octets[:, 2] << 16)
        fixed = (fixed ^ 0x800000) - 0x800000  # sign of 24 bits
        cloud.means[rows] = (fixed.astype(np.float64) / (1 << bits)).reshape(-1, 3)
        cloud.quats[rows] = _first_three(rotations[rows]) if version == 2 else _smallest_three(rotations[rows])
        cloud.scales[rows] = exp_scale(scales[rows].astype(np.float32) / 16.0 - 10.0)
        cloud.sh[rows, 0] = (colors[rows].astype(np.float32) / 255.0 - 0.5) / _COLOR_SCALE
        if kept:
            rest = harmonics[rows].reshape(-1, harmonics.shape[1] // 3, 3)[:, :kept]
            cloud.sh[rows, 1:] = (rest.astype(np.float32) - 128.0) / 128.0
    if degree > MAX_DEGREE:
        cloud.warnings.append(f"Spherical harmonics of degree {degree} were cut to degree {MAX_DEGREE}.")
    return finish_reading(path, KIND, cloud)


def _first_three(rotations: np.ndarray) -> np.ndarray:
    """Quaternions wxyz [N, 4] from bytes x, y, z; w is not negative."""
    xyz = rotations.reshape(-1, 3).astype(np.float32) / 127.5 - 1.0
    w = np.sqrt(np.maximum(0.0, 1.0 - (xyz * xyz).sum(1)))
    return np.concatenate([w[:, None], xyz], 1)


def _smallest_three(rotations: np.ndarray) -> np.ndarray:
    """Quaternions wxyz [N, 4] from 32-bit words: index of the largest of x, y, z, w, then sign and 9 bits of the others."""
    words = np.ascontiguousarray(rotations).view("<u4").reshape(-1).copy()
    largest = (words >> 30).astype(np.int64)
    xyzw = np.zeros((words.size, 4), np.float32)
    rows = np.arange(words.size)
    for step in range(3):  # the last component stands in the lowest bits
        column = _others(largest)[:, 2 - step]
        magnitude = (words & 511).astype(np.float32) * (_HALF_ROOT / 511.0)
        xyzw[rows, column] = np.where(words & 512, -magnitude, magnitude)
        words >>= 10
    xyzw[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - (xyzw * xyzw).sum(1)))
    return xyzw[:, [3, 0, 1, 2]]


_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def _others(largest: np.ndarray) -> np.ndarray:
    """Indices of the components that are not the largest, ascending, [N, 3]."""
    return _OTHERS[largest]


def write_spz(
    path: str | os.PathLike[str], cloud: SplatCloud, version: int = 3, fractional_bits: int | None = None, full_sh: bool = False
) -> list[str]:
    """Write an SPZ file.

    Args:
        path: Target file.
        cloud: Splats, y up.
        version: 2, 3 or 4 (needs the `zstandard` package).
        fractional_bits: Bits behind the point of positions; by default as many from 12 to 18 as the cloud's size allows.
        full_sh: Keep 8 bits of the harmonics instead of 5 and 4; larger files.

    Returns:
        What the file does not hold.

    Raises:
        ShapeError: The cloud is malformed.
        BackendError: Version 4 without `zstandard`.
        FileAccessError: The file cannot be written.
    """
    cloud = cloud.validated()
    bits = fractional_bits if fractional_bits is not None else _choose_bits(float(np.abs(cloud.means).max()))
    fixed = np.clip(np.rint(cloud.means.astype(np.float64) * (1 << bits)), -(1 << 23), (1 << 23) - 1).astype(np.int32)
    positions = np.ascontiguousarray(fixed.astype("<i4")).view(np.uint8).reshape(-1, 4)[:, :3]
    colors = to_byte(cloud.sh[:, 0] * (_COLOR_SCALE * 255.0) + 127.5)
    parts = [
        positions.tobytes(),
        to_byte(cloud.opacities * 255.0).tobytes(),
        colors.tobytes(),
        to_byte((log_scale(cloud.scales) + 10.0) * 16.0).tobytes(),
        _pack_first_three(cloud.quats) if version == 2 else _pack_smallest_three(cloud.quats),
        _pack_harmonics(cloud.sh[:, 1:], full_sh),
    ]
    flags = _FLAG_ANTIALIASED if cloud.antialiased else 0
    if version == 4:
        data = _pack_v4(Path(path), parts, cloud, bits, flags)
    else:
        packer = zlib.compressobj(6, zlib.DEFLATED, _GZIP_WBITS)
        data = packer.compress(_HEADER.pack(MAGIC, version, cloud.count, cloud.degree, bits, flags, 0) + b"".join(parts))
        data += packer.flush()
    atomic_write_bytes(path, data)
    steps = np.rint(cloud.sh[:, 1:] * 128.0)
    clipped = int(((steps < -128) | (steps > 127)).any((1, 2)).sum())
    said = [f"{clipped} of {cloud.count} splats have view dependence beyond what SPZ holds; it was clipped."] if clipped else []
    reach = SH_C0 * 0.5 / _COLOR_SCALE
    return [*clipped_colors(cloud, 0.5 - reach, 0.5 + reach), *said]


def _choose_bits(extent: float) -> int:
    """The finest fixed point that still holds the cloud: 4 micrometres for a head, a quarter of a millimetre for a room."""
    bits = 18
    while bits > 1 and (extent + 1e-6) * (1 << bits) >= (1 << 23) - 1:
        bits -= 1
    return bits


def _pack_first_three(quats: np.ndarray) -> bytes:
    xyz = quats[:, 1:] * np.where(quats[:, :1] < 0, -127.5, 127.5)
    return to_byte(xyz + 127.5).tobytes()


def _pack_smallest_three(quats: np.ndarray) -> bytes:
    xyzw = quats[:, [1, 2, 3, 0]]
    largest = np.abs(xyzw).argmax(1)
    rows = np.arange(xyzw.shape[0])
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    words = largest.astype(np.uint32)
    for step in range(3):
        value = xyzw[rows, _others(largest)[:, step]]
        magnitude = np.minimum(np.abs(value) * (511.0 / _HALF_ROOT) + 0.5, 511.0).astype(np.uint32)
        words = (words << 10) | ((value < 0).astype(np.uint32) << 9) | magnitude
    return words.astype("<u4").tobytes()


def _pack_harmonics(rest: np.ndarray, full: bool) -> bytes:
    """Bytes around 128, [N, K, 3], rounded to fewer bits so that they compress."""
    packed = np.rint(rest * 128.0) + 128.0
    if not full:
        kept = [_SH_BITS[0] if k < 3 else _SH_BITS[1] for k in range(rest.shape[1])]
        steps = np.array([1 << (8 - bits) for bits in kept])[None, :, None]
        packed = np.floor((packed + steps // 2) / steps) * steps
    return to_byte(packed).tobytes()


def _pack_v4(path: Path, parts: list[bytes], cloud: SplatCloud, bits: int, flags: int) -> bytes:
    compressor = _zstandard(path).ZstdCompressor(level=9)
    packed = [compressor.compress(part) for part in parts]
    header = _HEADER_V4.pack(MAGIC, 4, cloud.count, cloud.degree, bits, flags, len(parts), _HEADER_V4.size)
    toc = b"".join(_TOC_ENTRY.pack(len(small), len(plain)) for small, plain in zip(packed, parts, strict=True))
    return header + toc + b"".join(packed)


_VERSION = Option(
    "version", "SPZ Version", "Version of .spz files: older viewers read 2 alone, 4 needs the Python package zstandard", 3,
    ((2, "2, for older viewers"), (3, "3"), (4, "4")), "spz_version",
)  # fmt: skip

FORMAT = Format(
    "spz", "SPZ (.spz)", "Compressed to about a tenth", "splats", (".spz",), read_spz, write_spz,
    writing=(_VERSION,), needs={"zstandard": "version 4"},
)  # fmt: skip
