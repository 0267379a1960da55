"""Flattening a disk-shaped piece of any triangle mesh without overlaps and with a wanted density.

Tutte's theorem: where the boundary is fixed to a strictly convex curve and every inner vertex is a positive mixture of its
neighbours, no triangle turns over, whatever the shape is. The mixtures are then adjusted so that texels become as large as
wanted (after Yoshizawa, Belyaev and Seidel 2004), which keeps them positive. Called by `flame_uv`; needs numpy only: the
equations are symmetric and solved by conjugate gradients, so that every machine gets the same layout.
"""

from __future__ import annotations

import numpy as np

from ..geometry.triangles import face_areas, spread_to_corners
from .uv_islands import signed_areas

POWER = 4.0  # of the outline, |x|^p + |y|^p = 1: nearly a box, yet strictly convex
_ROUNDS = 9
_STEP = 0.6
_LIMIT = 8.0  # largest change of one round
_ROUGH, _EXACT = 1e-5, 1e-11  # error of the equations, outline's width = 1
_TRIES = 3
_MIN_AREA = 1e-9  # of the whole
_MAX_ITERATIONS = 4000
_MIN_COTANGENT = 0.05
_OUTLINE_SAMPLES = 8192


def fill_holes(points: np.ndarray, faces: np.ndarray, loops: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Close boundary loops with fans around a new vertex each: more points and triangles at the ends of both arrays."""
    for loop in loops:
        hub = len(points)
        points = np.concatenate([points, points[loop].mean(0, keepdims=True)])
        faces = np.concatenate([faces, np.stack([np.roll(loop, -1), loop, np.full(len(loop), hub)], 1)])
    return points, faces


def outline(share: np.ndarray, width: float, height: float, power: float = POWER) -> np.ndarray:
    """Points of the convex outline at shares [n] of its length, counter-clockwise from the bottom's middle, [n, 2]."""
    angle = np.linspace(-0.5 * np.pi, 1.5 * np.pi, _OUTLINE_SAMPLES + 1)
    cosine, sine = np.cos(angle), np.sin(angle)
    radius = (np.abs(cosine) ** power + np.abs(sine) ** power) ** (-1 / power)
    curve = 0.5 * radius[:, None] * np.stack([width * cosine, height * sine], 1)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    where = np.interp(np.asarray(share) * length[-1], length, angle)
    cosine, sine = np.cos(where), np.sin(where)
    radius = (np.abs(cosine) ** power + np.abs(sine) ** power) ** (-1 / power)
    return 0.5 * radius[:, None] * np.stack([width * cosine, height * sine], 1)


def flatten_disk(
    points: np.ndarray, faces: np.ndarray, loop: np.ndarray, rim: np.ndarray, density: np.ndarray, rounds: int = _ROUNDS
) -> np.ndarray | None:
    """Place a disk in the plane.

    Args:
        points: Metres, [n, 3].
        faces: Every vertex is used, [m, 3].
        loop: The one boundary, in the triangles' direction, [b].
        rim: Where it goes: counter-clockwise on a strictly convex curve, [b, 2].
        density: Wanted texels per metre of each triangle, any unit, [m].
        rounds: How often the mixtures are adjusted.

    Returns:
        [n, 2]; None where rounding turned a triangle over in every round (a piece that should be cut).
    """
    inside = np.ones(len(points), bool)
    inside[loop] = False
    low, high, spring = _springs(points, faces)
    factor = np.ones(len(points))
    plane = np.zeros((len(points), 2))
    plane[inside] = rim.mean(0)
    plane[loop] = rim
    area = face_areas(points, faces)
    tried: list[tuple[float, np.ndarray]] = []  # stretch and factors of each round
    for _ in range(rounds + 1):
        plane = _solve(low, high, spring * factor[low] * factor[high], plane, inside, _ROUGH)
        flat = signed_areas(plane, faces)
        # the solution is rough: slightly turned triangles are looked at again below
        stretch = _stretch(points, faces, plane, np.maximum(flat, _MIN_AREA * flat.sum())) * density  # [m], wanted equal
        tried.append((float((area * stretch**2).sum()), factor))
        at_vertex, share = (spread_to_corners(part, faces, len(points)) for part in (area * stretch**2, area))
        local = np.sqrt(at_vertex / np.maximum(share, 1e-30))
        local /= np.exp(np.log(np.maximum(local, 1e-30)).mean())
        factor = factor / np.clip(local, 1 / _LIMIT, _LIMIT) ** _STEP
    order = sorted(range(len(tried)), key=lambda i: tried[i][0])
    for index in [*order[:_TRIES], 0]:
        factor = tried[index][1]
        plane = _solve(low, high, spring * factor[low] * factor[high], plane, inside, _EXACT)
        if (signed_areas(plane, faces) > 0).all():
            return plane
    return None


def stretch_values(points: np.ndarray, faces: np.ndarray, plane: np.ndarray, flat: np.ndarray | None = None) -> np.ndarray:
    """Singular values of the map from the plane to space per triangle, largest first, [m, 2]; `flat` replaces the areas."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    p, q, r = (plane[faces[:, k]] for k in range(3))
    double = 2 * (signed_areas(plane, faces) if flat is None else flat)
    along_u = (a * (q - r)[:, 1:] + b * (r - p)[:, 1:] + c * (p - q)[:, 1:]) / double[:, None]
    along_v = (a * (r - q)[:, :1] + b * (p - r)[:, :1] + c * (q - p)[:, :1]) / double[:, None]
    uu, uv, vv = ((x * y).sum(1) for x, y in ((along_u, along_u), (along_u, along_v), (along_v, along_v)))
    root = np.sqrt((uu - vv) ** 2 + 4 * uv**2)
    return np.sqrt(np.maximum(np.stack([uu + vv + root, uu + vv - root], 1) / 2, 0.0))


def _stretch(points: np.ndarray, faces: np.ndarray, plane: np.ndarray, flat: np.ndarray) -> np.ndarray:
    return np.sqrt((stretch_values(points, faces, plane, flat) ** 2).mean(1))


def _springs(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Undirected edges and positive weights: cotangents, which keep angles, where they are positive."""
    low, high, value = [], [], []
    for k in range(3):
        at, one, two = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        first, second = points[one] - points[at], points[two] - points[at]
        sine = np.linalg.norm(np.cross(first, second), axis=1)
        cotangent = (first * second).sum(1) / np.maximum(sine, 1e-12)
        low.append(np.minimum(one, two))
        high.append(np.maximum(one, two))
        value.append(np.clip(cotangent, _MIN_COTANGENT, 10.0))
    pairs = np.stack([np.concatenate(low), np.concatenate(high)], 1)
    unique, index = np.unique(pairs, axis=0, return_inverse=True)
    return unique[:, 0], unique[:, 1], np.bincount(index.reshape(-1), np.concatenate(value), len(unique))


def _solve(
    low: np.ndarray, high: np.ndarray, weight: np.ndarray, start: np.ndarray, inside: np.ndarray, tolerance: float
) -> np.ndarray:
    """Conjugate gradients for the springs' balance, the rim held; [n, 2]."""
    count = len(start)
    ends, others, doubled = np.r_[low, high], np.r_[high, low], np.r_[weight, weight]
    degree = np.bincount(ends, doubled, count)[:, None]
    free = inside[:, None].astype(float)

    def balance(x: np.ndarray) -> np.ndarray:
        pulled = np.stack([np.bincount(ends, doubled * x[others, k], count) for k in range(2)], 1)
        return (degree * x - pulled) * free

    plane = start.copy()
    residual = -balance(plane)
    scaled = residual / np.maximum(degree, 1e-300)
    direction = scaled.copy()
    energy = (residual * scaled).sum(0)
    goal = float(degree.sum()) * tolerance**2
    for _ in range(_MAX_ITERATIONS):
        if float(energy.max()) <= goal:
            break
        moved = balance(direction)
        step = energy / np.maximum((direction * moved).sum(0), 1e-300)
        plane += step * direction
        residual -= step * moved
        scaled = residual / np.maximum(degree, 1e-300)
        following = (residual * scaled).sum(0)
        direction = scaled + following / np.maximum(energy, 1e-300) * direction
        energy = following
    return plane
