"""The compiled part of `texels`: interpolation, tangent frames and offsets of all texels in one pass, with its gradient.

The same mathematics as `TexelAnchor.forward` and `place_gaussians`, texel by texel instead of array by array, which saves a CPU
most of the time (every frame of an animation needs this). Importing this module loads numba.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ..compute.kernels import compiled

_OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy"}
_ONE, _TWO = np.float32(1.0), np.float32(2.0)
_TINY_NORM = np.float32(1e-20)


@compiled(inline="always", **_OPTIONS)
def _bend(x):  # noqa: ANN001, ANN202
    """Factor of the soft limit: with it x stays below 1, and the slope is its cube."""
    return _ONE / math.sqrt(_ONE + x * x)


@compiled(inline="always", **_OPTIONS)
def _frame(corners, corner, barycentric, i):  # noqa: ANN001, ANN202 - numba infers scalar types
    """Position, sides and raw quaternion of texel i, and the signs that bring its corners' quaternions together."""
    a, b, c = corner[i, 0], corner[i, 1], corner[i, 2]
    wa, wb, wc = barycentric[i, 0], barycentric[i, 1], barycentric[i, 2]
    dot_b = dot_c = np.float32(0.0)
    for k in range(5, 9):
        dot_b += corners[a, k] * corners[b, k]
        dot_c += corners[a, k] * corners[c, k]
    sb = -wb if dot_b < 0 else wb
    sc = -wc if dot_c < 0 else wc
    px = wa * corners[a, 0] + wb * corners[b, 0] + wc * corners[c, 0]
    py = wa * corners[a, 1] + wb * corners[b, 1] + wc * corners[c, 1]
    pz = wa * corners[a, 2] + wb * corners[b, 2] + wc * corners[c, 2]
    width = wa * corners[a, 3] + wb * corners[b, 3] + wc * corners[c, 3]
    height = wa * corners[a, 4] + wb * corners[b, 4] + wc * corners[c, 4]
    q0 = wa * corners[a, 5] + sb * corners[b, 5] + sc * corners[c, 5]
    q1 = wa * corners[a, 6] + sb * corners[b, 6] + sc * corners[c, 6]
    q2 = wa * corners[a, 7] + sb * corners[b, 7] + sc * corners[c, 7]
    q3 = wa * corners[a, 8] + sb * corners[b, 8] + sc * corners[c, 8]
    return px, py, pz, width, height, q0, q1, q2, q3, sb, sc


@compiled(parallel=True, **_OPTIONS)
def place_forward(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, offsets: np.ndarray, settings: np.ndarray,
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray,
) -> None:  # fmt: skip
    """Place every Gaussian.

    Args:
        corners: Position, width, height, quaternion at the corners of the UV map, [T, 9] float32.
        corner: Corners of each texel's face, [N, 3] int32.
        barycentric: [N, 3] float32.
        offsets: [N, 10] float32.
        settings: Position unit and limit in metres, limit of the log scale (0: none), texel scale, normal scale, [5] float32;
            both scales divided by the grid's side.
        means: Written, [N, 3].
        quats: Written, [N, 4].
        scales: Written, [N, 3].
    """
    unit, texel_scale, normal_scale = settings[0], settings[3], settings[4]
    bound = unit / settings[1]
    log_bound = _ONE / settings[2] if settings[2] > 0 else np.float32(0.0)
    for i in numba.prange(len(corner)):
        px, py, pz, width, height, w, x, y, z, _, _ = _frame(corners, corner, barycentric, i)
        inverse = _ONE / math.sqrt(max(w * w + x * x + y * y + z * z, _TINY_NORM))
        w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
        mx = unit * offsets[i, 0] * _bend(offsets[i, 0] * bound)
        my = unit * offsets[i, 1] * _bend(offsets[i, 1] * bound)
        mz = unit * offsets[i, 2] * _bend(offsets[i, 2] * bound)
        tx, ty, tz = _TWO * (y * mz - z * my), _TWO * (z * mx - x * mz), _TWO * (x * my - y * mx)
        means[i, 0] = px + mx + w * tx + y * tz - z * ty
        means[i, 1] = py + my + w * ty + z * tx - x * tz
        means[i, 2] = pz + mz + w * tz + x * ty - y * tx
        rw, rx, ry, rz = offsets[i, 3] + _ONE, offsets[i, 4], offsets[i, 5], offsets[i, 6]
        a = w * rw - x * rx - y * ry - z * rz
        b = w * rx + rw * x + y * rz - z * ry
        c = w * ry + rw * y + z * rx - x * rz
        d = w * rz + rw * z + x * ry - y * rx
        inverse = _ONE / math.sqrt(max(a * a + b * b + c * c + d * d, _TINY_NORM))
        quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3] = a * inverse, b * inverse, c * inverse, d * inverse
        for k in range(3):
            grow = offsets[i, 7 + k] * _bend(offsets[i, 7 + k] * log_bound)
            base = width * texel_scale if k == 0 else height * texel_scale if k == 1 else min(width, height) * normal_scale
            scales[i, k] = base * math.exp(grow)


@compiled(parallel=True, **_OPTIONS)
def place_backward(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, offsets: np.ndarray, settings: np.ndarray,
    g_means: np.ndarray, g_quats: np.ndarray, g_scales: np.ndarray, g_offsets: np.ndarray, g_texels: np.ndarray,
) -> None:  # fmt: skip
    """Gradients of `place_forward`.

    Args:
        corners: As there.
        corner: As there.
        barycentric: As there.
        offsets: As there.
        settings: As there.
        g_means: Of the means, [N, 3].
        g_quats: Of the quaternions, [N, 4].
        g_scales: Of the scales, [N, 3].
        g_offsets: Written, [N, 10].
        g_texels: Written: of the interpolated corner values, [N, 9], for `scatter`.
    """
    unit, texel_scale, normal_scale = settings[0], settings[3], settings[4]
    bound = unit / settings[1]
    log_bound = _ONE / settings[2] if settings[2] > 0 else np.float32(0.0)
    for i in numba.prange(len(corner)):
        _, _, _, width, height, w, x, y, z, _, _ = _frame(corners, corner, barycentric, i)
        inverse = _ONE / math.sqrt(max(w * w + x * x + y * y + z * z, _TINY_NORM))
        w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
        sx, sy, sz = _bend(offsets[i, 0] * bound), _bend(offsets[i, 1] * bound), _bend(offsets[i, 2] * bound)
        mx, my, mz = unit * offsets[i, 0] * sx, unit * offsets[i, 1] * sy, unit * offsets[i, 2] * sz
        gx, gy, gz = g_means[i, 0], g_means[i, 1], g_means[i, 2]
        # rotation of the offset: y = m + 2 w (a x m) + 2 a x (a x m) with the quaternion (w, a)
        tx, ty, tz = _TWO * (y * gz - z * gy), _TWO * (z * gx - x * gz), _TWO * (x * gy - y * gx)
        g_offsets[i, 0] = (gx - w * tx + y * tz - z * ty) * unit * sx * sx * sx
        g_offsets[i, 1] = (gy - w * ty + z * tx - x * tz) * unit * sy * sy * sy
        g_offsets[i, 2] = (gz - w * tz + x * ty - y * tx) * unit * sz * sz * sz
        cx, cy, cz = my * gz - mz * gy, mz * gx - mx * gz, mx * gy - my * gx  # m x g
        am, ag, gm = x * mx + y * my + z * mz, x * gx + y * gy + z * gz, gx * mx + gy * my + gz * mz
        hw = _TWO * (x * cx + y * cy + z * cz)  # g . (a x m) = a . (m x g)
        hx = _TWO * (w * cx + gx * am + mx * ag - _TWO * x * gm)
        hy = _TWO * (w * cy + gy * am + my * ag - _TWO * y * gm)
        hz = _TWO * (w * cz + gz * am + mz * ag - _TWO * z * gm)
        # unit product q r
        rw, rx, ry, rz = offsets[i, 3] + _ONE, offsets[i, 4], offsets[i, 5], offsets[i, 6]
        a = w * rw - x * rx - y * ry - z * rz
        b = w * rx + rw * x + y * rz - z * ry
        c = w * ry + rw * y + z * rx - x * rz
        d = w * rz + rw * z + x * ry - y * rx
        length = _ONE / math.sqrt(max(a * a + b * b + c * c + d * d, _TINY_NORM))
        a, b, c, d = a * length, b * length, c * length, d * length
        ga, gb, gc, gd = g_quats[i, 0], g_quats[i, 1], g_quats[i, 2], g_quats[i, 3]
        along = a * ga + b * gb + c * gc + d * gd
        ga, gb = (ga - a * along) * length, (gb - b * along) * length
        gc, gd = (gc - c * along) * length, (gd - d * along) * length
        g_offsets[i, 3] = w * ga + x * gb + y * gc + z * gd
        g_offsets[i, 4] = -x * ga + w * gb + gc * z - gd * y
        g_offsets[i, 5] = -y * ga + w * gc + gd * x - gb * z
        g_offsets[i, 6] = -z * ga + w * gd + gb * y - gc * x
        hw += ga * rw + gb * rx + gc * ry + gd * rz
        hx += -ga * rx + rw * gb + ry * gd - rz * gc
        hy += -ga * ry + rw * gc + rz * gb - rx * gd
        hz += -ga * rz + rw * gd + rx * gc - ry * gb
        along = hw * w + hx * x + hy * y + hz * z
        # scales
        g_width = g_height = np.float32(0.0)
        for k in range(3):
            bend = _bend(offsets[i, 7 + k] * log_bound)
            slope = bend * bend * bend
            factor = math.exp(offsets[i, 7 + k] * bend) * g_scales[i, k]
            if k == 0:
                g_width += factor * texel_scale
                g_offsets[i, 7] = factor * width * texel_scale * slope
            elif k == 1:
                g_height += factor * texel_scale
                g_offsets[i, 8] = factor * height * texel_scale * slope
            else:
                g_offsets[i, 9] = factor * min(width, height) * normal_scale * slope
                if width < height:
                    g_width += factor * normal_scale
                else:
                    g_height += factor * normal_scale
        g_texels[i, 0], g_texels[i, 1], g_texels[i, 2] = gx, gy, gz
        g_texels[i, 3], g_texels[i, 4] = g_width, g_height
        g_texels[i, 5], g_texels[i, 6] = (hw - w * along) * inverse, (hx - x * along) * inverse
        g_texels[i, 7], g_texels[i, 8] = (hy - y * along) * inverse, (hz - z * along) * inverse


@compiled(**_OPTIONS)
def scatter(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, g_texels: np.ndarray, g_corners: np.ndarray
) -> None:
    """Add the gradients of interpolated values [N, 9] to those of the corners [T, 9]."""
    for i in range(len(corner)):
        _, _, _, _, _, _, _, _, _, sb, sc = _frame(corners, corner, barycentric, i)
        for j in range(3):
            target = corner[i, j]
            weight = barycentric[i, j]
            turn = weight if j == 0 else sb if j == 1 else sc
            for k in range(5):
                g_corners[target, k] += weight * g_texels[i, k]
            for k in range(5, 9):
                g_corners[target, k] += turn * g_texels[i, k]
