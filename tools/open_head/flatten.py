"""Flattening one disk-shaped island with bounded distortion and a wanted texel density.

Tutte's embedding in a circle, then scalable locally injective mappings (Rabinovich et al. 2017, "Scalable Locally Injective
Mappings") on the symmetric Dirichlet energy against each triangle's own shape scaled by its density. Line searches never let
a triangle flip, so the island has no local overlap. Soft terms pull chosen boundary vertices to the sides of a box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

FILLER_WEIGHT = 0.05  # of triangles that only close a hole
HOLE_ASPECT = 0.3
Side = tuple[np.ndarray, int, float]
"""Vertices, coordinate (0: u, 1: v) and the value that it is pulled to."""


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Closed loops of boundary vertices, longest first, in the direction of the faces' edges."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    known = {(int(a), int(b)) for a, b in edges}
    following = {a: b for a, b in known if (b, a) not in known}
    loops = []
    while following:
        start, current = next(iter(following.items()))
        del following[start]
        loop = [start]
        while current != start:
            loop.append(current)
            current = following.pop(current)
        loops.append(np.array(loop))
    return sorted(loops, key=len, reverse=True)


def flatten(
    vertices: np.ndarray,
    faces: np.ndarray,
    density: np.ndarray,
    *,
    outer: np.ndarray | None = None,
    sides: Sequence[Side] = (),
    pull: float = 0.0,
    steps: int = 40,
    stiffness: np.ndarray | None = None,
) -> np.ndarray:
    """Flatten an island.

    Args:
        vertices: Positions in metres, [n, 3].
        faces: Triangles of a disk, possibly with holes, [m, 3].
        density: Wanted length in the plane per metre on the surface, for each triangle, [m].
        outer: The outer boundary loop, in face order; the longest loop where None. Its first vertex starts at -90 degrees.
        sides: Vertices softly held to a side of a box.
        pull: Strength of `sides`, relative to the energy.
        steps: Iterations.
        stiffness: How much each triangle resists distortion, [m]; 1 everywhere where None.

    Returns:
        Plane coordinates, [n, 2], counter-clockwise triangles.
    """
    loops = boundary_loops(faces)
    outer = loops[0] if outer is None else outer
    holes = [loop for loop in loops if not np.isin(loop, outer).any()]
    local = _local_shapes(vertices, faces) * density[:, None, None]
    weights = np.ones(len(faces)) if stiffness is None else stiffness.astype(float)
    count = len(vertices)
    fillers = []
    for loop in holes:
        following = np.roll(loop, -1)
        fillers.append(np.stack([following, loop, np.full(len(loop), count)], 1))
        rim = _ellipse(vertices[loop]) * density.max()
        # triangle (following, this, centre) of a convex rim that runs clockwise around the hole
        shape = np.stack([rim - np.roll(rim, -1, 0), -np.roll(rim, -1, 0)], -1)
        local = np.concatenate([local, shape])
        weights = np.concatenate([weights, np.full(len(loop), FILLER_WEIGHT)])
        count += 1
    closed = np.concatenate([faces, *fillers]) if fillers else faces
    area = 0.5 * np.linalg.det(local)
    inverse = np.linalg.inv(local)
    weights = weights * area / area.sum()
    plane = _tutte(closed, count, outer) * np.sqrt(area[: len(faces)].sum() / np.pi) * 1.3
    gradient = _gradient_matrices(closed, inverse, count)
    for step in range(steps):
        strength = pull * min(1.0, (step + 1) / (0.5 * steps))
        plane = _slim_step(plane, closed, gradient, inverse, weights, sides, strength)
    return plane[: len(vertices)]


def distortion(vertices: np.ndarray, faces: np.ndarray, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (large, small) of the map from the surface to the plane, for each triangle, [m] each."""
    jacobian = _edges(plane, faces) @ np.linalg.inv(_local_shapes(vertices, faces))
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values[:, 0], values[:, 1]


def _local_shapes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Edge vectors of each triangle in its own plane, as columns, [m, 2, 2]."""
    first, second = vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    length = np.maximum(np.linalg.norm(first, axis=1), 1e-6)
    axis = first / length[:, None]
    along = (second * axis).sum(1)
    height = np.linalg.norm(second - along[:, None] * axis, axis=1)
    height = np.maximum(height, 0.02 * length)  # slivers would dominate the energy
    shape = np.zeros((len(faces), 2, 2))
    shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1] = length, along, height
    return shape


def _ellipse(loop: np.ndarray) -> np.ndarray:
    """Wanted shape of a hole's rim in the plane: a flat ellipse of the same length, its ends at the loop's, [k, 2]."""
    steps = np.linalg.norm(np.roll(loop, -1, 0) - loop, axis=1)
    passed = np.r_[0.0, np.cumsum(steps)[:-1]] / steps.sum()
    phase = passed[int(np.argmax(loop[:, 0]))]
    angle = -2 * np.pi * (passed - phase)
    radius = steps.sum() / 4.4
    return radius * np.stack([np.cos(angle), HOLE_ASPECT * np.sin(angle)], 1)


def _edges(plane: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = plane[faces]
    return np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], -1)


def _tutte(faces: np.ndarray, count: int, outer: np.ndarray) -> np.ndarray:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    adjacency = sparse.coo_matrix((np.ones(len(edges)), edges.T), (count, count)).tocsr()
    adjacency = ((adjacency + adjacency.T) > 0).astype(float)
    laplacian = sparse.diags(np.asarray(adjacency.sum(1)).ravel()) - adjacency
    plane = np.zeros((count, 2))
    angle = 2 * np.pi * np.arange(len(outer)) / len(outer) - np.pi / 2
    plane[outer] = np.stack([np.cos(angle), np.sin(angle)], 1)
    inner = np.setdiff1d(np.unique(faces), outer)
    plane[inner] = linalg.spsolve(laplacian[inner][:, inner].tocsc(), -laplacian[inner][:, outer] @ plane[outer])
    return plane


def _gradient_matrices(faces: np.ndarray, inverse: np.ndarray, count: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Two matrices [m, count]: derivatives of a plane coordinate along the two axes of each triangle's own plane."""
    result = []
    rows = np.repeat(np.arange(len(faces)), 3)
    for axis in range(2):
        coefficients = np.stack([-inverse[:, 0, axis] - inverse[:, 1, axis], inverse[:, 0, axis], inverse[:, 1, axis]], 1)
        result.append(sparse.csr_matrix((coefficients.ravel(), (rows, faces.ravel())), (len(faces), count)))
    return result[0], result[1]


def _energy(
    plane: np.ndarray, faces: np.ndarray, inverse: np.ndarray, weights: np.ndarray, sides: Sequence[Side], pull: float
) -> float:
    jacobian = _edges(plane, faces) @ inverse
    determinant = np.linalg.det(jacobian)
    if determinant.min() <= 0:
        return np.inf
    square = (jacobian**2).sum((1, 2))
    value = float((weights * square * (1 + 1 / determinant**2)).sum())
    return value + pull * sum(float(((plane[which, axis] - at) ** 2).sum()) for which, axis, at in sides)


def _slim_step(
    plane: np.ndarray,
    faces: np.ndarray,
    gradient: tuple[sparse.csr_matrix, sparse.csr_matrix],
    inverse: np.ndarray,
    weights: np.ndarray,
    sides: Sequence[Side],
    pull: float,
) -> np.ndarray:
    jacobian = _edges(plane, faces) @ inverse
    left, values, right = np.linalg.svd(jacobian)
    rotation = left @ right
    values = np.clip(values, 1e-4, 1e4)
    # proxy weights of the symmetric Dirichlet energy; the limit at 1 is 2
    difference = np.where(np.abs(values - 1) < 1e-5, 1.0, values - 1)
    proxy = np.sqrt(np.where(np.abs(values - 1) < 1e-5, 4.0, (values - values**-3) / difference))
    metric = left @ (proxy[..., None] * left.transpose(0, 2, 1))  # [m, 2, 2]
    root = np.sqrt(weights)
    blocks, right_side = [], []
    wanted = metric @ rotation
    for axis in range(2):
        for row in range(2):
            scaled = [sparse.diags(root * metric[:, row, component]) @ gradient[axis] for component in range(2)]
            blocks.append(sparse.hstack(scaled))
            right_side.append(root * wanted[:, row, axis])
    count = len(plane)
    if pull > 0:
        for which, axis, at in sides:
            columns = which + axis * count
            entries = np.full(len(which), np.sqrt(pull))
            blocks.append(sparse.csr_matrix((entries, (np.arange(len(which)), columns)), (len(which), 2 * count)))
            right_side.append(np.full(len(which), np.sqrt(pull) * at))
    matrix = sparse.vstack(blocks).tocsc()
    normal = matrix.T @ matrix
    small = 1e-9 * normal.diagonal().mean()
    flat = plane.T.ravel()
    target = matrix.T @ np.concatenate(right_side) + small * flat
    solution = linalg.spsolve((normal + small * sparse.identity(2 * count)).tocsc(), target)
    direction = solution.reshape(2, count).T - plane
    step = min(1.0, 0.9 * _largest_step(plane, direction, faces))
    before = _energy(plane, faces, inverse, weights, sides, pull)
    for _ in range(30):
        candidate = plane + step * direction
        if _energy(candidate, faces, inverse, weights, sides, pull) < before:
            return candidate
        step *= 0.6
    return plane


def _largest_step(plane: np.ndarray, direction: np.ndarray, faces: np.ndarray) -> float:
    """Smallest positive t at which a triangle of plane + t direction has no area."""
    a, b = _edges(plane, faces), _edges(direction, faces)
    quadratic = np.linalg.det(b)
    constant = np.linalg.det(a)
    linear = a[:, 0, 0] * b[:, 1, 1] + b[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * b[:, 1, 0] - b[:, 0, 1] * a[:, 1, 0]
    quadratic = np.where(np.abs(quadratic) < 1e-20, 1e-20, quadratic)
    discriminant = linear**2 - 4 * quadratic * constant
    root = np.sqrt(np.maximum(discriminant, 0))
    roots = np.stack([(-linear - root) / (2 * quadratic), (-linear + root) / (2 * quadratic)])
    roots[:, discriminant < 0] = np.inf
    roots[roots <= 0] = np.inf
    return float(min(roots.min(), 1e6))
