"""The compiled twin of light at strands (`hair_shading`). Importing this loads numba.

All arrays are contiguous float32. What takes `first` and `last` does these rows (`compute.threads.for_rows`).
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .light_kernels import COLOR, OPTIONS, arriving, harmonics_of
from .shadow_kernels import single

_0, _1, _2, _TINY = single(0.0), single(1.0), single(2.0), single(1e-9)


@compiled(inline="always", **OPTIONS)
def _lobes(square: float, surface: float, inside: float) -> float:
    """Both of `hair_shading.LOBES`, multiplied out, of the squared cosine between normal plane and half vector."""
    two = square * square
    four = two * two
    eight = four * four
    sixteen = eight * eight
    return surface * sixteen * sixteen * sixteen * eight * four + inside * eight * square


@compiled(**OPTIONS)
def shade(
    lamps: np.ndarray, points: np.ndarray, quats: np.ndarray, parts: np.ndarray, to_grid: np.ndarray, centre: np.ndarray,
    eye: np.ndarray, colors: np.ndarray, factors: np.ndarray, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Light at pieces of strands; see `hair_shading.strand_light`.

    Args:
        lamps: Rows of `shading.lamp_rows`, [L, LAMP_VALUES].
        points: [N, 3].
        quats: [N, 4].
        parts: Of `Reaching`, [X, Y, Z, L].
        to_grid: Its coordinates, [3, 4].
        centre: Of the head, [3].
        eye: [3].
        colors: Coefficients of the surroundings for irradiance, [9, 3].
        factors: Of all light and of highlights, how far light reaches around, share through the rim, strength of lobes, [6].
        out: Written: `shading.Arrived.values`, [N, 8].
        first: Row of `out`.
        last: The row after the last.
    """
    intensity, gloss, reach, rims, surface, inside = factors[0], factors[1], factors[2], factors[3], factors[4], factors[5]
    count, corners = len(lamps), np.empty(8, np.float32)
    part = np.empty(count, np.float32)
    most_x, most_y, most_z = (
        np.float32(parts.shape[0] - 1.001), np.float32(parts.shape[1] - 1.001), np.float32(parts.shape[2] - 1.001)
    )  # fmt: skip
    for i in range(first, last):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        gx = to_grid[0, 0] * px + to_grid[0, 1] * py + to_grid[0, 2] * pz + to_grid[0, 3]
        gy = to_grid[1, 0] * px + to_grid[1, 1] * py + to_grid[1, 2] * pz + to_grid[1, 3]
        gz = to_grid[2, 0] * px + to_grid[2, 1] * py + to_grid[2, 2] * pz + to_grid[2, 3]
        gx, gy, gz = min(max(gx, _0), most_x), min(max(gy, _0), most_y), min(max(gz, _0), most_z)
        a, b, c = int(gx), int(gy), int(gz)
        u, v, w = gx - np.float32(a), gy - np.float32(b), gz - np.float32(c)
        corners[0], corners[1] = (_1 - u) * (_1 - v) * (_1 - w), (_1 - u) * (_1 - v) * w
        corners[2], corners[3] = (_1 - u) * v * (_1 - w), (_1 - u) * v * w
        corners[4], corners[5] = u * (_1 - v) * (_1 - w), u * (_1 - v) * w
        corners[6], corners[7] = u * v * (_1 - w), u * v * w
        for k in range(count):
            part[k] = (
                corners[0] * parts[a, b, c, k] + corners[1] * parts[a, b, c + 1, k] + corners[2] * parts[a, b + 1, c, k]
                + corners[3] * parts[a, b + 1, c + 1, k] + corners[4] * parts[a + 1, b, c, k]
                + corners[5] * parts[a + 1, b, c + 1, k] + corners[6] * parts[a + 1, b + 1, c, k]
                + corners[7] * parts[a + 1, b + 1, c + 1, k]
            )  # fmt: skip
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        tx, ty, tz = _1 - _2 * (qy * qy + qz * qz), _2 * (qx * qy + qw * qz), _2 * (qx * qz - qw * qy)
        ox, oy, oz = px - centre[0], py - centre[1], pz - centre[2]
        inverse = _1 / max(math.sqrt(ox * ox + oy * oy + oz * oz), _TINY)
        ox, oy, oz = ox * inverse, oy * inverse, oz * inverse
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        inverse = _1 / max(math.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
        vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
        along_view = tx * vx + ty * vy + tz * vz
        rim = _1 - min(abs(ox * vx + oy * vy + oz * vz), _1)
        rim *= rim * rims
        red, green, blue, shine_r, shine_g, shine_b, arrives, whole = _0, _0, _0, _0, _0, _0, _0, _0
        for k in range(count):
            lx, ly, lz, strength = arriving(lamps, k, px, py, pz)
            if strength <= _0:
                continue
            along, opposite = tx * lx + ty * ly + tz * lz, vx * lx + vy * ly + vz * lz
            facing = (ox * lx + oy * ly + oz * lz + reach) / (_1 + reach)
            facing = min(max(facing, _0), _1) * part[k]
            strength *= intensity
            amount = math.sqrt(max(_1 - along * along, _0)) * (facing + rim * max(-opposite, _0)) * strength
            lr, lg, lb = lamps[k, COLOR], lamps[k, COLOR + 1], lamps[k, COLOR + 2]
            mean = amount * (lr + lg + lb) / np.float32(3.0)
            arrives, whole = arrives + mean, whole + mean / max(part[k], np.float32(0.02))
            red, green, blue = red + amount * lr, green + amount * lg, blue + amount * lb
            if facing > _0:  # the half vector's length is that of two unit vectors' sum
                lean = along + along_view
                square = min(max(_1 - lean * lean / max(_2 + _2 * opposite, np.float32(1e-6)), _0), _1)
                shine = _lobes(square, surface, inside) * facing * strength * gloss
                shine_r, shine_g, shine_b = shine_r + shine * lr, shine_g + shine * lg, shine_b + shine * lb
        basis = harmonics_of(ox, oy, oz)
        for channel in range(3):
            even = _0
            for k in range(9):
                even += basis[k] * colors[k, channel]
            out[i, channel] = even * intensity
        out[i, 0], out[i, 1], out[i, 2] = out[i, 0] + red, out[i, 1] + green, out[i, 2] + blue
        out[i, 3], out[i, 4], out[i, 5] = shine_r, shine_g, shine_b
        out[i, 6] = _1
        out[i, 7] = (arrives + np.float32(1e-6)) / (whole + np.float32(1e-6))
