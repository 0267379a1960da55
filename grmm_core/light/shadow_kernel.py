"""The compiled twin of `shadows.compared`."""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled


@compiled(fastmath=True, boundscheck=False, error_model="numpy", nogil=True)
def compared(depth: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, seen: np.ndarray) -> None:
    """Compare points with a map; see `shadows.compared`.

    Args:
        depth: Map, [H, W] float32.
        x: Columns of points, [N].
        y: Rows, [N].
        z: Depths, [N].
        seen: Written, [N].
    """
    height, width = depth.shape
    for i in range(len(x)):
        left, top = math.floor(x[i] - 0.5), math.floor(y[i] - 0.5)
        u, v = x[i] - 0.5 - left, y[i] - 0.5 - top
        total, whole = 0.0, 0.0
        for row in range(-1, 3):
            down = max(0.0, 1.5 - abs(row - v))
            r = min(max(int(top) + row, 0), height - 1)
            for column in range(-1, 3):
                weight = down * max(0.0, 1.5 - abs(column - u))
                c = min(max(int(left) + column, 0), width - 1)
                whole += weight
                if depth[r, c] >= z[i]:
                    total += weight
        seen[i] = total / whole
