"""Lossless WebP pictures, written: what SOG files consist of.

A picture is one stream of prefix codes (the specification's lossless format, VP8L, with none of its transforms, no color cache
and no back references): each channel gets a code of its own, made for the values that it has. Quantised splats have no smooth
areas that more would shorten. Why not Pillow: Blender's Python does not have it, and this is a page. Reading is left to Pillow
or Blender, whose decoders take every kind of WebP. Needs numpy only.
"""

from __future__ import annotations

import heapq
import struct

import numpy as np

from ...errors import ShapeError

MAX_SIDE = 1 << 14
_ALPHABETS = (280, 256, 256, 256)  # of green (with lengths of back references), red, blue and alpha
_CHANNELS = (1, 0, 2, 3)  # the order in which a pixel's channels are written
_LONGEST = 14  # bits of a code, so that a pixel's four codes and a bit offset fit into 64 bits; the format allows 15
_LENGTH_BITS = 4  # of a code's length, written plainly
_LENGTH_ORDER = 19
_CHUNK = 1 << 18  # pixels packed at once: bounds memory


def encode_webp(pixels: np.ndarray) -> bytes:
    """Return a lossless WebP file.

    Args:
        pixels: RGBA, top row first, [height, width, 4] uint8. Colors under zero alpha are kept.

    Raises:
        ShapeError: No such picture, or one side is longer than 16384.
    """
    pixels = np.asarray(pixels)
    if pixels.ndim != 3 or pixels.shape[2] != 4 or pixels.dtype != np.uint8 or not min(pixels.shape) > 0:
        raise ShapeError(f"A picture must be [height, width, 4] bytes; got {pixels.shape} {pixels.dtype}.")
    height, width = pixels.shape[:2]
    if max(height, width) > MAX_SIDE:
        raise ShapeError(f"A WebP picture can have sides of {MAX_SIDE} pixels; this one has {width} x {height}.")
    channels = pixels.reshape(-1, 4)[:, _CHANNELS]  # [N, 4]
    header = _Bits()
    header.put(0x2F, 8)
    header.put(width - 1, 14)
    header.put(height - 1, 14)
    header.put(1, 1)  # alpha is used
    header.put(0, 3 + 1 + 1 + 1)  # version 0, no transform, no color cache, one group of codes
    codes, lengths = np.zeros((4, 256), np.uint64), np.zeros((4, 256), np.uint64)
    for channel, size in enumerate(_ALPHABETS):
        counts = np.bincount(channels[:, channel], minlength=256)
        own = code_lengths(counts)
        _put_code(header, own, counts, size)
        codes[channel], lengths[channel] = reversed_codes(own), own
    header.put(0b0001, 4)  # the code of distances, of which there are none: simple, one symbol of one bit, 0
    data = _pack(header, channels, codes, lengths)
    body = b"WEBPVP8L" + struct.pack("<I", len(data)) + data + b"\0" * (len(data) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def code_lengths(counts: np.ndarray) -> np.ndarray:
    """Lengths in bits of a prefix code for symbols that occur `counts` times [K], none too long; 0 for a lone symbol.

    Huffman's algorithm; where a code would be too long, rare symbols count as more frequent until it is not.
    """
    used = np.flatnonzero(counts)
    lengths = np.zeros(len(counts), np.uint64)
    if used.size < 2:
        return lengths
    floor = 1
    while True:
        depth = _huffman(np.maximum(counts[used], floor))
        if depth.max() <= _LONGEST:
            lengths[used] = depth
            return lengths
        floor *= 2


def _huffman(counts: np.ndarray) -> np.ndarray:
    heap = [(int(count), number) for number, count in enumerate(counts)]
    heapq.heapify(heap)
    parents = np.zeros(2 * len(counts) - 1, np.int64)
    for node in range(len(counts), 2 * len(counts) - 1):
        (first, a), (second, b) = heapq.heappop(heap), heapq.heappop(heap)
        parents[a] = parents[b] = node
        heapq.heappush(heap, (first + second, node))
    depth = np.zeros(len(parents), np.int64)
    for node in range(len(parents) - 2, -1, -1):  # the root is last
        depth[node] = depth[parents[node]] + 1
    return depth[: len(counts)]


def reversed_codes(lengths: np.ndarray) -> np.ndarray:
    """Canonical codes of these lengths, their bits reversed since the stream begins with the lowest bit, [K] uint64."""
    codes = np.zeros(len(lengths), np.uint64)
    code, last = 0, 0
    for symbol in np.lexsort((np.arange(len(lengths)), lengths)):
        length = int(lengths[symbol])
        if length:
            code <<= length - last
            codes[symbol] = int(f"{code:0{length}b}"[::-1], 2)
            code, last = code + 1, length
    return codes


class _Bits:
    """A short stream of bits, the lowest first."""

    def __init__(self) -> None:
        self.value, self.count = 0, 0

    def put(self, value: int, bits: int) -> None:
        self.value |= value << self.count
        self.count += bits


def _put_code(stream: _Bits, lengths: np.ndarray, counts: np.ndarray, size: int) -> None:
    """Describe a code: simple with one symbol, or normal with the plain length of every symbol of the alphabet."""
    if not lengths.any():
        stream.put(0b101, 3)  # simple, one symbol, of eight bits
        stream.put(int(np.argmax(counts)), 8)
        return
    stream.put(0, 1)
    stream.put(_LENGTH_ORDER - 4, 4)
    for symbol in (17, 18, 0, 1, 2, 3, 4, 5, 16, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15):  # the format's order
        stream.put(_LENGTH_BITS if symbol < 16 else 0, 3)  # sixteen lengths of four bits each
    stream.put(0, 1)  # all symbols follow
    for length in [*map(int, lengths), *[0] * (size - len(lengths))]:
        stream.put(int(f"{length:04b}"[::-1], 2), _LENGTH_BITS)


def _pack(header: _Bits, channels: np.ndarray, codes: np.ndarray, lengths: np.ndarray) -> bytes:
    """The header's bits and all pixels' codes as bytes."""
    total = header.count + sum(int(lengths[c][channels[:, c]].sum()) for c in range(4))
    result = np.zeros(total // 8 + 9, np.uint8)
    head = header.value.to_bytes(header.count // 8 + 1, "little")
    result[: len(head)] = np.frombuffer(head, np.uint8)
    start = header.count
    for first in range(0, len(channels), _CHUNK):
        part = channels[first : first + _CHUNK]
        words, sizes = np.zeros(len(part), np.uint64), np.zeros(len(part), np.uint64)
        for channel in range(4):
            words |= codes[channel][part[:, channel]] << sizes
            sizes += lengths[channel][part[:, channel]]
        offsets = start + np.concatenate([[0], np.cumsum(sizes.astype(np.int64))])
        words <<= (offsets[:-1] & 7).astype(np.uint64)
        base = offsets[0] >> 3
        where = (offsets[:-1] >> 3) - base
        span = int(where[-1]) + 8
        for byte in range(8):  # bits of different pixels never overlap, so that their bytes add up
            values = ((words >> np.uint64(8 * byte)) & np.uint64(255)).astype(np.float64)
            result[base : base + span] += np.bincount(where + byte, values, span).astype(np.uint8)
        start = int(offsets[-1])
    return result[: -(-total // 8)].tobytes()
