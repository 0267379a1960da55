"""How an avatar's own changes of the weights are stored: maps over the texels in eight bits, all else in half precision.

A map's numbers of one channel on neighbouring texels share a scale (`files.packing`), so that colors are off by half a level of
an eight-bit picture at most. A file is half as large as in half precision. Used by `file` and by what makes avatars.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import FileFormatError
from ..files.packing import pack, scales_shape, unpack

DELTA, SCALE = "delta/", "delta_scale/"
APPEARANCE = "decoders.appearance_mean"  # the map of colors, which are the first three channels, and features
_HALF_MAX = 60000.0
_ROUNDS = 8  # of rounding, after which eight bits hold their own result exactly or never
_MAP = 4096  # numbers from which on an array [N, C] is packed


def rounded(array: np.ndarray) -> np.ndarray:
    """What a file holds of a change, float32 of the same shape."""
    found = np.clip(array, -_HALF_MAX, _HALF_MAX).astype(np.float16).astype(np.float32)
    if found.ndim == 2 and found.size >= _MAP:
        for _ in range(_ROUNDS):
            before, found = found, np.ascontiguousarray(unpack(*pack(found.T)).T)
            if np.array_equal(before, found):
                break
    return found


def delta_tensors(deltas: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The tensors of a file: the smallest of eight bits, half and single precision that loses nothing."""
    tensors: dict[str, np.ndarray] = {}
    for name, array in deltas.items():
        with np.errstate(over="ignore"):
            half = array.astype(np.float16)
        exact = np.array_equal(half, array)
        tensors[DELTA + name] = half if exact else array
        if array.ndim == 2 and array.size >= _MAP and np.abs(array).max() < _HALF_MAX:
            whole, scales = pack(array.T)
            if np.array_equal(unpack(whole, scales).T, array):
                tensors |= {DELTA + name: np.ascontiguousarray(whole.T), SCALE + name: scales}
    return tensors


def deltas_of(tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The changes in a file's tensors, float32. Raises `FileFormatError`: scales do not fit their numbers."""
    found: dict[str, np.ndarray] = {}
    for key, array in tensors.items():
        if not key.startswith(DELTA):
            continue
        name = key.removeprefix(DELTA)
        scales = tensors.get(SCALE + name)
        if scales is not None:
            rows = array.shape[::-1]
            if array.dtype != np.int8 or len(rows) != 2 or scales.dtype != np.float16 or scales.shape != scales_shape(rows):
                raise FileFormatError(f"the scales of {name[:80]} do not fit")
            array = np.ascontiguousarray(unpack(np.ascontiguousarray(array.T), scales).T)
        found[name] = array
    return found
