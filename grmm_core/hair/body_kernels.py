"""The compiled inside of `body`; importing this module loads numba. Arrays are float32 and contiguous."""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled

_OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
F = np.float32
_ONE, _ZERO, _OUTSIDE = F(1.0), F(0.0), F(1e9)
BLOCK = 4  # cells along the side of a block, for which the planes are chosen together


@compiled(**_OPTIONS)
def heights_into(
    points: np.ndarray, normals: np.ndarray, low: np.ndarray, cell: float, reach: float, wanted: np.ndarray,
    heights: np.ndarray, first: int, end: int,
) -> None:  # fmt: skip
    """Mean height of the cells of a grid above planes, near planes far more than others.

    Args:
        points: On the planes, [N, 3].
        normals: Of them, [N, 3].
        low: The first cell, [3].
        cell: Edge of a cell, metres.
        reach: How much farther than the nearest a plane may be that counts, metres.
        wanted: Which blocks of cells are, [X / BLOCK, Y / BLOCK, Z / BLOCK] bool, rounded up; others are left.
        heights: Written, [X, Y, Z].
        first: Block along x.
        end: The one after the last.
    """
    block = BLOCK
    chosen = np.empty(len(points), np.int32)
    for bi in range(first * block, min(end * block, heights.shape[0]), block):
        for bj in range(0, heights.shape[1], block):
            for bk in range(0, heights.shape[2], block):
                if not wanted[bi // block, bj // block, bk // block]:
                    continue
                half = F(0.5 * (block - 1))
                x, y, z = F(bi) + half, F(bj) + half, F(bk) + half
                x, y, z = low[0] + F(cell) * x, low[1] + F(cell) * y, low[2] + F(cell) * z
                nearest = F(1e9)
                for n in range(len(points)):
                    dx, dy, dz = x - points[n, 0], y - points[n, 1], z - points[n, 2]
                    nearest = min(nearest, dx * dx + dy * dy + dz * dz)
                limit = math.sqrt(nearest) + F(2.0) * F(1.7320508) * half * F(cell) + F(reach)
                count = 0
                for n in range(len(points)):
                    dx, dy, dz = x - points[n, 0], y - points[n, 1], z - points[n, 2]
                    if dx * dx + dy * dy + dz * dz < limit * limit:
                        chosen[count] = n
                        count += 1
                for i in range(bi, min(bi + block, heights.shape[0])):
                    for j in range(bj, min(bj + block, heights.shape[1])):
                        for k in range(bk, min(bk + block, heights.shape[2])):
                            x, y, z = low[0] + F(cell) * F(i), low[1] + F(cell) * F(j), low[2] + F(cell) * F(k)
                            total, weights = _ZERO, _ZERO
                            for c in range(count):
                                n = chosen[c]
                                dx, dy, dz = x - points[n, 0], y - points[n, 1], z - points[n, 2]
                                near = _ONE / (dx * dx + dy * dy + dz * dz + F(1e-5))
                                near *= near
                                near *= near
                                weights += near
                                total += near * (dx * normals[n, 0] + dy * normals[n, 1] + dz * normals[n, 2])
                            heights[i, j, k] = total / weights


@compiled(boundscheck=False, error_model="numpy", nogil=True)
def sampled(field: np.ndarray, u: float, v: float, w: float) -> tuple[float, float, float, float]:
    """Height and direction between the cells of a field [X, Y, Z, 4]; as high as can be outside of it."""
    if u < _ZERO or v < _ZERO or w < _ZERO:
        return _OUTSIDE, _ZERO, _ZERO, _ZERO
    i, j, k = int(u), int(v), int(w)
    if i >= field.shape[0] - 1 or j >= field.shape[1] - 1 or k >= field.shape[2] - 1:
        return _OUTSIDE, _ZERO, _ZERO, _ZERO
    u, v, w = u - F(i), v - F(j), w - F(k)
    height, dx, dy, dz = _ZERO, _ZERO, _ZERO, _ZERO
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = (u if a else _ONE - u) * (v if b else _ONE - v) * (w if c else _ONE - w)
                height += share * field[i + a, j + b, k + c, 0]
                dx += share * field[i + a, j + b, k + c, 1]
                dy += share * field[i + a, j + b, k + c, 2]
                dz += share * field[i + a, j + b, k + c, 3]
    return height, dx, dy, dz


@compiled(**_OPTIONS)
def push(
    field: np.ndarray, low: np.ndarray, cell: float, buried: float, wanted: np.ndarray, rounds: int, points: np.ndarray,
    first: int, end: int,
) -> None:  # fmt: skip
    """Move points out of a body, as `Body.pushed` says.

    Args:
        field: Of the body, [X, Y, Z, 4].
        low: The first cell's centre, [3].
        cell: Edge of a cell, metres.
        buried: Metres below the skin from where on points are left.
        wanted: Height of each point, [N, K].
        rounds: Times that a point is moved at most.
        points: Strands, moved but for their roots, [N, K, 3].
        first: Strand.
        end: The one after the last.
    """
    for n in range(first, end):
        for m in range(1, points.shape[1]):
            for _ in range(rounds):
                u = (points[n, m, 0] - low[0]) / cell
                v = (points[n, m, 1] - low[1]) / cell
                w = (points[n, m, 2] - low[2]) / cell
                height, dx, dy, dz = sampled(field, u, v, w)
                if height >= wanted[n, m] or height < -buried:
                    break
                out = (wanted[n, m] - height) / max(math.sqrt(dx * dx + dy * dy + dz * dz), F(1e-6))
                points[n, m, 0] += out * dx
                points[n, m, 1] += out * dy
                points[n, m, 2] += out * dz
