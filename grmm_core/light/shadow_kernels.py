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
_0, _1, _2, _HALF, _MOST = single(0.0), single(1.0), single(2.0), single(0.5), single(1.5)
_B = 64  # points of a block
_LEVEL = np.float32(0.02)  # change of a face's reciprocal depth that counts as small


@compiled(**OPTIONS)
def draw_map(
    vertices: np.ndarray, faces: np.ndarray, closed: int, turn: np.ndarray, shift: np.ndarray, focal: float, flat: bool,
    near: float, depth: np.ndarray, empty: float, crossing: np.ndarray,
) -> int:  # fmt: skip
    """Write the nearest depths of a mesh into a square map, as `geometry.zbuffer.triangle_depth` has them.

    Args:
        vertices: [V, 3].
        faces: [T, 3].
        closed: Of them the first ones, of which only those that face the map are drawn.
        turn: World to the map's axes, [3, 3].
        shift: Added behind it, [3].
        focal: Pixels; of an orthographic map pixels a metre.
        flat: Whether it is orthographic.
        near: What is nearer is not drawn, metres.
        depth: Written, [R, R].
        empty: Depth where nothing is.
        crossing: Written from the start: faces that lie on both sides of `near`, which are not drawn, [T].

    Returns:
        Their number.
    """
    side = depth.shape[0]
    middle, scale, far, count = np.float32(0.5 * side), np.float32(focal), np.float32(empty), 0
    depth[:] = far
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
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == _0 or (t < closed and area > _0):  # rows count downwards: seen from outside, corners run clockwise
            continue
        low_x, high_x, low_y, high_y = min(ax, bx, cx), max(ax, bx, cx), min(ay, by, cy), max(ay, by, cy)
        if not (high_x > _0 and high_y > _0 and low_x < side and low_y < side):
            continue
        left, right = max(math.ceil(low_x - _HALF), 0), min(math.floor(high_x - _HALF), side - 1)
        top, bottom = max(math.ceil(low_y - _HALF), 0), min(math.floor(high_y - _HALF), side - 1)
        if left > right or top > bottom:
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
            for column in range(left, right + 1):  # without branches, which small faces would take at random
                value = base + u * to_b + v * to_c
                value = value if straight else _1 / value
                depth[row, column] = min(depth[row, column], value if min(u, v, _1 - u - v) >= _0 else far)
                u += u_x
                v += v_x
            dy += _1
    return count


@compiled(inline="always", **OPTIONS)
def _on_map(turn: np.ndarray, shift: np.ndarray, focal: float, flat: bool, x: float, y: float, z: float) -> tuple[Any, ...]:
    """Column and row of a point from the middle of a map, and its depth."""
    deep = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2]
    scale = focal if flat else focal / max(deep, np.float32(1e-4))
    return (
        (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0]) * scale,
        (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1]) * scale, deep,
    )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _tent(depth: np.ndarray, top: int, left: int, u: float, v: float, z: float, right: float, down: float) -> float:
    """Share of the 4 x 4 pixels around a place, by a tent of 3 pixels, whose depth is not less than a plane's.

    The plane is `z` deep at the place and changes by `right` and `down` for each pixel.
    """
    # the tent at the four columns: 1.5 less their distances
    a, b, c, d = max(_HALF - u, _0), _MOST - u, _HALF + u, max(u - _HALF, _0)
    total = _0
    for row in range(4):
        r, way = top + row - 1, np.float32(row - 1) - v
        level = z + way * down - u * right
        total += max(_MOST - abs(way), _0) * (
            (a if depth[r, left - 1] >= level - right else _0) + (b if depth[r, left] >= level else _0)
            + (c if depth[r, left + 1] >= level + right else _0) + (d if depth[r, left + 2] >= level + _2 * right else _0)
        )  # fmt: skip
    return total / ((a + b + c + d) * (max(_HALF - v, _0) + _2 + max(v - _HALF, _0)))


@compiled(**OPTIONS)
def compared(
    depths: np.ndarray, turns: np.ndarray, shifts: np.ndarray, focals: np.ndarray, flat: bool, near: float, limits: np.ndarray,
    points: np.ndarray, normals: np.ndarray, rows: np.ndarray, seen: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Compare points with maps; see `shadows.compared`, whose mean over the maps this is.

    Args:
        depths: Maps, [K, R, R].
        turns: Of each map as in `draw_map`, [K, 3, 3].
        shifts: Likewise, [K, 3].
        focals: Likewise, [K].
        flat: As there.
        near: As there.
        limits: `_BIAS`, `_LIFT`, `_AWAY` and `_STEEP` of `shadows`, [4].
        points: [N, 3].
        normals: [N, 3].
        rows: Of the points, [M].
        seen: Written at these rows, [N].
        first: Row of `rows`.
        last: The row after the last.
    """
    side = depths.shape[1]
    middle, far, closest = np.float32(0.5 * side), np.float32(side - 2), np.float32(near)
    least, lift, limit, steep = limits[0], limits[1], limits[2], limits[3]
    share = _1 / np.float32(len(depths))
    w = np.empty(13 * _B, np.float32)
    for start in range(first, last, _B):
        for j in range(_B):
            i = rows[min(start + j, last - 1)]
            w[j], w[_B + j], w[2 * _B + j] = points[i, 0], points[i, 1], points[i, 2]
            w[3 * _B + j], w[4 * _B + j], w[5 * _B + j] = normals[i, 0], normals[i, 1], normals[i, 2]
            w[6 * _B + j] = _0
        for k in range(len(depths)):
            depth, scale = depths[k], focals[k]
            ax, ay, az, a = turns[k, 0, 0], turns[k, 0, 1], turns[k, 0, 2], shifts[k, 0]
            bx, by, bz, b = turns[k, 1, 0], turns[k, 1, 1], turns[k, 1, 2], shifts[k, 1]
            cx, cy, cz, c = turns[k, 2, 0], turns[k, 2, 1], turns[k, 2, 2], shifts[k, 2]
            finest = _1 / scale
            straight = np.float32(flat)
            for j in range(_B):  # all at once
                px, py, pz, nx, ny, nz = w[j], w[_B + j], w[2 * _B + j], w[3 * _B + j], w[4 * _B + j], w[5 * _B + j]
                ahead = cx * nx + cy * ny + cz * nz
                z = cx * px + cy * py + cz * pz + c
                pixel = finest * (straight + (_1 - straight) * max(z, _0))
                level = min(max(-ahead / steep, _0), _1)  # how far the plane of the surface is followed
                up = least + (_1 + level * (lift - _1)) * pixel * math.sqrt(max(_1 - ahead * ahead, _0))
                z += up * ahead
                to_map = scale * (straight + (_1 - straight) / max(z, np.float32(1e-4)))
                across, down = ax * nx + ay * ny + az * nz, bx * nx + by * ny + bz * nz
                level *= pixel / max(-ahead, steep)
                w[7 * _B + j] = (ax * px + ay * py + az * pz + a + up * across) * to_map + middle
                w[8 * _B + j] = (bx * px + by * py + bz * pz + b + up * down) * to_map + middle
                w[9 * _B + j], w[10 * _B + j], w[11 * _B + j] = z, level * across, level * down
                w[12 * _B + j] = ahead
            for j in range(min(_B, last - start)):
                if w[12 * _B + j] > limit:
                    continue
                x, y, z = w[7 * _B + j], w[8 * _B + j], w[9 * _B + j]
                if not (z > closest and x >= _2 and y >= _2 and x < far and y < far):
                    w[6 * _B + j] += share
                    continue
                left, top, right, down = int(x - _HALF), int(y - _HALF), w[10 * _B + j], w[11 * _B + j]
                u, v = x - _HALF - np.float32(left), y - _HALF - np.float32(top)
                w[6 * _B + j] += share * _tent(depth, top, left, u, v, z, right, down)
        for j in range(min(_B, last - start)):
            seen[rows[start + j]] = w[6 * _B + j]


@compiled(**OPTIONS)
def softly(
    depths: np.ndarray, turns: np.ndarray, shifts: np.ndarray, focals: np.ndarray, flat: bool, near: float, limits: np.ndarray,
    points: np.ndarray, seen: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """How far points in hair are lit; see `shadows.softly`, whose limits these are, [2]. The rest as of `compared`."""
    side = depths.shape[1]
    middle, far, closest = np.float32(0.5 * side), np.float32(side - 2), np.float32(near)
    dark = limits[1]
    share, slope = _1 / np.float32(len(depths)), _1 / (dark - limits[0])
    for i in range(first, last):
        total = _0
        for k in range(len(depths)):
            x, y, z = _on_map(turns[k], shifts[k], focals[k], flat, points[i, 0], points[i, 1], points[i, 2])
            x, y, level = x + middle, y + middle, z - dark
            if not (z > closest and x >= _2 and y >= _2 and x < far and y < far):
                total += share
                continue
            left, top = int(x - _HALF), int(y - _HALF)
            u, v = x - _HALF - np.float32(left), y - _HALF - np.float32(top)
            above = (_1 - u) * _lit(depths[k, top, left] - level, slope) + u * _lit(depths[k, top, left + 1] - level, slope)
            top += 1
            below = (_1 - u) * _lit(depths[k, top, left] - level, slope) + u * _lit(depths[k, top, left + 1] - level, slope)
            total += share * ((_1 - v) * above + v * below)
        seen[i] = total


@compiled(inline="always", **OPTIONS)
def _lit(beyond: float, slope: float) -> float:
    return min(max(beyond * slope, _0), _1)


@compiled(**OPTIONS)
def same_around(some: np.ndarray, between: np.ndarray, alike: float, known: np.ndarray, left: np.ndarray) -> int:
    """Write what the points around some see, where that is the same; see `texel_shadows`.

    Args:
        some: Numbers of points, [M].
        between: Numbers of those around each point, [N, 4].
        alike: What these may differ by.
        known: Below 0 where nothing is known, changed, [N].
        left: Written from the start: numbers of the other points, [M].

    Returns:
        How many these are.
    """
    count = 0
    for j in range(len(some)):
        i = some[j]
        a, b, c, d = known[between[i, 0]], known[between[i, 1]], known[between[i, 2]], known[between[i, 3]]
        least, most = min(a, b, c, d), max(a, b, c, d)
        if least >= _0 and most - least <= alike:
            known[i] = np.float32(0.25) * (a + b + c + d)
        else:
            left[count] = i
            count += 1
    return count


@compiled(**OPTIONS)
def at_edges(long: np.ndarray, beside: np.ndarray, step: float, known: np.ndarray, found: np.ndarray) -> int:
    """Write from the start of `found` [M] which of the points `long` [M] see another part than those `beside` [M, 2].

    They differ by more than `step`; where `known` [N] is below 0, nothing is. Returns how many there are.
    """
    count = 0
    for j in range(len(long)):
        own, one, other = known[long[j]], known[beside[j, 0]], known[beside[j, 1]]
        if min(own, one, other) >= _0 and max(abs(one - own), abs(other - own)) > step:
            found[count] = j
            count += 1
    return count


@compiled(**OPTIONS)
def places_along(
    number: np.ndarray, long: np.ndarray, along: np.ndarray, beside: np.ndarray, corners: np.ndarray, points: np.ndarray,
    normals: np.ndarray, vertices: np.ndarray, steps: np.ndarray, there: np.ndarray, turned: np.ndarray,
) -> None:  # fmt: skip
    """Write places on long texels and their normals, [K * P, 3] each; see `texel_shadows.TexelShadows._places`.

    Args:
        number: Of the texels among the long ones, [K].
        long: Of `TexelShadows`, [M].
        along: Likewise, [M, 3].
        beside: Likewise, [M, 2].
        corners: Likewise, [M, 3].
        points: Of all texels, [N, 3].
        normals: Likewise, [N, 3].
        vertices: [V, 3].
        steps: Where the places are, in half lengths of a texel, [P].
        there: Written, the places.
        turned: Written, the normals.
    """
    for j in range(len(number)):
        m = number[j]
        own, before, behind = long[m], beside[m, 0], beside[m, 1]
        whole = before != own and behind != own
        for axis in range(3):
            here = points[own, axis]
            if whole:
                way = _HALF * (points[behind, axis] - points[before, axis])
                bend = _HALF * (points[before, axis] + points[behind, axis]) - here
            else:
                way, bend = _0, _0
                for k in range(3):
                    way += along[m, k] * vertices[corners[m, k], axis]
            for p in range(len(steps)):
                there[j * len(steps) + p, axis] = here + steps[p] * (way + steps[p] * bend)
                turned[j * len(steps) + p, axis] = normals[own, axis]
