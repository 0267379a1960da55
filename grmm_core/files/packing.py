"""Eight-bit storage of large maps: the basis maps of a weights file, the changes of an avatar.

Blocks of 64 neighbouring numbers share one half-precision scale, so that a number is off by at most 1/254 of the largest of
its block (the scheme that llama.cpp calls Q8_0). Half precision would need nearly twice the space for digits that no
picture shows. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

BLOCK = 64
LARGEST = 127


def pack(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Round rows of numbers to eight bits.

    Args:
        array: Finite numbers up to 127 times the largest of half precision, [K, M].

    Returns:
        Whole numbers -127..127, [K, M] int8, and the scale of each block, [K, ceil(M / 64)] float16.
    """
    blocks = _blocks(np.asarray(array, np.float32))
    scales = (np.abs(blocks).max(-1) / LARGEST).astype(np.float16)
    divisor = np.maximum(scales.astype(np.float32), np.finfo(np.float32).tiny)[..., None]
    # a scale that was rounded down would need 128 for the largest number of its block
    whole = np.clip(np.rint(blocks / divisor), -LARGEST, LARGEST)
    return whole.astype(np.int8).reshape(len(array), -1)[:, : array.shape[1]], scales


def unpack(whole: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """The numbers that `pack` rounded, [K, M] float32. `scales` must have the shape that `scales_shape` gives."""
    numbers = _blocks(whole.astype(np.float32)) * scales.astype(np.float32)[..., None]
    result: np.ndarray = numbers.reshape(len(whole), -1)[:, : whole.shape[1]]
    return np.ascontiguousarray(result)


def scales_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """Shape of the scales of an array [K, M]."""
    rows, columns = shape
    return rows, -(-columns // BLOCK)


def _blocks(array: np.ndarray) -> np.ndarray:
    """Rows cut into blocks, the last filled up with zeros, [K, B, 64]; of rows shorter than that [K, 1, M]."""
    rows, count = scales_shape(array.shape)
    width = max(1, min(BLOCK, array.shape[1]))
    return np.pad(array, ((0, 0), (0, count * width - array.shape[1]))).reshape(rows, count, width)
