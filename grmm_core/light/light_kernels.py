"""The compiled twins of what is slow in numpy: shadow maps, light at points, relit pixels. Importing this loads numba.

All arrays are contiguous float32 but for indices. What takes `first` and `last` does these rows (`compute.threads.for_rows`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compute.kernels import compiled

_OPTIONS: dict[str, Any] = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
_single: Any = np.float32  # mypy cannot follow numpy's kinds of numbers through min and max
_0, _1, _2, _HALF = _single(0.0), _single(1.0), _single(2.0), _single(0.5)
_TINY, _PI = _single(1e-9), _single(math.pi)
_LEVEL = np.float32(0.02)  # change of a face's reciprocal depth that counts as small
# columns of a lamp's row; `shading.lamp_rows` writes them
(KIND, PLACE, POWER, SPREAD, TOWARDS, INNER, FADE, SIZE, COLOR, LAMP_VALUES) = (0, 1, 4, 5, 6, 9, 10, 11, 12, 15)
SUN, POINT, SPOT, AREA = 0, 1, 2, 3
NEAREST_SQUARE = np.float32(0.02**2)


@compiled(**_OPTIONS)
def interpolate(
    values: np.ndarray, corners: np.ndarray, weights: np.ndarray, out: np.ndarray, first: int, last: int
) -> None:  # fmt: skip
    """Write weighted sums of three rows of `values` [V, C] into `out` [N, C]; corners and weights [N, 3]."""
    for i in range(first, last):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        for k in range(values.shape[1]):
            out[i, k] = weights[i, 0] * values[a, k] + weights[i, 1] * values[b, k] + weights[i, 2] * values[c, k]


# --- shadows -----------------------------------------------------------------------------------------------------------------


@compiled(**_OPTIONS)
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


@compiled(**_OPTIONS)
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


@compiled(**_OPTIONS)
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


@compiled(inline="always", **_OPTIONS)
def _arriving(lamps: np.ndarray, k: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Direction to a lamp and irradiance, as `lamps.arriving`."""
    if lamps[k, KIND] == SUN:
        return lamps[k, PLACE], lamps[k, PLACE + 1], lamps[k, PLACE + 2], lamps[k, POWER]
    dx, dy, dz = lamps[k, PLACE] - x, lamps[k, PLACE + 1] - y, lamps[k, PLACE + 2] - z
    square = dx * dx + dy * dy + dz * dz
    inverse = _1 / math.sqrt(max(square, np.float32(1e-12)))
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    strength = lamps[k, POWER] / (max(square, NEAREST_SQUARE) + lamps[k, SPREAD])
    if lamps[k, KIND] != POINT:
        along = -(dx * lamps[k, TOWARDS] + dy * lamps[k, TOWARDS + 1] + dz * lamps[k, TOWARDS + 2])
        if lamps[k, KIND] == AREA:
            strength *= max(along, _0)
        else:
            share = min(max((along - lamps[k, INNER]) * lamps[k, FADE], _0), _1)
            strength *= share * share * (np.float32(3.0) - _2 * share)
    return dx, dy, dz, strength


@compiled(**_OPTIONS)
def march(
    extinction: np.ndarray, low: np.ndarray, cell: float, steps: int, lamps: np.ndarray, points: np.ndarray, seen: np.ndarray,
    first: int, last: int,
) -> None:  # fmt: skip
    """Dim what points see of a lamp by a cloud before it; see `hair_shading.through`.

    Args:
        extinction: At the middles of cells, 1/m, [X, Y, Z].
        low: Corner of the grid, [3].
        cell: Side of a cell and length of a step, metres.
        steps: At most.
        lamps: One row of `shading.lamp_rows`, [1, LAMP_VALUES].
        points: [N, 3].
        seen: Changed, [N].
        first: Row of `points`.
        last: The row after the last.
    """
    inverse, length = np.float32(1.0 / cell), np.float32(cell)
    wide, high, deep = extinction.shape
    for i in range(first, last):
        if seen[i] <= _0:
            continue
        lx, ly, lz, _ = _arriving(lamps, 0, points[i, 0], points[i, 1], points[i, 2])
        # in cells from the middle of the first one; half a step ahead
        x = (points[i, 0] - low[0]) * inverse - _HALF + _HALF * lx
        y = (points[i, 1] - low[1]) * inverse - _HALF + _HALF * ly
        z = (points[i, 2] - low[2]) * inverse - _HALF + _HALF * lz
        total = _0
        for _step in range(steps):
            if x >= _0 and y >= _0 and z >= _0:
                a, b, c = int(x), int(y), int(z)
                if a < wide - 1 and b < high - 1 and c < deep - 1:
                    u, v, w = x - np.float32(a), y - np.float32(b), z - np.float32(c)
                    near = (_1 - w) * extinction[a, b, c] + w * extinction[a, b, c + 1]
                    beside = (_1 - w) * extinction[a, b + 1, c] + w * extinction[a, b + 1, c + 1]
                    ahead = (_1 - w) * extinction[a + 1, b, c] + w * extinction[a + 1, b, c + 1]
                    across = (_1 - w) * extinction[a + 1, b + 1, c] + w * extinction[a + 1, b + 1, c + 1]
                    total += (_1 - u) * ((_1 - v) * near + v * beside) + u * ((_1 - v) * ahead + v * across)
            x, y, z = x + lx, y + ly, z + lz
        seen[i] *= math.exp(-total * length)


# --- light at points ---------------------------------------------------------------------------------------------------------


@compiled(inline="always", **_OPTIONS)
def _lobe(alpha: float, tilt: float, cosine: float, facing: float) -> float:
    square = alpha * alpha
    base = tilt * tilt * (square - _1) + _1
    k = _HALF * alpha
    return square / (_PI * base * base * (cosine * (_1 - k) + k) * (facing * (_1 - k) + k))


@compiled(inline="always", **_OPTIONS)
def _wrapped(cosine: float, wander: float) -> float:
    return max(cosine + wander, _0) / ((_1 + wander) * (_1 + wander))


@compiled(inline="always", **_OPTIONS)
def _softened(log: float, wander: float) -> float:
    return math.exp(log / (_1 + np.float32(1.5) * wander))


@compiled(**_OPTIONS)
def shade(
    lamps: np.ndarray, points: np.ndarray, normals: np.ndarray, seen: np.ndarray, smooth: np.ndarray, rough: np.ndarray,
    share: np.ndarray, reflectance: np.ndarray, shine: np.ndarray, wander: np.ndarray, rows: np.ndarray, eye: np.ndarray,
    turn: np.ndarray, colors: np.ndarray, mirrors: np.ndarray, factors: np.ndarray, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Light at Gaussians of skin: what `shading.transport` and `Transport.light` give together.

    Args:
        lamps: Rows of `shading.lamp_rows`, [L, LAMP_VALUES].
        points: [N, 3].
        normals: [N, 3].
        seen: [L, N].
        smooth: Of `Materials`, [N].
        rough: Likewise.
        share: Likewise.
        reflectance: Likewise.
        shine: Likewise.
        wander: Likewise.
        rows: Of `transfer.transfer`, [N, 9].
        eye: [3].
        turn: From the axes of `rows` to those of the points, [3, 3].
        colors: Coefficients of the surroundings for irradiance, [9, 3].
        mirrors: The same for mirrored light, [9, 3].
        factors: Of all light, of highlights, and of wandering by color, [5].
        out: Written: irradiance (3), highlights (3), share of the lamps' light that arrives (1), [N, 7].
        first: Row of `out`.
        last: The row after the last.
    """
    intensity, gloss = factors[0], factors[1]
    for i in range(first, last):
        px, py, pz, nx, ny, nz = points[i, 0], points[i, 1], points[i, 2], normals[i, 0], normals[i, 1], normals[i, 2]
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        inverse = _1 / max(math.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
        vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
        towards_eye = nx * vx + ny * vy + nz * vz
        facing = min(max(towards_eye, np.float32(0.05)), _1)
        wr = min(max(wander[i] * factors[2], _0), np.float32(0.9))
        wg = min(max(wander[i] * factors[3], _0), np.float32(0.9))
        wb = min(max(wander[i] * factors[4], _0), np.float32(0.9))
        red, green, blue, shine_r, shine_g, shine_b, arrives, whole = _0, _0, _0, _0, _0, _0, _0, _0
        for k in range(len(lamps)):
            lx, ly, lz, strength = _arriving(lamps, k, px, py, pz)
            cosine, part = nx * lx + ny * ly + nz * lz, seen[k, i]
            if strength <= _0 or (part <= _0 and cosine + wr <= _0):
                continue
            strength *= intensity
            lr, lg, lb = lamps[k, COLOR], lamps[k, COLOR + 1], lamps[k, COLOR + 2]
            tr, tg, tb = _wrapped(cosine, wr) * strength, _wrapped(cosine, wg) * strength, _wrapped(cosine, wb) * strength
            if part <= _0:
                tr = tg = tb = _0
            elif part < _1:
                log = math.log(part)
                tr, tg, tb = tr * _softened(log, wr), tg * _softened(log, wg), tb * _softened(log, wb)
            mean = (tr + tg + tb) * (lr + lg + lb) / np.float32(9.0)
            arrives += mean
            whole += mean / max(part, np.float32(0.02))
            red, green, blue = red + tr * lr, green + tg * lg, blue + tb * lb
            if cosine <= _0 or part <= _0:
                continue
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            inverse = _1 / max(math.sqrt(hx * hx + hy * hy + hz * hz), _TINY)
            tilt = min(max((nx * hx + ny * hy + nz * hz) * inverse, _0), _1)
            away = _1 - min(max((vx * hx + vy * hy + vz * hz) * inverse, _0), _1)
            square = away * away
            fresnel = reflectance[i] + (_1 - reflectance[i]) * square * square * away
            size, total = lamps[k, SIZE], _0
            for which in range(2):
                roughness = smooth[i] if which == 0 else rough[i]
                narrow = max(roughness * roughness, np.float32(1e-3))
                alpha = min(narrow + size, _1)
                weight = share[i] if which == 0 else _1 - share[i]
                if size > _0:
                    weight *= narrow * narrow / (alpha * alpha)
                total += weight * _lobe(alpha, tilt, cosine, facing)
            amount = np.float32(0.25) * total * fresnel * shine[i] * cosine * part * strength * gloss
            shine_r, shine_g, shine_b = shine_r + amount * lr, shine_g + amount * lg, shine_b + amount * lb
        away = _1 - facing
        square = away * away
        fresnel = reflectance[i] + (_1 - reflectance[i]) * square * square * away
        glossy = fresnel * shine[i] * min(max(rows[i, 0] / (_PI * np.float32(0.282095)), _0), _1) * gloss
        qx, qy, qz = _2 * towards_eye * nx - vx, _2 * towards_eye * ny - vy, _2 * towards_eye * nz - vz
        x = turn[0, 0] * qx + turn[1, 0] * qy + turn[2, 0] * qz
        y = turn[0, 1] * qx + turn[1, 1] * qy + turn[2, 1] * qz
        z = turn[0, 2] * qx + turn[1, 2] * qy + turn[2, 2] * qz
        basis = (
            np.float32(0.282095), np.float32(0.488603) * y, np.float32(0.488603) * z, np.float32(0.488603) * x,
            np.float32(1.092548) * x * y, np.float32(1.092548) * y * z, np.float32(0.315392) * (np.float32(3.0) * z * z - _1),
            np.float32(1.092548) * x * z, np.float32(0.546274) * (x * x - y * y),
        )  # fmt: skip
        for c in range(3):
            even, mirrored = _0, _0
            for k in range(9):
                even += rows[i, k] * colors[k, c]
                mirrored += basis[k] * mirrors[k, c]
            out[i, c] = even * intensity
            out[i, 3 + c] = mirrored * glossy * intensity
        out[i, 0], out[i, 1], out[i, 2] = out[i, 0] + red, out[i, 1] + green, out[i, 2] + blue
        out[i, 3], out[i, 4], out[i, 5] = out[i, 3] + shine_r, out[i, 4] + shine_g, out[i, 5] + shine_b
        out[i, 6] = (arrives + np.float32(1e-6)) / (whole + np.float32(1e-6))


# --- pictures ----------------------------------------------------------------------------------------------------------------

TABLE, LINEAR_END, DISPLAY_END = 4096, 1.25, 1.5
"""Steps of the tables that `relit` reads, and the last values that they hold: display, and the root of linear light."""


@compiled(inline="always", **_OPTIONS)
def _read(table: np.ndarray, at: float) -> float:
    low = int(at)
    return table[low] + (at - low) * (table[low + 1] - table[low])


@compiled(**_OPTIONS)
def relit(
    rgb: np.ndarray, alpha: np.ndarray, light: np.ndarray, start: int, linear: np.ndarray, display: np.ndarray, least: float,
    most: float, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Pixels in another light; see `relight.relit`.

    Args:
        rgb: [P, 3].
        alpha: [P].
        light: Channels of the picture, [P, C].
        start: Of them the first of ratio (3) and highlights (3).
        linear: Linear light of display values 0..`LINEAR_END`, [TABLE + 2].
        display: Display values of linear light by its root, 0..`DISPLAY_END`, [TABLE + 2].
        least: Cover that is drawn.
        most: Share of a color that highlights may take off.
        out: Written, [P, 3].
        first: Row of `out`.
        last: The row after the last.
    """
    to_linear, to_display = np.float32(TABLE / LINEAR_END), np.float32(TABLE / DISPLAY_END)
    for i in range(first, last):
        cover = alpha[i]
        if cover < least:
            out[i, 0] = out[i, 1] = out[i, 2] = _0
            continue
        inverse = _1 / cover
        for c in range(3):
            flat = max(rgb[i, c] * inverse, _0)
            if flat < np.float32(LINEAR_END):
                value = _read(linear, flat * to_linear)
            else:
                value = ((flat + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
            value *= light[i, start + c] * inverse
            value = max(value + max(light[i, start + 3 + c] * inverse, -np.float32(most) * value), _0)
            root = math.sqrt(value)
            if root < np.float32(DISPLAY_END):
                value = _read(display, root * to_display)
            else:
                value = np.float32(1.055) * value ** np.float32(1.0 / 2.4) - np.float32(0.055)
            out[i, c] = value * cover
