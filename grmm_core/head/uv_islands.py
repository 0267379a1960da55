"""Islands of a texture layout, and the layout that they make together.

One text for the user's FLAME (`flame_uv`) and for the open head's builder (`tools/open_head`). Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class UVLayout:
    """Texture coordinates.

    Attributes:
        uv: (0, 0) lower left, float32, [T, 2].
        faces: Rows of `uv` for each triangle's corners, int32, [F, 3].
        islands: Number of each triangle's island, 0 is the skin, [F].
        names: What each island belongs to.
    """

    uv: np.ndarray
    faces: np.ndarray
    islands: np.ndarray
    names: tuple[str, ...]


@dataclass
class Island:
    """A piece of the mesh, laid flat.

    Attributes:
        name: What it belongs to.
        triangles: Numbers of the mesh's faces, [m].
        plane: Metres times density, [n, 2].
        corners: Rows of `plane` for each triangle's corners, [m, 3].
    """

    name: str
    triangles: np.ndarray
    plane: np.ndarray
    corners: np.ndarray


def signed_areas(plane: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas of triangles [m, 3] in the plane [n, 2], negative where they run clockwise, [m]."""
    first = plane[corners[:, 1]] - plane[corners[:, 0]]
    second = plane[corners[:, 2]] - plane[corners[:, 0]]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def counter_clockwise(plane: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the plane, mirrored where its triangles run clockwise."""
    return plane * (-1, 1) if signed_areas(plane, corners).sum() < 0 else plane


def join_islands(islands: Sequence[Island], planes: Sequence[np.ndarray], count: int) -> UVLayout:
    """Make one layout of islands.

    Args:
        islands: Together they have every triangle once.
        planes: Where each island's `plane` goes in the unit square, [n, 2] each.
        count: Triangles of the mesh.
    """
    faces, numbers = np.zeros((count, 3), np.int32), np.zeros(count, np.int32)
    start = 0
    for number, (island, plane) in enumerate(zip(islands, planes, strict=True)):
        faces[island.triangles] = island.corners + start
        numbers[island.triangles] = number
        start += len(plane)
    return UVLayout(np.concatenate(planes).astype(np.float32), faces, numbers, tuple(island.name for island in islands))
