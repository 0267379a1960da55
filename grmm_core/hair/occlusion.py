"""How much light reaches the inside of a groom: openness on average and its gradient, from the strands at rest.

Hair is a cloud of fine cylinders on a grid of cells, the head a solid. Light that comes from each of some directions is
dimmed by what it passes. The part that arrives, as a function of the direction, is kept in two terms: its mean, and three
numbers that say towards where it is more (the first two bands of spherical harmonics). Made once per groom; needs numba.
"""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from .grids import sample, smooth_grid

CELL = 0.006  # metres
REACH = 0.16  # metres that light is followed
DIRECTIONS = 26
SOLID = 400.0  # 1/m: extinction inside the head
FINE = 0.55  # of the extinction of evenly spread cylinders: strands lie in locks, with gaps between
_MARGIN = 2  # cells around the hair
_SUNK = 0.004  # metres below the skin where the solid begins


def openness(points: np.ndarray, widths: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return how open the surroundings of strands are.

    Args:
        points: Of the strands, metres, [N, K, 3].
        widths: Diameters, [N].
        vertices: Of the head, metres, [V, 3].
        faces: Its triangles, [F, 3].

    Returns:
        Mean over all directions of the light that arrives, 0..1, and its gradient: with a unit vector l, the light from l is
        about [0] + [1:] @ l. [N, K, 4] float32.
    """
    from ..compute.threads import for_rows
    from .grid_kernels import march

    flat = points.reshape(-1, 3)
    low = flat.min(0) - _MARGIN * CELL
    size = np.ceil((flat.max(0) - low) / CELL).astype(int) + _MARGIN
    step = np.linalg.norm(np.diff(points, axis=1), axis=2) * widths[:, None]  # [N, K-1] shadow of each segment
    middle = 0.5 * (points[:, 1:] + points[:, :-1])
    cells = ((middle.reshape(-1, 3) - low) / CELL).astype(int)
    number = np.ravel_multi_index(tuple(cells.T), tuple(size))
    filled = np.bincount(number, step.ravel(), int(size.prod())).reshape(size) * (FINE * np.pi / 4 / CELL**3)
    thick = smooth_grid(filled)
    head = _inside(low, size, vertices, faces)
    dim = thick + SOLID * head
    wanted = np.flatnonzero((smooth_grid(thick) > 0).ravel())
    places = np.stack(np.unravel_index(wanted, tuple(size)), 1).astype(np.float32) + 0.5
    directions = directions_over(DIRECTIONS)
    seen = np.empty((len(wanted), 4), np.float32)
    for_rows(march, len(places), np.ascontiguousarray(dim, np.float32), places, directions, int(REACH / CELL), CELL, seen)
    result = np.zeros((int(size.prod()), 4), np.float32)
    result[wanted] = seen
    result = result.reshape(*size, 4)
    return sample(result, (flat - low) / CELL - 0.5).reshape(*points.shape[:2], 4)


def directions_over(count: int) -> np.ndarray:
    """Unit vectors spread evenly over the sphere (a Fibonacci lattice), float32 [count, 3]."""
    i = np.arange(count) + 0.5
    y, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(angle), y, r * np.sin(angle)], 1).astype(np.float32)


def _inside(low: np.ndarray, size: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which cells lie behind the skin as seen from both sides along x and along z."""
    corners = np.asarray(vertices, float)[np.asarray(faces)]
    inside = np.ones(tuple(size), bool)
    centres = [low[k] + (np.arange(size[k]) + 0.5) * CELL for k in range(3)]
    for axis, across in ((0, 2), (2, 0)):
        for sign in (1.0, -1.0):
            matrix = np.zeros((4, 4))
            matrix[0, across], matrix[1, 1], matrix[2, axis], matrix[3, 3] = 1.0, 1.0, sign, 1.0
            matrix[2, 3] = 10.0  # everything is in front
            camera = Camera(
                matrix,
                1 / CELL,
                1 / CELL,
                -low[across] / CELL,
                -low[1] / CELL,
                int(size[across]),
                int(size[1]),
                orthographic=True,
            )
            depth = triangle_depth(corners, camera)  # [y, across]
            behind = sign * centres[axis][:, None, None] + 10.0 > depth[None] + _SUNK  # [axis, y, across]
            inside &= behind.transpose(0, 1, 2) if axis == 0 else behind.transpose(2, 1, 0)
    return inside
