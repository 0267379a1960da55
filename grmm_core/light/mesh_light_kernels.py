"""The compiled twin of `mesh_light.read`. Importing this loads numba.

All arrays are contiguous float32 but for indices.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .shadow_kernels import OPTIONS, single
from .skin_relief import DIMMEST, DULL, LIGHTEST, VALUES
from .skin_relief_kernel import gleam

_0, _1, _HALF = single(0.0), single(1.0), single(0.5)
_EMPTY, _DULL, _DIMMEST, _LIGHTEST = single(1e10), single(DULL), single(DIMMEST), single(LIGHTEST)
CHANNELS = 8  # of light
_SHINE, _FRONT = 3, 6


@compiled(inline="always", **OPTIONS)
def _spline(way: float) -> tuple[float, float, float]:
    """Weights of a quadratic B-spline at three points in a row, `way` behind the middle one."""
    before, behind = _HALF - way, _HALF + way
    return _HALF * before * before, _1 - _HALF * (before * before + behind * behind), _HALF * behind * behind


@compiled(inline="always", **OPTIONS)
def _apart(spans: np.ndarray, t: int, x: float, y: float) -> float:
    """How far a face lies from a place on the grid, at most along column or row; below 0 where it is on the face."""
    return max(max(spans[t, 0] - x, x - spans[t, 1]), max(spans[t, 2] - y, y - spans[t, 3]))


@compiled(**OPTIONS)
def _spans(places: np.ndarray) -> np.ndarray:
    """Least and most column and row of faces [T, 3, 2], then of nothing, far from everywhere, and of everything, [T + 2, 4]."""
    count = len(places)
    spans = np.empty((count + 2, 4), np.float32)
    for t in range(count):
        for axis in range(2):
            a, b, c = places[t, 0, axis], places[t, 1, axis], places[t, 2, axis]
            spans[t, 2 * axis], spans[t, 2 * axis + 1] = min(a, b, c), max(a, b, c)
    spans[count], spans[count + 1, ::2], spans[count + 1, 1::2] = _EMPTY, -_EMPTY, _EMPTY
    return spans


@compiled(**OPTIONS)
def read(
    seen: np.ndarray, faces: np.ndarray, closed: int, places: np.ndarray, rows: np.ndarray, light: np.ndarray, flat: bool,
    channels: np.ndarray, start: int, count: int, depth: np.ndarray, alpha: np.ndarray, skin: int, limits: np.ndarray,
    vertices: np.ndarray, tilts: np.ndarray, relief: np.ndarray, tile: np.ndarray, spread: np.ndarray, scale: float,
    detail: float, softened: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Read light at each pixel of some rows of a picture; see `mesh_light.read`.

    Args:
        seen: As there, [V, 3].
        faces: As there, [T, 3].
        closed: As there.
        places: As there, [T, 3, 2].
        rows: As there, [G, G].
        light: As there, [N, CHANNELS].
        flat: As there.
        channels: Of the picture, changed, [H, W, C].
        start: Of them the first of light.
        count: How many of them.
        depth: As there, [H, W].
        alpha: As there, [H, W].
        skin: As there, or below 0.
        limits: `mesh_light.NEAR`, `FAR`, `_LEAST_WEIGHT`, `_APART` and `_AT_EDGES`, the least cover, and `_LEAST`, [7].
        vertices: [V, 3] metres.
        tilts: As there, [N, VALUES] or, with `softened`, [N, VALUES + 3]; or [0, VALUES].
        relief: As there, [N, VALUES], likewise.
        tile: Of `skin_relief.Tile`, [T, 3].
        spread: Likewise.
        scale: Texels of the tile in one of the grid.
        detail: As there.
        softened: As there, [3] or [0].
        first: Row of the picture.
        last: The row after the last.
    """
    height, width = depth.shape
    above, below = max(first - 1, 0), min(last + 1, height)  # edges are seen from both sides
    # by what is greater the nearer it is, and linear on a face: one over the depth, or less the depth
    nearest, sign = np.full((below - above, width), -_EMPTY, np.float32), -_1 if flat else _1
    # faces, between columns that border on everything: branches on neighbors would cost more than looking at them
    nothing, anything = len(faces), len(faces) + 1
    number = np.full((below - above + 2, width + 2), nothing, np.int32)
    number[:, 0] = number[:, width + 1] = number[0] = number[below - above + 1] = anything
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        low_y, high_y = min(ay, by, cy), max(ay, by, cy)
        if not (high_y > above and low_y < below):
            continue
        low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
        if not (high_x > _0 and low_x < width):
            continue
        left, right = max(math.ceil(low_x - _HALF), 0), min(math.floor(high_x - _HALF), width - 1)
        top, bottom = max(math.ceil(low_y - _HALF), above), min(math.floor(high_y - _HALF), below - 1)
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if left > right or top > bottom or area == _0 or (t < closed and area > _0):
            continue
        inverse = _1 / area
        # barycentric coordinates of the second and third corner, and how they change by column and row
        u_x, u_y, v_x, v_y = (cy - ay) * inverse, (ax - cx) * inverse, (ay - by) * inverse, (bx - ax) * inverse
        base, to_b, to_c = sign * seen[a, 2], sign * (seen[b, 2] - seen[a, 2]), sign * (seen[c, 2] - seen[a, 2])
        for row in range(top, bottom + 1):
            dx, dy = np.float32(left) + _HALF - ax, np.float32(row) + _HALF - ay
            u, v = u_x * dx + u_y * dy, v_x * dx + v_y * dy
            for column in range(left, right + 1):
                value, before = base + u * to_b + v * to_c, nearest[row - above, column]
                nearer = min(u, v, _1 - u - v) >= _0 and value > before  # without branches, which small faces take at random
                nearest[row - above, column] = value if nearer else before
                number[row - above + 1, column + 1] = t if nearer else number[row - above + 1, column + 1]
                u += u_x
                v += v_x
    slope, most, apart = _1 / (limits[1] - limits[0]), len(rows) - 2, limits[3]
    total, spans = np.empty(CHANNELS, np.float32), _spans(places)
    fine, corners = np.zeros(2 * VALUES + 3, np.float32), np.empty((3, 3), np.float32)
    for row in range(first, last):
        line = row - above
        for column in range(width):
            t = number[line + 1, column + 1]
            if t == nothing:
                continue
            deep = -nearest[line, column] if flat else _1 / nearest[line, column]
            amount = min((limits[1] - abs(depth[row, column] - deep)) * slope, _1)
            if amount <= _0:
                continue
            if skin >= 0:
                amount *= channels[row, column, skin] / max(alpha[row, column], limits[5])
                if amount < limits[6]:
                    continue
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
            inverse = _1 / ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
            dx, dy = np.float32(column) + _HALF - ax, np.float32(row) + _HALF - ay
            u, v = ((cy - ay) * dx + (ax - cx) * dy) * inverse, ((ay - by) * dx + (bx - ax) * dy) * inverse
            w = _1 - u - v
            if not flat:
                u, v, w = u * seen[b, 2] * deep, v * seen[c, 2] * deep, w * seen[a, 2] * deep
            x = w * places[t, 0, 0] + u * places[t, 1, 0] + v * places[t, 2, 0]
            y = w * places[t, 0, 1] + u * places[t, 1, 1] + v * places[t, 2, 1]
            left, top = min(max(int(x + _HALF), 1), most), min(max(int(y + _HALF), 1), most)
            across, down = _spline(x - np.float32(left)), _spline(y - np.float32(top))
            for channel in range(CHANNELS):
                total[channel] = _0
            for step in range(3):
                weight, line_of = down[step], top + step - 1
                i, j, k = rows[line_of, left - 1], rows[line_of, left], rows[line_of, left + 1]
                p, q, r = across[0] if i >= 0 else _0, across[1] if j >= 0 else _0, across[2] if k >= 0 else _0
                p, q, r = p * weight, q * weight, r * weight
                for channel in range(CHANNELS):  # all at once
                    total[channel] += p * light[i, channel] + q * light[j, channel] + r * light[k, channel]
            front = total[_FRONT]
            if front < limits[2]:
                continue
            beside = max(_apart(spans, number[line + 1, column], x, y), _apart(spans, number[line + 1, column + 2], x, y))
            under = max(_apart(spans, number[line, column + 1], x, y), _apart(spans, number[line + 2, column + 1], x, y))
            if max(beside, under) > apart:
                amount *= limits[4]
            bright = max(total[_SHINE], total[_SHINE + 1], total[_SHINE + 2]) > _DULL * front
            if len(tilts) and (bright or len(softened)):
                fine[:] = _0
                for step in range(3):
                    weight, line_of = down[step], top + step - 1
                    i, j, k = rows[line_of, left - 1], rows[line_of, left], rows[line_of, left + 1]
                    p, q, r = across[0] if i >= 0 else _0, across[1] if j >= 0 else _0, across[2] if k >= 0 else _0
                    p, q, r = p * weight, q * weight, r * weight
                    for value in range(VALUES):
                        fine[value] += p * tilts[i, value] + q * tilts[j, value] + r * tilts[k, value]
                    for value in range(VALUES):
                        fine[VALUES + value] += p * relief[i, value] + q * relief[j, value] + r * relief[k, value]
                    for value in range(len(softened)):
                        other = VALUES + value
                        fine[VALUES + other] += p * tilts[i, other] + q * tilts[j, other] + r * tilts[k, other]
                for axis in range(3):
                    corners[0, axis], corners[1, axis] = vertices[a, axis], vertices[b, axis]
                    corners[2, axis] = vertices[c, axis]
                inverse = _1 / ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
                steps = (cy - ay) * inverse, (ax - cx) * inverse, (ay - by) * inverse, (bx - ax) * inverse
                shine, lean = gleam(fine, corners, places[t], x, y, steps, tile, spread, scale, detail)
                for channel in range(_SHINE, _SHINE + 3):
                    total[channel] *= shine if bright and total[channel] > _0 else _1
                for channel in range(len(softened)):
                    total[channel] *= min(max(_1 + softened[channel] * lean, _DIMMEST), _LIGHTEST)
            factor = channels[row, column, start + _FRONT] / front
            for channel in range(count):
                here = channels[row, column, start + channel]
                channels[row, column, start + channel] = here + amount * (total[channel] * factor - here)
