"""The compiled twin of light at strands (`hair_shading`). Importing this loads numba.

All arrays are contiguous float32. What takes `first` and `last` does these rows (`compute.threads.for_rows`). Pieces are lit in
blocks, each quantity of a block beside the last in one scratch array: so the compiler knows that none overlaps another, and
does eight pieces at a time.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .light_kernels import BLOCK, COLOR, OPTIONS, arriving_at_block, harmonics_of
from .shadow_kernels import single

_0, _1, _2, _3, _TINY = single(0.0), single(1.0), single(2.0), single(3.0), single(1e-9)
_B = BLOCK
# where its quantities begin in the scratch array: three columns of a vector, or one
_POINT, _TANGENT, _OUTWARD, _VIEW, _LAMP = 0, 3 * _B, 6 * _B, 9 * _B, 12 * _B
_POWER, _ALONG, _SUMS, _PARTS = 15 * _B, 16 * _B, 17 * _B, 25 * _B


@compiled(inline="always", **OPTIONS)
def _lobes(square: float, surface: float, inside: float) -> tuple[float, float]:
    """Both of `hair_shading._LOBES`, multiplied out, of the squared cosine between normal plane and half vector."""
    two = square * square
    four = two * two
    eight = four * four
    sixteen = eight * eight
    return surface * sixteen * sixteen * sixteen * eight * four, inside * eight * square


@compiled(**OPTIONS)
def _find(
    w: np.ndarray, points: np.ndarray, quats: np.ndarray, parts: np.ndarray, to_grid: np.ndarray, centre: np.ndarray,
    eye: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Write what the lamps have in common of pieces `first` to `last`, the last one as often as the block has room."""
    most_x, most_y, most_z = (
        np.float32(parts.shape[0] - 1.001), np.float32(parts.shape[1] - 1.001), np.float32(parts.shape[2] - 1.001)
    )  # fmt: skip
    # unsigned, so that the compiler need not look for negative indices
    high, deep, lamps = np.uint64(parts.shape[1]), np.uint64(parts.shape[2]), np.uint64(parts.shape[3])
    across, up, ahead, flat = high * deep * lamps, deep * lamps, lamps, parts.reshape(-1)
    corners = np.empty(8, np.float32)
    for j in range(_B):
        i = min(first + j, last - 1)
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        gx = to_grid[0, 0] * px + to_grid[0, 1] * py + to_grid[0, 2] * pz + to_grid[0, 3]
        gy = to_grid[1, 0] * px + to_grid[1, 1] * py + to_grid[1, 2] * pz + to_grid[1, 3]
        gz = to_grid[2, 0] * px + to_grid[2, 1] * py + to_grid[2, 2] * pz + to_grid[2, 3]
        gx, gy, gz = min(max(gx, _0), most_x), min(max(gy, _0), most_y), min(max(gz, _0), most_z)
        a, b, c = int(gx), int(gy), int(gz)
        u, v, t = gx - np.float32(a), gy - np.float32(b), gz - np.float32(c)
        corners[0], corners[1] = (_1 - u) * (_1 - v) * (_1 - t), (_1 - u) * (_1 - v) * t
        corners[2], corners[3] = (_1 - u) * v * (_1 - t), (_1 - u) * v * t
        corners[4], corners[5] = u * (_1 - v) * (_1 - t), u * (_1 - v) * t
        corners[6], corners[7] = u * v * (_1 - t), u * v * t
        at = ((np.uint64(a) * high + np.uint64(b)) * deep + np.uint64(c)) * lamps
        for k in range(parts.shape[3]):
            w[_PARTS + k * _B + j] = (
                corners[0] * flat[at] + corners[1] * flat[at + ahead] + corners[2] * flat[at + up]
                + corners[3] * flat[at + up + ahead] + corners[4] * flat[at + across] + corners[5] * flat[at + across + ahead]
                + corners[6] * flat[at + across + up] + corners[7] * flat[at + across + up + ahead]
            )  # fmt: skip
            at += np.uint64(1)
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        w[_POINT + j], w[_POINT + _B + j], w[_POINT + 2 * _B + j] = px, py, pz
        w[_TANGENT + j], w[_TANGENT + _B + j] = _1 - _2 * (qy * qy + qz * qz), _2 * (qx * qy + qw * qz)
        w[_TANGENT + 2 * _B + j] = _2 * (qx * qz - qw * qy)
    for j in range(_B):
        px, py, pz = w[_POINT + j], w[_POINT + _B + j], w[_POINT + 2 * _B + j]
        ox, oy, oz = px - centre[0], py - centre[1], pz - centre[2]
        inverse = _1 / max(math.sqrt(ox * ox + oy * oy + oz * oz), _TINY)
        ox, oy, oz = ox * inverse, oy * inverse, oz * inverse
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        inverse = _1 / max(math.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
        vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
        w[_OUTWARD + j], w[_OUTWARD + _B + j], w[_OUTWARD + 2 * _B + j] = ox, oy, oz
        w[_VIEW + j], w[_VIEW + _B + j], w[_VIEW + 2 * _B + j] = vx, vy, vz
        w[_ALONG + j] = w[_TANGENT + j] * vx + w[_TANGENT + _B + j] * vy + w[_TANGENT + 2 * _B + j] * vz
    w[_SUMS:_PARTS] = _0


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
        factors: Of all light and of highlights, how far light reaches around, strengths of lobes, `hair_shading._HIDING`, [6].
        out: Written: `shading.Arrived.values`, [N, 8].
        first: Row of `out`.
        last: The row after the last.
    """
    intensity, gloss, reach, surface, inside, hiding = factors[0], factors[1], factors[2], factors[3], factors[4], factors[5]
    w, nearer = np.empty(_PARTS + len(lamps) * _B, np.float32), _1 / (_1 + reach)
    for start in range(first, last, _B):
        _find(w, points, quats, parts, to_grid, centre, eye, start, last)
        for k in range(len(lamps)):
            arriving_at_block(w, lamps[k], _POINT, _LAMP, _POWER)
            red, green, blue = lamps[k, COLOR], lamps[k, COLOR + 1], lamps[k, COLOR + 2]
            mean, offset = (red + green + blue) / _3, _PARTS + k * _B
            for j in range(_B):
                lx, ly, lz, part = w[_LAMP + j], w[_LAMP + _B + j], w[_LAMP + 2 * _B + j], w[offset + j]
                along = w[_TANGENT + j] * lx + w[_TANGENT + _B + j] * ly + w[_TANGENT + 2 * _B + j] * lz
                opposite = w[_VIEW + j] * lx + w[_VIEW + _B + j] * ly + w[_VIEW + 2 * _B + j] * lz
                facing = w[_OUTWARD + j] * lx + w[_OUTWARD + _B + j] * ly + w[_OUTWARD + 2 * _B + j] * lz
                open_ = min(max((facing + reach) * nearer, _0), _1) * w[_POWER + j] * intensity
                part /= part + (_1 - part) * (_1 - hiding * opposite) * (_1 - hiding * opposite) + _TINY
                # the half vector's length is that of two unit vectors' sum
                lean = along + w[_ALONG + j]
                square = min(max(_1 - lean * lean / max(_2 + _2 * opposite, np.float32(1e-6)), _0), _1)
                glint, colored = _lobes(square, surface, inside)
                whole = (_1 + colored) * open_
                amount, shine = whole * part, glint * open_ * part * gloss
                w[_SUMS + j] += amount * red
                w[_SUMS + _B + j] += amount * green
                w[_SUMS + 2 * _B + j] += amount * blue
                w[_SUMS + 3 * _B + j] += shine * red
                w[_SUMS + 4 * _B + j] += shine * green
                w[_SUMS + 5 * _B + j] += shine * blue
                w[_SUMS + 6 * _B + j] += amount * mean
                w[_SUMS + 7 * _B + j] += whole * mean
        for j in range(min(_B, last - start)):
            i, basis = start + j, harmonics_of(w[_OUTWARD + j], w[_OUTWARD + _B + j], w[_OUTWARD + 2 * _B + j])
            for channel in range(3):
                even = _0
                for k in range(9):
                    even += basis[k] * colors[k, channel]
                out[i, channel] = even * intensity + w[_SUMS + channel * _B + j]
                out[i, 3 + channel] = w[_SUMS + (3 + channel) * _B + j]
            out[i, 6] = _1
            out[i, 7] = (w[_SUMS + 6 * _B + j] + np.float32(1e-6)) / (w[_SUMS + 7 * _B + j] + np.float32(1e-6))
