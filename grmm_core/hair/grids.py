"""Grids of cells and clouds of points around a head: what `grid_kernels` compute for them. Needs numba."""

from __future__ import annotations

import numpy as np


def smooth_grid(grid: np.ndarray) -> np.ndarray:
    """Values [X, Y, Z] blurred by a binomial of three cells along each axis; at the borders cells repeat."""
    for axis in range(3):
        along = np.moveaxis(grid, axis, 0)
        mixed = 0.5 * along
        for inner, outer, edge in ((slice(1, None), slice(None, -1), 0), (slice(None, -1), slice(1, None), -1)):
            mixed[inner] += 0.25 * along[outer]
            mixed[edge] += 0.25 * along[edge]
        grid = np.moveaxis(mixed, 0, axis)
    return np.ascontiguousarray(grid)


def sample(grid: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values [P, C] between the centres of cells of a grid [X, Y, Z, C], at [P, 3]; float32."""
    from ..compute.threads import for_rows
    from .grid_kernels import sample_into

    found = np.empty((len(at), grid.shape[3]), np.float32)
    given = (np.ascontiguousarray(array, np.float32) for array in (grid, at))
    for_rows(sample_into, len(at), *given, found)
    return found


def nearest(points: np.ndarray, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and distances of the nearest `points` [N, 3] of each place [P, 3], near ones first, [P, count] each."""
    from ..compute.threads import for_rows
    from .grid_kernels import nearest_into

    shape = len(places), min(count, len(points))
    order, apart = np.zeros(shape, np.int64), np.zeros(shape)
    given = (np.ascontiguousarray(array, np.float64) for array in (points, places))
    for_rows(nearest_into, len(places), *given, order, apart, smallest=64)
    return order, np.sqrt(apart)
