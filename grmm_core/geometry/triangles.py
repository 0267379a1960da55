"""What the triangles of a mesh say about its surface: normals, areas, nearest points. Needs numpy only."""

from __future__ import annotations

import numpy as np

_POINTS = 256  # that are compared with all triangles at a time


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


def closest_on_surface(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest triangle of each point, [n], barycentric coordinates there, [n, 3], and distances in metres, [n]."""
    corners = np.moveaxis(vertices[faces], 1, 0)  # [3, F, 3]
    first, second = corners[1:] - corners[0]
    d11, d12, d22 = (first**2).sum(1), (first * second).sum(1), (second**2).sum(1)
    determinant = np.maximum(d11 * d22 - d12**2, 1e-30)
    centers = corners.mean(0)
    radii = np.linalg.norm(corners - centers, axis=2).max(0)
    triangles, coordinates, distances = np.zeros(len(points), np.int32), np.zeros((len(points), 3)), np.zeros(len(points))
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) // _POINTS)):
        if not len(rows):
            continue
        apart = np.linalg.norm(points[rows, None] - centers, axis=2)
        # only these can be nearest: the nearest center is on a triangle itself
        row, face = np.nonzero(apart - radii <= apart.min(1, keepdims=True))
        arm = points[rows[row]] - corners[0, face]
        e1, e2 = (arm * first[face]).sum(1), (arm * second[face]).sum(1)
        v = (d22[face] * e1 - d12[face] * e2) / determinant[face]
        w = (d11[face] * e2 - d12[face] * e1) / determinant[face]
        # outside a triangle the clipped coordinates are near enough: its neighbour is nearer anyway
        inside = np.maximum(np.stack([1 - v - w, v, w], 1), 0.0)
        inside /= inside.sum(1, keepdims=True)
        gap = np.linalg.norm(np.einsum("nk,knx->nx", inside, corners[:, face]) - points[rows[row]], axis=1)
        order = np.lexsort((face, gap, row))
        best = order[np.searchsorted(row[order], np.arange(len(rows)))]
        triangles[rows], coordinates[rows], distances[rows] = face[best], inside[best], gap[best]
    return triangles, coordinates, distances
