"""The compiled part of `blur`; importing it loads numba."""

from __future__ import annotations

import numpy as np

from ..compute.kernels import compiled


@compiled(fastmath=True, boundscheck=False)
def _accumulate(target: np.ndarray, source: np.ndarray, weight: np.float32) -> None:
    for x in range(len(target)):
        target[x] += weight * source[x]


@compiled(nogil=True, fastmath=True, boundscheck=False)
def separable(
    source: np.ndarray, result: np.ndarray, window: np.ndarray, rows: np.ndarray, columns: np.ndarray, normalise_first: bool,
    first: int, end: int,
) -> None:  # fmt: skip
    """Filter some rows of planes with a symmetric window in both directions.

    Args:
        source: [C, H, W] float32.
        result: Written, same shape.
        window: [2R + 1] float32.
        rows: Factor of each row, [H] float32.
        columns: Factor of each column, [W] float32.
        normalise_first: Apply the factors before filtering (the transposed operator) instead of after it.
        first: Row of the result from which on it is written, counted through all planes.
        end: The row after the last.
    """
    height, width = source.shape[1:]
    radius = len(window) // 2
    for job in range(first, end):
        plane, y = job // height, job % height
        # columns of this row first, into a padded line: the inner loops run over contiguous memory and vectorise
        line = np.zeros(width + 2 * radius, np.float32)
        inner = line[radius : radius + width]
        for k in range(2 * radius + 1):
            row = y + k - radius
            if 0 <= row < height:
                weight = window[k] * rows[row] if normalise_first else window[k]
                _accumulate(inner, source[plane, row], weight)
        if normalise_first:
            for x in range(width):
                inner[x] *= columns[x]
        out = result[plane, y]
        out[:] = np.float32(0.0)
        for k in range(2 * radius + 1):
            _accumulate(out, line[k : k + width], window[k])
        if not normalise_first:
            for x in range(width):
                out[x] *= columns[x] * rows[y]
