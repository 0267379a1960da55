"""Compiled work on grids of cells and on clouds of points around a head; importing this module loads numba.

Rows come in stretches of a first and an end one, for `compute.threads.for_rows`.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled

_OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
F = np.float32
_ONE, _ZERO = F(1.0), F(0.0)


@compiled(**_OPTIONS)
def march(
    dim: np.ndarray, places: np.ndarray, directions: np.ndarray, steps: int, cell: float, seen: np.ndarray, first: int, end: int
) -> None:  # fmt: skip
    """Follow light to cells of a grid.

    Args:
        dim: Extinction of the cells, 1/m, [X, Y, Z]; nothing dims outside.
        places: Where light is wanted, in cells, [P, 3].
        directions: Unit vectors towards the light, [D, 3].
        steps: How many cells far.
        cell: Edge of a cell, metres.
        seen: Written, mean over the directions of the light that arrives, and three times its mean with the direction, [P, 4].
        first: Place that is wanted first.
        end: Behind the last.
    """
    for p in range(first, end):
        a = b = c = d = _ZERO
        for n in range(len(directions)):
            x, y, z = directions[n, 0], directions[n, 1], directions[n, 2]
            depth = _ZERO
            for step in range(1, steps):
                i = math.floor(places[p, 0] + x * step)
                j = math.floor(places[p, 1] + y * step)
                k = math.floor(places[p, 2] + z * step)
                if not (0 <= i < dim.shape[0] and 0 <= j < dim.shape[1] and 0 <= k < dim.shape[2]):
                    break
                depth += dim[i, j, k]
            through = math.exp(-F(cell) * depth)
            a, b, c, d = a + through, b + through * x, c + through * y, d + through * z
        seen[p, 0] = a / len(directions)
        share = F(3.0) / len(directions)
        seen[p, 1], seen[p, 2], seen[p, 3] = b * share, c * share, d * share


@compiled(**_OPTIONS)
def fill(points: np.ndarray, widths: np.ndarray, low: np.ndarray, cell: float, grid: np.ndarray) -> None:
    """Add what strands [N, K, 3] of diameters [N] cover, seen from the side, to cells from a corner on: m^2, [X, Y, Z]."""
    for i in range(len(points)):
        for k in range(points.shape[1] - 1):
            x, y, z = points[i, k, 0], points[i, k, 1], points[i, k, 2]
            dx, dy, dz = points[i, k + 1, 0] - x, points[i, k + 1, 1] - y, points[i, k + 1, 2] - z
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            pieces = int(length / cell) + 1
            for piece in range(pieces):
                t = (F(piece) + F(0.5)) / F(pieces)
                at_x, at_y, at_z = x + t * dx - low[0], y + t * dy - low[1], z + t * dz - low[2]
                grid[int(at_x / cell), int(at_y / cell), int(at_z / cell)] += length * widths[i] / F(pieces)


@compiled(**_OPTIONS)
def sample_into(grid: np.ndarray, at: np.ndarray, out: np.ndarray, first: int, end: int) -> None:
    """Values [P, C] between the centres of cells of a grid [X, Y, Z, C], at [P, 3]; float32."""
    for p in range(first, end):
        x = min(max(at[p, 0], _ZERO), F(grid.shape[0]) - F(1.001))
        y = min(max(at[p, 1], _ZERO), F(grid.shape[1]) - F(1.001))
        z = min(max(at[p, 2], _ZERO), F(grid.shape[2]) - F(1.001))
        i, j, k = int(x), int(y), int(z)
        x, y, z = x - F(i), y - F(j), z - F(k)
        for c in range(grid.shape[3]):
            out[p, c] = (_ONE - x) * (
                (_ONE - y) * ((_ONE - z) * grid[i, j, k, c] + z * grid[i, j, k + 1, c])
                + y * ((_ONE - z) * grid[i, j + 1, k, c] + z * grid[i, j + 1, k + 1, c])
            ) + x * (
                (_ONE - y) * ((_ONE - z) * grid[i + 1, j, k, c] + z * grid[i + 1, j, k + 1, c])
                + y * ((_ONE - z) * grid[i + 1, j + 1, k, c] + z * grid[i + 1, j + 1, k + 1, c])
            )


@compiled(**_OPTIONS)
def nearest_into(
    points: np.ndarray, places: np.ndarray, order: np.ndarray, apart: np.ndarray, first: int, end: int
) -> None:  # fmt: skip
    """The nearest `points` [N, 3] of places [P, 3], near ones first: numbers [P, K] int64 and squared distances [P, K]."""
    count = order.shape[1]
    for p in range(first, end):
        known = 0
        for n in range(len(points)):
            x, y, z = points[n, 0] - places[p, 0], points[n, 1] - places[p, 1], points[n, 2] - places[p, 2]
            far = x * x + y * y + z * z
            if known == count and far >= apart[p, count - 1]:
                continue
            known = min(known + 1, count)
            at = known - 1
            while at > 0 and apart[p, at - 1] > far:
                apart[p, at], order[p, at] = apart[p, at - 1], order[p, at - 1]
                at -= 1
            apart[p, at], order[p, at] = far, n
