"""The compiled twin of `skin_relief.gleam`. Importing this loads numba. All arrays are contiguous float32."""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .shadow_kernels import OPTIONS, single
from .skin_relief import BRIGHTEST, CAVITY, DARKEST, FALL, GATHER, LEVELS, ROUGHEST, SIDE, SMOOTHEST, STEEPEST

_0, _1, _2, _HALF = single(0.0), single(1.0), single(2.0), single(0.5)
_TINY, _TINIER = single(1e-9), single(1e-12)
_FALL, _STEEPER, _DARKEST, _BRIGHTEST = single(FALL), single(1.0 / STEEPEST**2), single(DARKEST), single(BRIGHTEST)
_CAVITY, _GATHER, _SMOOTHEST, _ROUGHEST = single(CAVITY), single(GATHER), single(SMOOTHEST), single(ROUGHEST)


@compiled(**OPTIONS)
def gleam(
    here: np.ndarray, corners: np.ndarray, places: np.ndarray, x: float, y: float, steps: tuple[float, ...],
    values: np.ndarray, spread: np.ndarray, scale: float, detail: float,
) -> tuple[float, float]:  # fmt: skip
    """What relief makes of light at a pixel; see `skin_relief.gleam`.

    Args:
        here: As of `shading.Transport.tilts`, of `skin_relief.lying`, and of `leanings`, [2 * VALUES + 3].
        corners: Of the face that is seen, [3, 3] metres.
        places: Of them on the grid, [3, 2].
        x: Place of the pixel on the grid, along columns.
        y: Along rows.
        steps: By how much the second and the third barycentric coordinate change by pixels: u by column, by row, v likewise.
        values: Of `skin_relief.Tile`, [T, 3].
        spread: Likewise, [LEVELS + 1].
        scale: Texels of the tile in one of the grid.
        detail: Factor of the tilts.
    """
    bx, by = places[1, 0] - places[0, 0], places[1, 1] - places[0, 1]
    cx, cy = places[2, 0] - places[0, 0], places[2, 1] - places[0, 1]
    area = bx * cy - cx * by
    inverse = _1 / (area if abs(area) >= _TINIER else _TINIER)
    along = across = change_u = change_v = lean_u = lean_v = _0
    for axis in range(3):
        to_b, to_c = corners[1, axis] - corners[0, axis], corners[2, axis] - corners[0, axis]
        way_u, way_v = (to_b * cy - to_c * by) * inverse, (to_c * bx - to_b * cx) * inverse
        along, across = along + way_u * way_u, across + way_v * way_v
        change_u, change_v = change_u + here[axis] * way_u, change_v + here[axis] * way_v
        lean_u, lean_v = lean_u + here[8 + axis] * way_u, lean_v + here[8 + axis] * way_v
    along, across = max(math.sqrt(along), _TINY), max(math.sqrt(across), _TINY)
    change_u, change_v = change_u / along, change_v / across
    lean_u, lean_v = lean_u / along, lean_v / across

    right, below = bx * steps[0] + cx * steps[2], by * steps[0] + cy * steps[2]
    under, beside = bx * steps[1] + cx * steps[3], by * steps[1] + cy * steps[3]
    step = math.sqrt(max(right * right + below * below, under * under + beside * beside))
    size = math.log2(max(step * scale, _1))
    level = min(int(size), LEVELS - 1)
    part = min(size - np.float32(level), _1)
    tilt_u = tilt_v = height = square = _0
    for k in range(2):
        weight = part if k == 1 else _1 - part
        square += weight * spread[level + k]
        if level + k == LEVELS:
            continue
        side = SIDE >> (level + k)
        begin, ratio = (4 * SIDE * SIDE - 4 * side * side) // 3, scale * np.float32(side) / np.float32(SIDE)
        at_x, at_y = (x + _HALF) * ratio - _HALF, (y + _HALF) * ratio - _HALF
        low_x, low_y = math.floor(at_x), math.floor(at_y)
        p, q, most = at_x - np.float32(low_x), at_y - np.float32(low_y), side - 1  # sides are powers of two
        left, top = low_x & most, begin + (low_y & most) * side
        right_one, bottom = (low_x + 1) & most, begin + ((low_y + 1) & most) * side
        a, b, c, d = top + left, top + right_one, bottom + left, bottom + right_one
        e, f, g, h = (_1 - p) * (_1 - q) * weight, p * (_1 - q) * weight, (_1 - p) * q * weight, p * q * weight
        tilt_u += e * values[a, 0] + f * values[b, 0] + g * values[c, 0] + h * values[d, 0]
        tilt_v += e * values[a, 1] + f * values[b, 1] + g * values[c, 1] + h * values[d, 1]
        height += e * values[a, 2] + f * values[b, 2] + g * values[c, 2] + h * values[d, 2]

    strength = here[6] * detail
    gathered_u = min(max(_1 + _GATHER * (_1 - along / max(here[4], _TINY)), _SMOOTHEST), _ROUGHEST) * strength
    gathered_v = min(max(_1 + _GATHER * (_1 - across / max(here[5], _TINY)), _SMOOTHEST), _ROUGHEST) * strength
    square_u, square_v = square * gathered_u * gathered_u, square * gathered_v * gathered_v
    less = _1 / math.sqrt(_1 + (change_u * change_u * square_u + change_v * change_v * square_v) * _STEEPER)
    change_u, change_v = change_u * less, change_v * less
    fall = _FALL * here[3]
    fall /= _1 + _2 * fall * max(square_u, square_v)
    wide_u, wide_v = _1 + _2 * fall * square_u, _1 + _2 * fall * square_v
    tilt_u, tilt_v = tilt_u * gathered_u, tilt_v * gathered_v
    mean = math.log(wide_u * wide_v) - change_u * change_u * square_u / wide_u - change_v * change_v * square_v / wide_v
    value = change_u * tilt_u + change_v * tilt_v - fall * (tilt_u * tilt_u + tilt_v * tilt_v)
    value += _HALF * mean + _CAVITY * strength * height
    return math.exp(min(max(value, _DARKEST), _BRIGHTEST)), lean_u * tilt_u + lean_v * tilt_v
