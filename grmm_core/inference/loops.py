"""Compiled loops of the model that are neither convolutions nor the rasteriser; importing this module loads numba.

Twins of the torch code in `model`: `CompressedRows` products of `model.sparse`, packed basis maps of `files.packing`, the UV
corners of `model.texels`. All arrays are contiguous; sizes as in the argument lists. Each does the rows from
`first` to `last` - 1: see `compute.threads.for_rows`.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from ..files.packing import BLOCK
from ..model.placing import HEIGHT, QW, QX, QY, QZ, WIDTH, X

OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy"}
# Pictures are crops or whole: with the types named one compiled form takes both.
PICTURE, CHANNELS, PLANES = "float32[:, :]", "float32[:, :, :]", "float32[:, :, ::1]"
_FOLD_PIXELS = f"void({CHANNELS}, {CHANNELS}, {PICTURE}, int64, float32[:, ::1], float32[::1], float32, {PLANES}, int64, int64)"
_UNFOLD_RESIDUAL = f"void({CHANNELS}, {PICTURE}, {PLANES}, int64, {PLANES}, int64, int64)"
_LINEAR = f"void({CHANNELS}, {PICTURE}, float32, float32[::1], {PLANES}, int64, int64)"
_ONE, _TWO = np.float32(1.0), np.float32(2.0)
_TINY = np.float32(1e-9)  # metres per unit of UV; keeps frames of degenerate triangles defined
_BLOCKS = 128  # of a row of folded pixels at a time: what the layer sees of them stays in the nearest cache
_TINY_NORM = np.float32(1e-20)


@compiled(nogil=True, **OPTIONS)
def add_product(
    starts: np.ndarray, columns: np.ndarray, values: np.ndarray, x: np.ndarray, out: np.ndarray, first: int, last: int
) -> None:
    """Add A x [R, C] to `out`, for a sparse matrix A by rows and x [K, C]; rows of A."""
    for row in range(first, last):
        for entry in range(starts[row], starts[row + 1]):
            value, source = values[entry], columns[entry]
            for channel in range(x.shape[1]):
                out[row, channel] += value * x[source, channel]


@compiled(nogil=True, **OPTIONS)
def add_packed_maps(weights: np.ndarray, whole: np.ndarray, scales: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
    """Add the weighted sum of packed maps to `out` [M]: weights [K], whole numbers [K, M], scales [K, B]; rows of `out`."""
    for block in range(first // BLOCK, (last + BLOCK - 1) // BLOCK):
        low, high = max(first, block * BLOCK), min(last, (block + 1) * BLOCK)
        for k in range(len(weights)):
            factor = weights[k] * scales[k, block]
            for m in range(low, high):
                out[m] += factor * np.float32(whole[k, m])


@compiled(nogil=True, **OPTIONS)
def add_maps(weights: np.ndarray, maps: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
    """Add the weighted sum of maps to `out` [M]: weights [K], maps [K, M]; rows of `out`."""
    for low in range(first, last, BLOCK):
        for k in range(len(weights)):
            for m in range(low, min(low + BLOCK, last)):
                out[m] += weights[k] * maps[k, m]


@compiled(nogil=True, **OPTIONS)
def _copy_columns(source: np.ndarray, out: np.ndarray) -> None:
    """Transpose [n, C] into the first n columns of [C, >= n]."""
    for channel in range(source.shape[1]):
        column, target = source[:, channel], out[channel]
        for x in range(len(column)):
            target[x] = column[x]


@compiled(nogil=True, signature_or_function=_FOLD_PIXELS, **OPTIONS)
def fold_pixels(
    rgb: np.ndarray, features: np.ndarray, depth: np.ndarray, fold: int, weight: np.ndarray, bias: np.ndarray,
    slope: np.float32, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """First layer of the refinement network: blocks of pixels to channels, weighted and rectified.

    Args:
        rgb: [H, W, 3].
        features: [H, W, F].
        depth: Normalised, [H, W].
        fold: Pixels of a block's side; what lies off the picture counts as 0.
        weight: [O, K], K = fold^2 (4 + F) and zeros up to a multiple of 4: by row and column in the block, color, features,
            depth.
        bias: [O].
        slope: Of the leaky rectifier.
        out: Written, [O, h, w].
        first: Row of blocks.
        last: The row after the last.
    """
    height, width, count = rgb.shape[0], rgb.shape[1], features.shape[2]
    seen = np.zeros((weight.shape[1], _BLOCKS), np.float32)
    total = np.empty((2, _BLOCKS), np.float32)
    for y in range(first, last):
        for left in range(0, out.shape[2], _BLOCKS):
            size = min(_BLOCKS, out.shape[2] - left)
            for place in range(fold * fold):
                row, start = y * fold + place // fold, left * fold + place % fold
                part = seen[place * (4 + count) : (place + 1) * (4 + count)]
                inside = max(min(size, (width - start + fold - 1) // fold), 0) if row < height else 0
                part[:, inside:] = 0.0
                if inside > 0:
                    stop = start + (inside - 1) * fold + 1
                    _copy_columns(rgb[row, start:stop:fold], part[:3])
                    _copy_columns(features[row, start:stop:fold], part[3 : 3 + count])
                    _copy_columns(depth[row, start:stop:fold, None], part[3 + count :])
            for channel in range(0, len(out), 2):  # two at a time, of four products: eight for six loads and stores
                beside = min(channel + 1, len(out) - 1)
                total[0], total[1] = bias[channel], bias[beside]
                for k in range(0, len(seen), 4):
                    a, b, c, d = weight[channel, k], weight[channel, k + 1], weight[channel, k + 2], weight[channel, k + 3]
                    e, f, g, h = weight[beside, k], weight[beside, k + 1], weight[beside, k + 2], weight[beside, k + 3]
                    for x in range(size):
                        p, q, r, s = seen[k, x], seen[k + 1, x], seen[k + 2, x], seen[k + 3, x]
                        total[0, x] += a * p + b * q + c * r + d * s
                        total[1, x] += e * p + f * q + g * r + h * s
                for one in range(channel, beside + 1):
                    target, own = out[one, y, left : left + size], total[one - channel]
                    for x in range(size):
                        target[x] = max(own[x], slope * own[x])


@compiled(nogil=True, signature_or_function=_UNFOLD_RESIDUAL, **OPTIONS)
def unfold_residual(
    rgb: np.ndarray, alpha: np.ndarray, residual: np.ndarray, fold: int, out: np.ndarray, first: int, last: int
) -> None:
    """Add the network's residual times alpha to a picture (the end of eq. 14).

    Args:
        rgb: [H, W, 3].
        alpha: [H, W].
        residual: [3 fold^2, h, w]: by color, then row and column in the block.
        fold: Pixels of a block's side.
        out: Written, [H, W, 3].
        first: Row of the picture.
        last: The row after the last.
    """
    for row in range(first, last):
        for shift in range(fold):
            cover = alpha[row, shift::fold]
            for channel in range(3):
                change = residual[(channel * fold + row % fold) * fold + shift, row // fold]
                before, after = rgb[row, shift::fold, channel], out[row, shift::fold, channel]
                for x in range(len(cover)):
                    after[x] = before[x] + cover[x] * change[x]


@compiled(nogil=True, signature_or_function=_LINEAR, **OPTIONS)
def premultiplied_linear(
    rgb: np.ndarray, alpha: np.ndarray, least: np.float32, curve: np.ndarray, out: np.ndarray, first: int, last: int
) -> None:
    """`color.scene_linear_premultiplied` of rows of a picture, by a table.

    Args:
        rgb: Premultiplied display sRGB, [H, W, 3].
        alpha: [H, W]; colors below `least` are left black.
        least: See `color.MIN_ALPHA`.
        curve: Linear values of 0..1 in even steps; between two of them it is straight.
        out: Written, [H, W, 4].
        first: Row of the picture.
        last: The row after the last.
    """
    steps, top = np.float32(len(curve) - 1), np.uint32(len(curve) - 2)
    for y in range(first, last):
        for x in range(alpha.shape[1]):
            cover = min(max(alpha[y, x], np.float32(0.0)), _ONE)
            out[y, x, 3] = cover
            if cover < least:  # half of a picture and more is empty
                out[y, x, 0] = out[y, x, 1] = out[y, x, 2] = np.float32(0.0)
                continue
            scale = steps / cover
            for k in range(3):
                place = min(max(rgb[y, x, k] * scale, np.float32(0.0)), steps)
                at = min(np.uint32(place), top)
                low = curve[at]
                out[y, x, k] = cover * (low + (curve[at + np.uint32(1)] - low) * (place - np.float32(at)))


@compiled(nogil=True, **OPTIONS)
def uv_corners(
    starts: np.ndarray, columns: np.ndarray, values: np.ndarray, vertices: np.ndarray, corner_vertex: np.ndarray,
    outward: np.ndarray, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Position, |dP/du|, |dP/dv| across it, and quaternion wxyz of the tangent frame at the UV corners.

    Args:
        starts: Of the rows of the Jacobian [2 T, V]: dP/du, then dP/dv.
        columns: Of its entries.
        values: Of its entries.
        vertices: [V, 3] metres.
        corner_vertex: [T].
        outward: 1 or -1, [T].
        out: Written, [T, CORNER_VALUES] of `placing`.
        first: Row of `out`.
        last: The row after the last.
    """
    count = len(corner_vertex)
    for t in range(first, last):
        ux, uy, uz = _TINY, np.float32(0.0), np.float32(0.0)
        for entry in range(starts[t], starts[t + 1]):
            value, v = values[entry], columns[entry]
            ux += value * vertices[v, 0]
            uy += value * vertices[v, 1]
            uz += value * vertices[v, 2]
        vx, vy, vz = np.float32(0.0), _TINY, np.float32(0.0)
        for entry in range(starts[count + t], starts[count + t + 1]):
            value, v = values[entry], columns[entry]
            vx += value * vertices[v, 0]
            vy += value * vertices[v, 1]
            vz += value * vertices[v, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        inverse = outward[t] / math.sqrt(max(nx * nx + ny * ny + nz * nz, _TINY_NORM))
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        width = math.sqrt(ux * ux + uy * uy + uz * uz)
        inverse = _ONE / max(width, np.float32(1e-10))
        tx, ty, tz = ux * inverse, uy * inverse, uz * inverse
        bx, by, bz = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        for k in range(3):
            out[t, X + k] = vertices[corner_vertex[t], k]
        out[t, WIDTH] = width
        out[t, HEIGHT] = abs(vx * bx + vy * by + vz * bz)
        # rows of 4 q q^T are linear in the matrix [tangent, bitangent, normal]; the one with the largest diagonal is q
        ww, xx, yy, zz = _ONE + tx + by + nz, _ONE + tx - by - nz, _ONE - tx + by - nz, _ONE - tx - by + nz
        wx, wy, wz = bz - ny, nx - tz, ty - bx
        xy, xz, yz = ty + bx, nx + tz, bz + ny
        if ww >= xx and ww >= yy and ww >= zz:
            a, b, c, d = ww, wx, wy, wz
        elif xx >= yy and xx >= zz:
            a, b, c, d = wx, xx, xy, xz
        elif yy >= zz:
            a, b, c, d = wy, xy, yy, yz
        else:
            a, b, c, d = wz, xz, yz, zz
        inverse = _ONE / math.sqrt(max(a * a + b * b + c * c + d * d, _TINY_NORM))
        out[t, QW], out[t, QX], out[t, QY], out[t, QZ] = a * inverse, b * inverse, c * inverse, d * inverse
