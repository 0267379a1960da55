"""The compiled twins of what shadow maps need (`shadows`). Importing this loads numba.

All arrays are contiguous float32 but for indices.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compute.kernels import compiled

OPTIONS: dict[str, Any] = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
single: Any = np.float32  # mypy cannot follow numpy's kinds of numbers through min and max
_0, _1, _HALF = single(0.0), single(1.0), single(0.5)
_LEVEL = np.float32(0.02)  # change of a face's reciprocal depth that counts as small


@compiled(**OPTIONS)
def draw_map(
    vertices: np.ndarray, faces: np.ndarray, turn: np.ndarray, shift: np.ndarray, focal: float, flat: bool, near: float,
    depth: np.ndarray, crossing: np.ndarray,
) -> int:  # fmt: skip
    """Write the nearest depths of a mesh into a square map, as `geometry.zbuffer.triangle_depth` has them.

    Args:
        vertices: [V, 3].
        faces: [T, 3].
        turn: World to the map's axes, [3, 3].
        shift: Added behind it, [3].
        focal: Pixels; of an orthographic map pixels a metre.
        flat: Whether it is orthographic.
        near: What is nearer is not drawn, metres.
        depth: Written, [R, R]; holds the farthest value before.
        crossing: Written from the start: faces that lie on both sides of `near`, which are not drawn, [T].

    Returns:
        Their number.
    """
    side = depth.shape[0]
    middle, scale, count = np.float32(0.5 * side), np.float32(focal), 0
    seen = np.empty((len(vertices), 3), np.float32)  # column, row, and what is linear on the map
    deep = np.empty(len(vertices), np.bool_)
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        ahead = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2]
        deep[i] = ahead >= near
        linear = ahead if flat else _1 / max(ahead, np.float32(1e-6))
        factor = scale if flat else scale * linear
        seen[i, 0] = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0]) * factor + middle
        seen[i, 1] = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1]) * factor + middle
        seen[i, 2] = linear
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        inside = int(deep[a]) + int(deep[b]) + int(deep[c])
        if inside == 0:
            continue
        if inside < 3:
            crossing[count] = t
            count += 1
            continue
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        low_x, high_x, low_y, high_y = min(ax, bx, cx), max(ax, bx, cx), min(ay, by, cy), max(ay, by, cy)
        if not (high_x > _0 and high_y > _0 and low_x < side and low_y < side):
            continue
        left, right = max(math.ceil(low_x - _HALF), 0), min(math.floor(high_x - _HALF), side - 1)
        top, bottom = max(math.ceil(low_y - _HALF), 0), min(math.floor(high_y - _HALF), side - 1)
        if left > right or top > bottom:
            continue
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == _0:
            continue
        inverse = _1 / area
        # barycentric coordinates of the second and third corner, and how they change by column and row
        u_x, u_y, v_x, v_y = (cy - ay) * inverse, (ax - cx) * inverse, (ay - by) * inverse, (bx - ax) * inverse
        base, to_b, to_c = seen[a, 2], seen[b, 2] - seen[a, 2], seen[c, 2] - seen[a, 2]
        straight = flat or max(abs(to_b), abs(to_c)) < _LEVEL * base
        if straight and not flat:  # a small face: its depth is as good as linear, and needs no division at every pixel
            base, to_b, to_c = _1 / base, _1 / seen[b, 2] - _1 / base, _1 / seen[c, 2] - _1 / base
        dx, dy = np.float32(left) + _HALF - ax, np.float32(top) + _HALF - ay
        for row in range(top, bottom + 1):
            u, v = u_x * dx + u_y * dy, v_x * dx + v_y * dy
            for column in range(left, right + 1):
                if u >= _0 and v >= _0 and u + v <= _1:
                    value = base + u * to_b + v * to_c
                    depth[row, column] = min(depth[row, column], value if straight else _1 / value)
                u += u_x
                v += v_x
            dy += _1
    return count


@compiled(**OPTIONS)
def compared(
    depth: np.ndarray, points: np.ndarray, normals: np.ndarray, lift: float, turn: np.ndarray, shift: np.ndarray, focal: float,
    flat: bool, near: float, seen: np.ndarray,
) -> None:  # fmt: skip
    """Compare points with a map; see `shadows.compared`.

    Args:
        depth: Map, [R, R].
        points: [N, 3].
        normals: [N, 3].
        lift: How far along their normals the points are moved, metres.
        turn: As in `draw_map`.
        shift: As there.
        focal: As there.
        flat: As there.
        near: As there.
        seen: Written, [N].
    """
    side = depth.shape[0]
    middle, scale, far = np.float32(0.5 * side), np.float32(focal), np.float32(side - 1)
    up, wide, closest = np.float32(lift), np.float32(1.5), np.float32(near)
    nearest, farthest = np.empty_like(depth), np.empty_like(depth)
    _extremes(depth, nearest, farthest)
    for i in range(len(points)):
        px, py, pz = points[i, 0] + up * normals[i, 0], points[i, 1] + up * normals[i, 1], points[i, 2] + up * normals[i, 2]
        z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + shift[2]
        factor = scale if flat else scale / max(z, np.float32(1e-4))
        x = (turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + shift[0]) * factor + middle
        y = (turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + shift[1]) * factor + middle
        seen[i] = _1
        if not (z > closest and x >= _1 and y >= _1 and x < far and y < far):
            continue
        left, top = int(x - _HALF), int(y - _HALF)
        if nearest[top, left] >= z:
            continue
        if farthest[top, left] < z:
            seen[i] = _0
            continue
        u, v = x - _HALF - np.float32(left), y - _HALF - np.float32(top)
        total, whole = _0, _0
        for row in range(-1, 3):
            down = max(_0, wide - abs(np.float32(row) - v))
            r = min(max(top + row, 0), side - 1)
            for column in range(-1, 3):
                weight = down * max(_0, wide - abs(np.float32(column) - u))
                whole += weight
                total += weight if depth[r, min(max(left + column, 0), side - 1)] >= z else _0
        seen[i] = total / whole


@compiled(**OPTIONS)
def _extremes(depth: np.ndarray, nearest: np.ndarray, farthest: np.ndarray) -> None:
    """Least and greatest of the 4 x 4 pixels from one before to two after each, [R, R]."""
    side = depth.shape[0]
    low, high = np.empty_like(depth), np.empty_like(depth)
    for row in range(side):
        a, b, c, d = max(row - 1, 0), row, min(row + 1, side - 1), min(row + 2, side - 1)
        for column in range(side):
            low[row, column] = min(depth[a, column], depth[b, column], depth[c, column], depth[d, column])
            high[row, column] = max(depth[a, column], depth[b, column], depth[c, column], depth[d, column])
    for row in range(side):
        for column in range(1, side - 2):
            nearest[row, column] = min(low[row, column - 1], low[row, column], low[row, column + 1], low[row, column + 2])
            farthest[row, column] = max(high[row, column - 1], high[row, column], high[row, column + 1], high[row, column + 2])
        for column in (0, side - 2, side - 1):  # next to the edge everything is compared
            nearest[row, column], farthest[row, column] = _0, np.float32(3e38)
