"""The compiled twins of `Relief.heights` and `furrows.draw`. Importing this loads numba.

All arrays are contiguous float32 but for indices.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from ..light.mesh_light import FAR, NEAR
from ..light.shadow_kernels import OPTIONS, single
from .families import LINE_DEPTH
from .shade import BRIGHTEST, DARKEST, DEPTHS, GROOVE, LEVELS, TILT

_0, _1, _HALF = single(0.0), single(1.0), single(0.5)
_NEAR, _FAR, _TILT, _DEPTH = single(NEAR), single(FAR), single(TILT), single(LINE_DEPTH)
_LOST = np.array(GROOVE, np.float32)
# the power 1 / 2.2 as a root and a cubic: right to 0.0003 between DARKEST and BRIGHTEST
_A, _B, _C, _D = single(1.10057756), single(-0.1896713), single(0.12203938), single(-0.0329282)
_TINY = single(1e-12)
_PIECE = 512  # of a relief's pixels at a time


@compiled(**OPTIONS)
def raise_skin(
    places: np.ndarray, used: np.ndarray, amounts: np.ndarray, channels: np.ndarray, held: np.ndarray, lines: np.ndarray,
    pixel: np.ndarray, height: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Heights of furrowed pixels of a relief; see `Relief.heights`.

    Args:
        places: [F, n].
        used: Families that are driven, [U].
        amounts: How far, [U].
        channels: Of these families, [U].
        held: What is taken from what drives, [3, n].
        lines: [3, n].
        pixel: [n].
        height: Written there.
        first: Of the pixels.
        last: The one after the last.
    """
    drive, total = np.empty(_PIECE, np.float32), np.empty(_PIECE, np.float32)
    for low in range(first, last, _PIECE):
        count = min(_PIECE, last - low)
        total[:] = _0
        for channel in range(len(lines)):
            drive[:] = _0
            for k in range(len(used)):
                if channels[k] == channel:
                    place, amount = places[used[k], low : low + count], amounts[k]
                    for n in range(count):
                        drive[n] += amount * place[n]
            line, taken = lines[channel, low : low + count], held[channel, low : low + count]
            for n in range(count):
                total[n] += line[n] * max(min(drive[n], _1) - taken[n], _0)
        for n in range(count):
            height[pixel[low + n]] = total[n]


@compiled(**OPTIONS)
def _sample(levels: np.ndarray, rows: int, columns: int, first: int, x: float, y: float, out: np.ndarray) -> None:
    """Slope along columns and rows, a pixel of this size, and height at a place: into `out`, [3]."""
    j, i = min(max(math.floor(x), 1), columns - 3), min(max(math.floor(y), 1), rows - 3)
    p, q = min(max(np.float32(x - j), _0), _1), min(max(np.float32(y - i), _0), _1)
    above, here = first + (i - 1) * columns + j, first + i * columns + j
    below, under = here + columns, here + 2 * columns
    a, b, c, d = levels[here - 1], levels[here], levels[here + 1], levels[here + 2]
    e, f, g, h = levels[below - 1], levels[below], levels[below + 1], levels[below + 2]
    left = (_1 - q) * ((_1 - p) * a + p * b) + q * ((_1 - p) * e + p * f)
    middle = (_1 - q) * ((_1 - p) * b + p * c) + q * ((_1 - p) * f + p * g)
    right = (_1 - q) * ((_1 - p) * c + p * d) + q * ((_1 - p) * g + p * h)
    upper = (_1 - q) * ((_1 - p) * levels[above] + p * levels[above + 1]) + q * ((_1 - p) * b + p * c)
    lower = (_1 - q) * ((_1 - p) * f + p * g) + q * ((_1 - p) * levels[under] + p * levels[under + 1])
    out[0], out[1], out[2] = _HALF * (right - left), _HALF * (lower - upper), middle


@compiled(**OPTIONS)
def _irradiance(x: float, y: float, z: float, light: np.ndarray, channel: int) -> float:
    """Harmonics (`light.surroundings.basis`) times coefficients [9, 3] of one color."""
    return (
        single(0.282095) * light[0, channel]
        + single(0.488603) * (y * light[1, channel] + z * light[2, channel] + x * light[3, channel])
        + single(1.092548) * (x * y * light[4, channel] + y * z * light[5, channel] + x * z * light[7, channel])
        + single(0.315392) * (single(3.0) * z * z - _1) * light[6, channel]
        + single(0.546274) * (x * x - y * y) * light[8, channel]
    )


@compiled(**OPTIONS)
def draw(
    picture: np.ndarray, depth: np.ndarray, share: np.ndarray, seen: np.ndarray, faces: np.ndarray, places: np.ndarray,
    vertices: np.ndarray, normals: np.ndarray, flat: bool, levels: np.ndarray, size: tuple[int, int], light: np.ndarray,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Draw furrows into the rows `start` to `stop` of a picture; see `furrows.draw`."""
    width = depth.shape[1]
    found, total = np.empty(3, np.float32), np.empty(3, np.float32)
    least = single(0.05 * 0.282095) * max(light[0, 0], light[0, 1], light[0, 2])
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, bx, by, cx, cy = seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        low_x, high_x, low_y, high_y = min(ax, bx, cx), max(ax, bx, cx), min(ay, by, cy), max(ay, by, cy)
        if not (area < _0 and high_x > _0 and low_x < width and high_y > start and low_y < stop):
            continue
        left, right = max(math.ceil(low_x - _HALF), 0), min(math.floor(high_x - _HALF), width - 1)
        top, bottom = max(math.ceil(low_y - _HALF), start), min(math.floor(high_y - _HALF), stop - 1)
        if left > right or top > bottom:
            continue
        inverse = _1 / area
        u_x, u_y, v_x, v_y = (cy - ay) * inverse, (ax - cx) * inverse, (ay - by) * inverse, (bx - ax) * inverse
        ex, ey = places[t, 1, 0] - places[t, 0, 0], places[t, 1, 1] - places[t, 0, 1]
        fx, fy = places[t, 2, 0] - places[t, 0, 0], places[t, 2, 1] - places[t, 0, 1]
        across = math.sqrt((ex * u_x + fx * v_x) ** 2 + (ey * u_x + fy * v_x) ** 2)
        down = math.sqrt((ex * u_y + fx * v_y) ** 2 + (ey * u_y + fy * v_y) ** 2)
        level = min(max(math.log2(max(across, down, single(1e-6))), 0.0), LEVELS - 1.0)
        low = min(int(level), LEVELS - 2)
        # how far a pixel of the relief reaches along columns and rows, and what turns slopes into a tilt
        spread = ex * fy - fx * ey
        if abs(spread) < _TINY:
            continue
        p0, p1, p2 = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        q0, q1, q2 = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        i0, i1, i2 = (p0 * fy - q0 * ey) / spread, (p1 * fy - q1 * ey) / spread, (p2 * fy - q2 * ey) / spread
        j0, j1, j2 = (q0 * ex - p0 * fx) / spread, (q1 * ex - p1 * fx) / spread, (q2 * ex - p2 * fx) / spread
        ii, ij, jj = i0 * i0 + i1 * i1 + i2 * i2, i0 * j0 + i1 * j1 + i2 * j2, j0 * j0 + j1 * j1 + j2 * j2
        metric = ii * jj - ij * ij
        if metric < _TINY * _TINY:
            continue
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                dx, dy = np.float32(column) + _HALF - ax, np.float32(row) + _HALF - ay
                u, v = u_x * dx + u_y * dy, v_x * dx + v_y * dy
                w = _1 - u - v
                if min(u, v, w) < _0:
                    continue
                value = w * seen[a, 2] + u * seen[b, 2] + v * seen[c, 2]
                deep = value if flat else _1 / value
                amount = min((_FAR - abs(depth[row, column] - deep)) / (_FAR - _NEAR), _1) * share[row, column]
                if amount <= _0:
                    continue
                if not flat:
                    u, v, w = u * seen[b, 2] * deep, v * seen[c, 2] * deep, w * seen[a, 2] * deep
                x = w * places[t, 0, 0] + u * places[t, 1, 0] + v * places[t, 2, 0]
                y = w * places[t, 0, 1] + u * places[t, 1, 1] + v * places[t, 2, 1]
                total[:] = _0
                first = 0
                for number in range(low + 2):
                    rows, columns = size[0] >> number, size[1] >> number
                    if number >= low:
                        weight = single(low + 1 - level) if number == low else single(level - low)
                        wide = single(1 << number)
                        _sample(levels, rows, columns, first, (x + _HALF) / wide - _HALF, (y + _HALF) / wide - _HALF, found)
                        total[0] += weight * found[0] / wide
                        total[1] += weight * found[1] / wide
                        total[2] += weight * found[2]
                    first += rows * columns
                if total[0] == _0 and total[1] == _0 and total[2] == _0:
                    continue
                g, h = (jj * total[0] - ij * total[1]) / metric, (ii * total[1] - ij * total[0]) / metric
                nx = w * normals[a, 0] + u * normals[b, 0] + v * normals[c, 0]
                ny = w * normals[a, 1] + u * normals[b, 1] + v * normals[c, 1]
                nz = w * normals[a, 2] + u * normals[b, 2] + v * normals[c, 2]
                length = _1 / max(math.sqrt(nx * nx + ny * ny + nz * nz), _TINY)
                nx, ny, nz = nx * length, ny * length, nz * length
                mx = nx - _TILT * (g * i0 + h * j0)
                my = ny - _TILT * (g * i1 + h * j1)
                mz = nz - _TILT * (g * i2 + h * j2)
                length = _1 / max(math.sqrt(mx * mx + my * my + mz * mz), _TINY)
                mx, my, mz = mx * length, my * length, mz * length
                groove = min(max(total[2] / _DEPTH, single(DEPTHS[0])), single(DEPTHS[1]))
                for channel in range(3):
                    before = max(_irradiance(nx, ny, nz, light, channel), least)
                    ratio = max(_irradiance(mx, my, mz, light, channel), least) / before
                    ratio *= _1 + groove * _LOST[channel]
                    factor = _1 + (min(max(ratio, single(DARKEST)), single(BRIGHTEST)) - _1) * amount
                    picture[row, column, channel] *= math.sqrt(factor) * (_A + factor * (_B + factor * (_C + factor * _D)))
