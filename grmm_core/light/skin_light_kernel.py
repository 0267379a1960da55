"""The compiled twin of light at points of skin (`shading.transport`). Importing this loads numba.

All arrays are contiguous float32. Points are lit in blocks, as strands are (`strand_light_kernel`): what a block's points have
in common stands in one scratch array, so that the compiler does eight points at a time. What nobody asks for is left out by
block and lamp.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .light_kernels import BLOCK, COLOR, OPTIONS, SIZE, arriving_at_block, harmonics_of
from .shadow_kernels import single
from .skin_relief import FAINT, VALUES

_0, _1, _2, _3, _4, _HALF = single(0.0), single(1.0), single(2.0), single(3.0), single(4.0), single(0.5)
_TINY, _PI, _FAINT = single(1e-9), single(math.pi), single(FAINT)
_B = BLOCK
# where its quantities begin in the scratch array: three columns of a vector or a color, or one
_POINT, _NORMAL, _VIEW, _LAMP, _THROUGH, _WANDER = 0, 3 * _B, 6 * _B, 9 * _B, 12 * _B, 15 * _B
_POWER, _TO_EYE, _KNOWN, _PART, _LOOK, _SUMS, _TILT, _ROWS, _BASIS, _ALL = (
    18 * _B, 19 * _B, 20 * _B, 21 * _B, 22 * _B, 27 * _B, 35 * _B, 42 * _B, 51 * _B, 60 * _B
)  # fmt: skip


@compiled(inline="always", **OPTIONS)
def _lobe(alpha: float, tilt: float, cosine: float, facing: float) -> float:
    square = alpha * alpha
    base = tilt * tilt * (square - _1) + _1
    k = _HALF * alpha
    return square / (_PI * base * base * (cosine * (_1 - k) + k) * (facing * (_1 - k) + k))


@compiled(inline="always", **OPTIONS)
def _uneven(cosine: float, relief: float) -> float:
    """`shading.uneven` by the square of twice its `relief`."""
    return _HALF * (cosine + math.sqrt(cosine * cosine + relief))


@compiled(inline="always", **OPTIONS)
def _mirrored(rough: float, reflectance: float, facing: float) -> float:
    """`shading.mirrored_share` of a surface."""
    narrow = _1 - rough
    outline = min(narrow * narrow, np.float32(math.exp(np.float32(-9.28 * math.log(2.0)) * facing))) * narrow
    outline += np.float32(0.0425) - np.float32(0.0275) * rough
    by_reflectance = np.float32(1.04) - np.float32(0.572) * rough - np.float32(1.04) * outline
    return max(reflectance * by_reflectance + np.float32(1.04) * outline - np.float32(0.04) + np.float32(0.022) * rough, _0)


@compiled(**OPTIONS)
def _find(
    w: np.ndarray, points: np.ndarray, normals: np.ndarray, looks: tuple[np.ndarray, ...], rows: np.ndarray, eye: np.ndarray,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write what the lamps have in common of points `first` to `last`, the last one as often as the block has room."""
    for j in range(_B):
        i = min(first + j, last - 1)
        w[_POINT + j], w[_POINT + _B + j], w[_POINT + 2 * _B + j] = points[i, 0], points[i, 1], points[i, 2]
        w[_NORMAL + j], w[_NORMAL + _B + j], w[_NORMAL + 2 * _B + j] = normals[i, 0], normals[i, 1], normals[i, 2]
        for k in range(5):
            w[_LOOK + k * _B + j] = looks[k][i]
        w[_WANDER + j], w[_WANDER + _B + j] = looks[5][i], looks[5][i] * looks[6][i]
        for k in range(9):
            w[_ROWS + k * _B + j] = rows[i, k]
    for j in range(_B):
        vx, vy, vz = eye[0] - w[_POINT + j], eye[1] - w[_POINT + _B + j], eye[2] - w[_POINT + 2 * _B + j]
        inverse = _1 / max(math.sqrt(vx * vx + vy * vy + vz * vz), _TINY)
        vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
        w[_VIEW + j], w[_VIEW + _B + j], w[_VIEW + 2 * _B + j] = vx, vy, vz
        w[_TO_EYE + j] = w[_NORMAL + j] * vx + w[_NORMAL + _B + j] * vy + w[_NORMAL + 2 * _B + j] * vz
    w[_SUMS:_ROWS] = _0


@compiled(**OPTIONS)
def _coming_through(w: np.ndarray, seen: np.ndarray, factors: np.ndarray, first: int, last: int) -> bool:
    """Write which part of a lamp is seen, by color, with edges that flesh makes softer; return whether anybody asks."""
    asked = False
    for j in range(_B):
        part = seen[min(first + j, last - 1)]
        known = part >= _0
        asked = asked or known
        part = max(part, _0)
        w[_KNOWN + j], w[_PART + j] = _1 if known else _0, part
    for c in range(3):
        for j in range(_B):
            more = w[_WANDER + j] * factors[7 + c]
            w[_THROUGH + c * _B + j] = w[_PART + j] * (_1 + more) / (_1 + more * w[_PART + j])
    return asked


@compiled(**OPTIONS)
def shade(
    lamps: np.ndarray, points: np.ndarray, normals: np.ndarray, seen: np.ndarray, looks: tuple[np.ndarray, ...],
    rows: np.ndarray, eye: np.ndarray, turn: np.ndarray, colors: np.ndarray, mirrors: np.ndarray, factors: np.ndarray,
    out: np.ndarray, tilts: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Light at Gaussians of skin: what `shading.transport` and `Transport.light` give together.

    Args:
        lamps: Rows of `shading.lamp_rows`, [L, LAMP_VALUES].
        points: [N, 3].
        normals: [N, 3].
        seen: Below 0 where nobody asks, [L, N].
        looks: `Materials`, seven [N].
        rows: Of `transfer.transfer`, [N, 9].
        eye: [3].
        turn: From the axes of `rows` to those of the points, [3, 3].
        colors: Coefficients of the surroundings for irradiance, [9, 3].
        mirrors: The same for mirrored light, [9, 3].
        factors: Of all light and of highlights, of wandering by color, in metres, `shading.FADING` and `LEAST_FRONT`, and by
            how much shadows are softer, by color, and twice `materials.RELIEF`, [11].
        out: Written: `shading.Arrived.values`, [N, 8].
        tilts: Written: `shading.Transport.tilts` [N, 4], and behind them, if it has room, `leanings` [N, 3]; or [0, 4].
        first: Row of `out`.
        last: The row after the last.
    """
    intensity, gloss, fading, least = factors[0], factors[1], factors[5], factors[6]
    most = np.float32(0.9)
    w = np.empty(_ALL, np.float32)
    for start in range(first, last, _B):
        _find(w, points, normals, looks, rows, eye, start, last)
        for k in range(len(lamps)):
            if not _coming_through(w, seen[k], factors, start, last):
                continue
            arriving_at_block(w, lamps[k], _POINT, _LAMP, _POWER)
            red, green, blue, size = lamps[k, COLOR], lamps[k, COLOR + 1], lamps[k, COLOR + 2], lamps[k, SIZE]
            mean, wide = (red + green + blue) / np.float32(9.0), size * size
            for j in range(_B):
                lx, ly, lz, strength = w[_LAMP + j], w[_LAMP + _B + j], w[_LAMP + 2 * _B + j], w[_POWER + j] * intensity
                vx, vy, vz = w[_VIEW + j], w[_VIEW + _B + j], w[_VIEW + 2 * _B + j]
                nx, ny, nz = w[_NORMAL + j], w[_NORMAL + _B + j], w[_NORMAL + 2 * _B + j]
                cosine, bent = nx * lx + ny * ly + nz * lz, w[_WANDER + _B + j]
                wr, wg, wb = min(bent * factors[2], most), min(bent * factors[3], most), min(bent * factors[4], most)
                relief = w[_LOOK + _B + j] * w[_LOOK + _B + j] * factors[10]
                relief *= relief
                tr = _uneven(cosine + wr, relief) / ((_1 + wr) * (_1 + wr)) * strength
                tg = _uneven(cosine + wg, relief) / ((_1 + wg) * (_1 + wg)) * strength
                tb = _uneven(cosine + wb, relief) / ((_1 + wb) * (_1 + wb)) * strength
                w[_SUMS + 7 * _B + j] += (tr + tg + tb) * mean * w[_KNOWN + j]
                tr, tg, tb = tr * w[_THROUGH + j], tg * w[_THROUGH + _B + j], tb * w[_THROUGH + 2 * _B + j]
                w[_SUMS + 6 * _B + j] += (tr + tg + tb) * mean
                w[_SUMS + j] += tr * red
                w[_SUMS + _B + j] += tg * green
                w[_SUMS + 2 * _B + j] += tb * blue
                hx, hy, hz = lx + vx, ly + vy, lz + vz
                inverse = _1 / max(math.sqrt(hx * hx + hy * hy + hz * hz), _TINY)
                tilt = min(max((nx * hx + ny * hy + nz * hz) * inverse, _0), _1)
                away = _1 - min(max((vx * hx + vy * hy + vz * hz) * inverse, _0), _1)
                square, above = away * away, max(cosine, _0)
                facing, reflectance = min(max(w[_TO_EYE + j], np.float32(0.05)), _1), w[_LOOK + 3 * _B + j]
                fresnel = reflectance + (_1 - reflectance) * square * square * away
                smooth, rough, share = w[_LOOK + j], w[_LOOK + _B + j], w[_LOOK + 2 * _B + j]
                smooth, rough = smooth * smooth, rough * rough
                narrow = min(math.sqrt(smooth * smooth + wide), _1)
                broad = min(math.sqrt(rough * rough + wide), _1)
                sharp, wide_one = share * _lobe(narrow, tilt, above, facing), (_1 - share) * _lobe(broad, tilt, above, facing)
                factor = np.float32(0.25) * fresnel * w[_LOOK + 4 * _B + j] * above * w[_PART + j] * strength * gloss
                amount = (sharp + wide_one) * factor
                w[_SUMS + 3 * _B + j] += amount * red
                w[_SUMS + 4 * _B + j] += amount * green
                w[_SUMS + 5 * _B + j] += amount * blue
                # how much a lobe changes with the normal's tilt, and how quickly it falls to all sides
                tilt = max(tilt, np.float32(0.1))
                inverse, away = inverse / tilt, _1 / (tilt * tilt) - _1
                first_lobe, second_lobe = _1 / (narrow * narrow + away), _1 / (broad * broad + away)
                factor *= mean * _3
                sharp, wide_one = sharp * first_lobe * factor, wide_one * second_lobe * factor
                fall = narrow * narrow * first_lobe * sharp + broad * broad * second_lobe * wide_one
                slope = _4 * (sharp + wide_one)
                w[_TILT + j] += (hx * inverse - nx) * slope
                w[_TILT + _B + j] += (hy * inverse - ny) * slope
                w[_TILT + 2 * _B + j] += (hz * inverse - nz) * slope
                w[_TILT + 3 * _B + j] += _2 * fall
            if tilts.shape[1] > VALUES:
                for j in range(_B):
                    lx, ly, lz, through = w[_LAMP + j], w[_LAMP + _B + j], w[_LAMP + 2 * _B + j], w[_POWER + j] * w[_PART + j]
                    nx, ny, nz = w[_NORMAL + j], w[_NORMAL + _B + j], w[_NORMAL + 2 * _B + j]
                    cosine, relief = nx * lx + ny * ly + nz * lz, w[_LOOK + _B + j] * w[_LOOK + _B + j] * factors[10]
                    slope = _HALF + _HALF * cosine / max(math.sqrt(cosine * cosine + relief * relief), _TINY)
                    slope *= through * intensity * mean * _3
                    w[_TILT + 4 * _B + j] += (lx - cosine * nx) * slope
                    w[_TILT + 5 * _B + j] += (ly - cosine * ny) * slope
                    w[_TILT + 6 * _B + j] += (lz - cosine * nz) * slope
        for j in range(_B):
            towards_eye, share = w[_TO_EYE + j], w[_LOOK + 2 * _B + j]
            rough, facing = share * w[_LOOK + j] + (_1 - share) * w[_LOOK + _B + j], min(max(towards_eye, np.float32(0.05)), _1)
            free = min(max(w[_ROWS + j] / (_PI * np.float32(0.282095)), _0), _1)
            # what faces away has no highlights: they would be nobody's
            there = np.float32(_1 + fading * towards_eye > _0)
            glossy = _mirrored(rough, w[_LOOK + 3 * _B + j], facing) * w[_LOOK + 4 * _B + j] * free * gloss * intensity * there
            qx = _2 * towards_eye * w[_NORMAL + j] - w[_VIEW + j]
            qy = _2 * towards_eye * w[_NORMAL + _B + j] - w[_VIEW + _B + j]
            qz = _2 * towards_eye * w[_NORMAL + 2 * _B + j] - w[_VIEW + 2 * _B + j]
            x = turn[0, 0] * qx + turn[1, 0] * qy + turn[2, 0] * qz
            y = turn[0, 1] * qx + turn[1, 1] * qy + turn[2, 1] * qz
            z = turn[0, 2] * qx + turn[1, 2] * qy + turn[2, 2] * qz
            basis = harmonics_of(x, y, z)
            w[_BASIS + j], w[_BASIS + _B + j], w[_BASIS + 2 * _B + j] = basis[0] * glossy, basis[1] * glossy, basis[2] * glossy
            w[_BASIS + 3 * _B + j], w[_BASIS + 4 * _B + j] = basis[3] * glossy, basis[4] * glossy
            w[_BASIS + 5 * _B + j], w[_BASIS + 6 * _B + j] = basis[5] * glossy, basis[6] * glossy
            w[_BASIS + 7 * _B + j], w[_BASIS + 8 * _B + j] = basis[7] * glossy, basis[8] * glossy
            w[_SUMS + 3 * _B + j] *= there
            w[_SUMS + 4 * _B + j] *= there
            w[_SUMS + 5 * _B + j] *= there
        for c in range(3):
            for k in range(9):
                even, mirrored = colors[k, c] * intensity, mirrors[k, c]
                for j in range(_B):
                    w[_SUMS + c * _B + j] += w[_ROWS + k * _B + j] * even
                    w[_SUMS + (3 + c) * _B + j] += w[_BASIS + k * _B + j] * mirrored
        for j in range(min(_B, last - start)):
            i = start + j
            for c in range(6):
                out[i, c] = w[_SUMS + c * _B + j]
            out[i, 6] = min(max(_1 + fading * w[_TO_EYE + j], least), _1)
            out[i, 7] = (w[_SUMS + 6 * _B + j] + np.float32(1e-6)) / (w[_SUMS + 7 * _B + j] + np.float32(1e-6))
            if len(tilts):
                bright = (w[_SUMS + 3 * _B + j] + w[_SUMS + 4 * _B + j] + w[_SUMS + 5 * _B + j]) / _3
                inverse = _1 / bright if bright > _FAINT else _0
                for c in range(4):
                    tilts[i, c] = w[_TILT + c * _B + j] * inverse
                inverse = _3 / max(out[i, 0] + out[i, 1] + out[i, 2], _FAINT)
                for c in range(VALUES, tilts.shape[1]):
                    tilts[i, c] = w[_TILT + c * _B + j] * inverse
