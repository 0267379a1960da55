"""Which strands lie on top and which below: the light at each strand over that of its surroundings.

`occlusion` knows light in cells that are larger than locks. In them the strands on top are as dark as those beneath, which
hair pressed flat over an ear shows as a smudge, and no strand stands out. Here what lies before each strand within a few
millimetres is counted in fine cells and in cells like those of `occlusion`; how much these differ is what that did not know.
Made once for a groom on a person at rest; needs numba.
"""

from __future__ import annotations

import numpy as np

from .grids import sample, smooth_grid
from .occlusion import CELL as COARSE

CELL = 0.0012  # metres
STEPS = 3  # cells that are looked ahead
PLACES = (0.25, 0.75)  # of a segment from where
AROUND, NEAR = 0.7, 1.3  # powers of what both kinds of cells tell: chosen by twelve captured people, as the steps
LEAST, MOST = 0.07, 2.1
MOST_CELLS = 3e7  # of a grid; hair down to the floor has larger cells


def crowding(points: np.ndarray, widths: np.ndarray, open_to: np.ndarray) -> np.ndarray:
    """Return the light at segments of strands over what cells of `occlusion.CELL` tell of it.

    Args:
        points: Of the strands, metres, [N, K, 3].
        widths: Diameters, [N].
        open_to: The way to where most light comes from, of any length, [N, K, 3].

    Returns:
        Factors, 1 in the mean of what is seen from there, [N, K-1] float32.
    """
    points, widths = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(widths, np.float32)
    way = open_to[:, 1:] + open_to[:, :-1]
    way = (way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-6)).astype(np.float32)
    near, around = (_ahead(points, widths, way, cell) for cell in (CELL, COARSE))
    factors = np.clip((1.0 + around) ** np.float32(AROUND) * (1.0 + near) ** np.float32(-NEAR), LEAST, MOST)
    seen = np.exp(-near)
    found: np.ndarray = factors * np.float32(seen.sum() / max(float((seen * factors).sum()), 1e-6))
    return found


def _ahead(points: np.ndarray, widths: np.ndarray, way: np.ndarray, cell: float) -> np.ndarray:
    """Optical depth of the hair that lies before segments, on the way [N, K-1, 3], as cells of an edge know it, [N, K-1]."""
    from .grid_kernels import fill

    smooth, room = cell == COARSE, float(np.prod(np.ptp(points, (0, 1)) + 4 * COARSE))
    cell = max(cell, (room / MOST_CELLS) ** (1 / 3))
    margin = 2 * cell + STEPS * CELL
    low = points.min((0, 1)) - np.float32(margin)
    grid = np.zeros(np.ceil((points.max((0, 1)) - low + margin) / cell).astype(int), np.float32)
    fill(points, widths, low, np.float32(cell), grid)
    if smooth:
        grid = smooth_grid(grid)
    grid *= np.float32(np.pi / 4 / cell**3)
    total = np.zeros(way.shape[:2], np.float32)
    for place in PLACES:
        start = (points[:, :-1] * np.float32(1.0 - place) + points[:, 1:] * np.float32(place) - low) / np.float32(cell)
        for step in range(1, STEPS + 1):
            at = start + way * np.float32(step * CELL / cell) - np.float32(0.5)
            total += sample(grid[..., None], at.reshape(-1, 3)).reshape(total.shape)
    return total * np.float32(CELL / len(PLACES))
