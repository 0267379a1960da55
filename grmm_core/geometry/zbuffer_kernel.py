"""The compiled twin of `zbuffer_numpy.draw`; importing it loads numba. Only `zbuffer` calls it.

Same arithmetic in the same order, hence no fast-math: both forms give the same picture.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .zbuffer_numpy import (
    EMPTY,
    FIRST,
    LAST,
    LONG,
    LOWER,
    MIDDLE,
    PER_COLUMN,
    PER_ROW,
    SPAN_SLACK,
    TOP,
    UPPER,
    VALUE,
)

_SMALLEST = 1.0 / float(EMPTY)


@compiled(nogil=True, boundscheck=False)
def draw(
    depth: np.ndarray, left: int, top: int,
    rows: np.ndarray, x: np.ndarray, y: np.ndarray, slopes: np.ndarray, plane: np.ndarray, orthographic: bool, far: float,
) -> None:  # fmt: skip
    """Write the nearer values into `depth` [H, W], whose corner is at (left, top), as `zbuffer_numpy.draw` does."""
    right = left + depth.shape[1]
    for t in range(rows.shape[1]):
        for row in range(rows[FIRST, t], rows[LAST, t] + 1):
            center = row + 0.5
            to_middle = center - y[MIDDLE, t]
            one = x[TOP, t] + (center - y[TOP, t]) * slopes[LONG, t]
            two = x[MIDDLE, t] + to_middle * (slopes[UPPER, t] if to_middle < 0 else slopes[LOWER, t])
            low, high = min(max(min(one, two), left - 1.0), right + 1.0), min(max(max(one, two), left - 1.0), right + 1.0)
            first = max(math.ceil(low - 0.5 - SPAN_SLACK), left)
            last = min(math.floor(high - 0.5 + SPAN_SLACK), right - 1)
            start = plane[VALUE, t] + plane[PER_ROW, t] * row
            for column in range(first, last + 1):
                value = start + plane[PER_COLUMN, t] * column
                z = value if orthographic else 1.0 / max(value, _SMALLEST)
                if z <= far:
                    depth[row - top, column - left] = min(depth[row - top, column - left], np.float32(z))
