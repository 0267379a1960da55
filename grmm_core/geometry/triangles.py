"""What the triangles of a mesh say about its surface: normals and areas. Needs numpy only."""

from __future__ import annotations

import numpy as np


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of triangles, counter-clockwise from outside, as long as twice their areas, [F, 3].

    Args:
        vertices: [V, 3].
        faces: [F, 3].
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas of triangles, [F], in the square of the vertices' unit."""
    return 0.5 * np.linalg.norm(face_normals(vertices, faces), axis=1)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals of the vertices, weighted by area, [V, 3]; zero where a vertex has no area around it."""
    normals = spread_to_corners(face_normals(vertices, faces), faces, len(vertices))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def spread_to_corners(values: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Sum what triangles [F, ...] have at each of their vertices, [count, ...]."""
    total = np.zeros((count, *values.shape[1:]), values.dtype)
    for corner in range(3):
        np.add.at(total, faces[:, corner], values)
    return total
