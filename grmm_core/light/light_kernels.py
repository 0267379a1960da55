"""The compiled twins of light at points and of relit pixels. Importing this loads numba.

All arrays are contiguous float32 but for indices. What takes `first` and `last` does these rows (`compute.threads.for_rows`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compute.kernels import compiled
from .shadow_kernels import OPTIONS, single

_0, _1, _2, _HALF = single(0.0), single(1.0), single(2.0), single(0.5)
_TINY, _PI = single(1e-9), single(math.pi)
# columns of a lamp's row; `shading.lamp_rows` writes them
(KIND, PLACE, POWER, SPREAD, TOWARDS, INNER, FADE, SIZE, COLOR, LAMP_VALUES) = (0, 1, 4, 5, 6, 9, 10, 11, 12, 15)
SUN, POINT, SPOT, AREA = 0, 1, 2, 3
NEAREST_SQUARE = np.float32(0.02**2)


@compiled(**OPTIONS)
def interpolate(
    values: np.ndarray, corners: np.ndarray, weights: np.ndarray, unit: bool, out: np.ndarray, first: int, last: int
) -> None:  # fmt: skip
    """Write weighted sums of three rows of `values` [V, C] into `out` [N, C], of length 1 if `unit`; the others [N, 3]."""
    for i in range(first, last):
        a, b, c, square = corners[i, 0], corners[i, 1], corners[i, 2], np.float32(1e-20)
        for k in range(values.shape[1]):
            value = weights[i, 0] * values[a, k] + weights[i, 1] * values[b, k] + weights[i, 2] * values[c, k]
            out[i, k], square = value, square + value * value
        if unit:
            for k in range(values.shape[1]):
                out[i, k] /= math.sqrt(square)


@compiled(inline="always", **OPTIONS)
def arriving(lamps: np.ndarray, k: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
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


@compiled(**OPTIONS)
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
        lx, ly, lz, _ = arriving(lamps, 0, points[i, 0], points[i, 1], points[i, 2])
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


@compiled(inline="always", **OPTIONS)
def harmonics_of(x: float, y: float, z: float) -> tuple[Any, ...]:
    """`surroundings.basis` of a unit vector."""
    return (
        np.float32(0.282095), np.float32(0.488603) * y, np.float32(0.488603) * z, np.float32(0.488603) * x,
        np.float32(1.092548) * x * y, np.float32(1.092548) * y * z, np.float32(0.315392) * (np.float32(3.0) * z * z - _1),
        np.float32(1.092548) * x * z, np.float32(0.546274) * (x * x - y * y),
    )  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _lobe(alpha: float, tilt: float, cosine: float, facing: float) -> float:
    square = alpha * alpha
    base = tilt * tilt * (square - _1) + _1
    k = _HALF * alpha
    return square / (_PI * base * base * (cosine * (_1 - k) + k) * (facing * (_1 - k) + k))


@compiled(inline="always", **OPTIONS)
def _mirrored(rough: float, reflectance: float, facing: float) -> float:
    """`shading.mirrored_share` of a surface."""
    narrow = _1 - rough
    outline = min(narrow * narrow, np.float32(math.exp(np.float32(-9.28 * math.log(2.0)) * facing))) * narrow
    outline += np.float32(0.0425) - np.float32(0.0275) * rough
    by_reflectance = np.float32(1.04) - np.float32(0.572) * rough - np.float32(1.04) * outline
    return max(reflectance * by_reflectance + np.float32(1.04) * outline - np.float32(0.04) + np.float32(0.022) * rough, _0)


@compiled(inline="always", **OPTIONS)
def _wrapped(cosine: float, wander: float) -> float:
    return max(cosine + wander, _0) / ((_1 + wander) * (_1 + wander))


@compiled(inline="always", **OPTIONS)
def _softened(log: float, wander: float) -> float:
    return math.exp(log / (_1 + np.float32(1.5) * wander))


@compiled(**OPTIONS)
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
        factors: Of all light, of highlights, of wandering by color, and `shading.FADING` and `LEAST_FRONT`, [7].
        out: Written: `shading.Arrived.values`, [N, 8].
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
        facing, front = min(max(towards_eye, np.float32(0.05)), _1), _1 + factors[5] * towards_eye
        away_from_eye = front <= _0  # its highlights are nobody's
        wr = min(max(wander[i] * factors[2], _0), np.float32(0.9))
        wg = min(max(wander[i] * factors[3], _0), np.float32(0.9))
        wb = min(max(wander[i] * factors[4], _0), np.float32(0.9))
        red, green, blue, shine_r, shine_g, shine_b, arrives, whole = _0, _0, _0, _0, _0, _0, _0, _0
        for k in range(len(lamps)):
            lx, ly, lz, strength = arriving(lamps, k, px, py, pz)
            cosine, part = nx * lx + ny * ly + nz * lz, seen[k, i]
            if strength <= _0 or cosine + wr <= _0:
                continue
            strength *= intensity
            lr, lg, lb = lamps[k, COLOR], lamps[k, COLOR + 1], lamps[k, COLOR + 2]
            tr, tg, tb = _wrapped(cosine, wr) * strength, _wrapped(cosine, wg) * strength, _wrapped(cosine, wb) * strength
            mean = (lr + lg + lb) / np.float32(9.0)
            whole += (tr + tg + tb) * mean
            if part <= _0:
                continue
            if part < _1:
                log = math.log(part)
                tr, tg, tb = tr * _softened(log, wr), tg * _softened(log, wg), tb * _softened(log, wb)
            arrives += (tr + tg + tb) * mean
            red, green, blue = red + tr * lr, green + tg * lg, blue + tb * lb
            if cosine <= _0 or away_from_eye:
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
                narrow = roughness * roughness
                alpha = min(math.sqrt(narrow * narrow + size * size), _1)
                weight = share[i] if which == 0 else _1 - share[i]
                total += weight * _lobe(alpha, tilt, cosine, facing)
            amount = np.float32(0.25) * total * fresnel * shine[i] * cosine * part * strength * gloss
            shine_r, shine_g, shine_b = shine_r + amount * lr, shine_g + amount * lg, shine_b + amount * lb
        mean_rough = share[i] * smooth[i] + (_1 - share[i]) * rough[i]
        free = min(max(rows[i, 0] / (_PI * np.float32(0.282095)), _0), _1)
        glossy = _mirrored(mean_rough, reflectance[i], facing) * shine[i] * free * gloss
        qx, qy, qz = _2 * towards_eye * nx - vx, _2 * towards_eye * ny - vy, _2 * towards_eye * nz - vz
        x = turn[0, 0] * qx + turn[1, 0] * qy + turn[2, 0] * qz
        y = turn[0, 1] * qx + turn[1, 1] * qy + turn[2, 1] * qz
        z = turn[0, 2] * qx + turn[1, 2] * qy + turn[2, 2] * qz
        basis = harmonics_of(x, y, z)
        for c in range(3):
            even, mirrored = _0, _0
            for k in range(9):
                even += rows[i, k] * colors[k, c]
            if not away_from_eye:
                for k in range(9):
                    mirrored += basis[k] * mirrors[k, c]
            out[i, c] = even * intensity
            out[i, 3 + c] = mirrored * glossy * intensity
        out[i, 0], out[i, 1], out[i, 2] = out[i, 0] + red, out[i, 1] + green, out[i, 2] + blue
        out[i, 3], out[i, 4], out[i, 5] = out[i, 3] + shine_r, out[i, 4] + shine_g, out[i, 5] + shine_b
        out[i, 6] = min(max(front, factors[6]), _1)
        out[i, 7] = (arrives + np.float32(1e-6)) / (whole + np.float32(1e-6))


@compiled(**OPTIONS)
def relative(
    light: np.ndarray, corners: np.ndarray, bounced: np.ndarray, weights: np.ndarray, rig: np.ndarray, learned: np.ndarray,
    gloss: float, most: float, first: int, last: int,
) -> None:  # fmt: skip
    """Turn what arrives into what changes colors; see `shading.relative`.

    Args:
        light: Of `shade`; overwritten, [N, 8].
        corners: [N, 3], or [0, 3]: nothing bounces.
        bounced: [V, 3].
        weights: As `corners`.
        rig: [N, 3].
        learned: Highlights, [N, 3].
        gloss: Their factor.
        most: Of a ratio.
        first: Row of `light`.
        last: The row after the last.
    """
    shine, limit = np.float32(gloss), np.float32(most)
    for i in range(first, last):
        for k in range(3):
            more = _0
            if len(corners):
                a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
                more = weights[i, 0] * bounced[a, k] + weights[i, 1] * bounced[b, k] + weights[i, 2] * bounced[c, k]
            ratio = min(max((light[i, k] + more) / rig[i, k], _0), limit)
            light[i, k] = ratio * light[i, 6]
            light[i, 3 + k] = (light[i, 3 + k] - shine * learned[i, k] * ratio) * light[i, 6]
        light[i, 7] *= light[i, 6]


# --- pictures ----------------------------------------------------------------------------------------------------------------

TABLE, LINEAR_END, DISPLAY_END = 4096, 1.25, 1.5
"""Steps of the tables that `relit` reads, and the last values that they hold: display, and the root of linear light."""


@compiled(inline="always", **OPTIONS)
def _read(table: np.ndarray, at: float) -> float:
    low = int(at)
    return table[low] + (at - low) * (table[low + 1] - table[low])


@compiled(**OPTIONS)
def relit(
    rgb: np.ndarray, alpha: np.ndarray, light: np.ndarray, start: int, linear: np.ndarray, display: np.ndarray, least: float,
    most: float, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Pixels in another light; see `relight.relit`.

    Args:
        rgb: [P, 3].
        alpha: [P].
        light: Channels of the picture, [P, C].
        start: Of them the first of ratio (3), highlights (3) and cover that faces the viewer (1).
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
        inverse, front = _1 / cover, _1 / max(light[i, start + 6], np.float32(1e-6))
        for c in range(3):
            flat = max(rgb[i, c] * inverse, _0)
            if flat < np.float32(LINEAR_END):
                value = _read(linear, flat * to_linear)
            else:
                value = ((flat + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
            value *= light[i, start + c] * front
            value = max(value + max(light[i, start + 3 + c] * front, -np.float32(most) * value), _0)
            root = math.sqrt(value)
            if root < np.float32(DISPLAY_END):
                value = _read(display, root * to_display)
            else:
                value = np.float32(1.055) * value ** np.float32(1.0 / 2.4) - np.float32(0.055)
            out[i, c] = value * cover
