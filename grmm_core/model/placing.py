"""The compiled part of `texels`: interpolation, tangent frames and offsets of all texels in one pass, with its gradient.

The same mathematics as `TexelAnchor.forward` and `place_gaussians`, texel by texel instead of array by array, which saves a CPU
most of the time (every frame of an animation needs this). Arrays in, arrays out: numpy and numba, no torch.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compute.kernels import compiled

_OPTIONS: dict[str, Any] = {"fastmath": True, "boundscheck": False, "error_model": "numpy"}
_ONE, _TWO = np.float32(1.0), np.float32(2.0)
_TINY_NORM = np.float32(1e-20)

# Columns of the values at the UV map's corners: position and sides, metres; quaternion wxyz of the tangent frame.
X, Y, Z, WIDTH, HEIGHT, QW, QX, QY, QZ = range(9)
CORNER_VALUES = 9
# Columns of the offsets: position, quaternion minus the identity, logarithms of scales along width, height and normal.
DX, DY, DZ, RW, RX, RY, RZ, LOG_WIDTH, LOG_HEIGHT, LOG_NORMAL = range(10)

Settings = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]
"""Position unit and limit in metres, limit of the log scale (0: none), texel scale and normal scale over the grid's side."""


def part(function: Any) -> Any:
    """Make a function a part of the kernels that call it."""
    return compiled(inline="always", **_OPTIONS)(function)


@part
def _bend(x: Any) -> Any:
    """Factor of the soft limit: with it x stays below 1, and the slope is its cube."""
    return _ONE / math.sqrt(_ONE + x * x)


@part
def _limits(settings: Settings) -> tuple[Any, Any]:
    """Return reciprocals of the limits of an offset in units, and of a log scale."""
    unit, limit, log_limit, _, _ = settings
    return unit / limit, _ONE / log_limit if log_limit > 0 else np.float32(0.0)


@part
def _signs(corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, i: int) -> tuple[Any, Any]:
    """Return the weights of the second and third corner's quaternions that bring them to the first one's side."""
    a, b, c = corner[i, 0], corner[i, 1], corner[i, 2]
    dot_b = dot_c = np.float32(0.0)
    for k in range(QW, QZ + 1):
        dot_b += corners[a, k] * corners[b, k]
        dot_c += corners[a, k] * corners[c, k]
    return -barycentric[i, 1] if dot_b < 0 else barycentric[i, 1], -barycentric[i, 2] if dot_c < 0 else barycentric[i, 2]


@part
def _frame(corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, i: int) -> tuple[Any, ...]:
    """Return position, sides, unit quaternion of texel i, and the reciprocal length of the quaternion before."""
    a, b, c = corner[i, 0], corner[i, 1], corner[i, 2]
    wa, wb, wc = barycentric[i, 0], barycentric[i, 1], barycentric[i, 2]
    sb, sc = _signs(corners, corner, barycentric, i)
    x = wa * corners[a, X] + wb * corners[b, X] + wc * corners[c, X]
    y = wa * corners[a, Y] + wb * corners[b, Y] + wc * corners[c, Y]
    z = wa * corners[a, Z] + wb * corners[b, Z] + wc * corners[c, Z]
    width = wa * corners[a, WIDTH] + wb * corners[b, WIDTH] + wc * corners[c, WIDTH]
    height = wa * corners[a, HEIGHT] + wb * corners[b, HEIGHT] + wc * corners[c, HEIGHT]
    qw = wa * corners[a, QW] + sb * corners[b, QW] + sc * corners[c, QW]
    qx = wa * corners[a, QX] + sb * corners[b, QX] + sc * corners[c, QX]
    qy = wa * corners[a, QY] + sb * corners[b, QY] + sc * corners[c, QY]
    qz = wa * corners[a, QZ] + sb * corners[b, QZ] + sc * corners[c, QZ]
    inverse = _ONE / math.sqrt(max(qw * qw + qx * qx + qy * qy + qz * qz, _TINY_NORM))
    return x, y, z, width, height, qw * inverse, qx * inverse, qy * inverse, qz * inverse, inverse


@part
def _turn(w: Any, x: Any, y: Any, z: Any, p: Any, q: Any, r: Any) -> tuple[Any, Any, Any]:
    """Return the vector p, q, r turned by the unit quaternion w, x, y, z."""
    tx, ty, tz = _TWO * (y * r - z * q), _TWO * (z * p - x * r), _TWO * (x * q - y * p)
    return p + w * tx + y * tz - z * ty, q + w * ty + z * tx - x * tz, r + w * tz + x * ty - y * tx


@part
def _turned_frame(w: Any, x: Any, y: Any, z: Any, offsets: np.ndarray, i: int) -> tuple[Any, Any, Any, Any, Any]:
    """Return the unit product of a texel's quaternion and its offset's, and the reciprocal length of the product."""
    rw, rx, ry, rz = offsets[i, RW] + _ONE, offsets[i, RX], offsets[i, RY], offsets[i, RZ]
    a = w * rw - x * rx - y * ry - z * rz
    b = w * rx + rw * x + y * rz - z * ry
    c = w * ry + rw * y + z * rx - x * rz
    d = w * rz + rw * z + x * ry - y * rx
    inverse = _ONE / math.sqrt(max(a * a + b * b + c * c + d * d, _TINY_NORM))
    return a * inverse, b * inverse, c * inverse, d * inverse, inverse


@compiled(nogil=True, **_OPTIONS)
def place_forward(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, offsets: np.ndarray, settings: Settings,
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Place the Gaussians `first` to `last` - 1; see `compute.threads.for_rows`.

    Args:
        corners: Values at the corners of the UV map, [T, CORNER_VALUES] float32.
        corner: Corners of each texel's face, [N, 3] int32.
        barycentric: [N, 3] float32.
        offsets: [N, 10] float32.
        settings: See `Settings`.
        means: Written, [N, 3].
        quats: Written, [N, 4].
        scales: Written, [N, 3].
        first: Row.
        last: The row after the last.
    """
    unit, _, _, texel_scale, normal_scale = settings
    bound, log_bound = _limits(settings)
    for i in range(first, last):
        px, py, pz, width, height, w, x, y, z, _ = _frame(corners, corner, barycentric, i)
        mx = unit * offsets[i, DX] * _bend(offsets[i, DX] * bound)
        my = unit * offsets[i, DY] * _bend(offsets[i, DY] * bound)
        mz = unit * offsets[i, DZ] * _bend(offsets[i, DZ] * bound)
        mx, my, mz = _turn(w, x, y, z, mx, my, mz)
        means[i, 0], means[i, 1], means[i, 2] = px + mx, py + my, pz + mz
        a, b, c, d, _ = _turned_frame(w, x, y, z, offsets, i)
        quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3] = a, b, c, d
        thick = min(width, height) * normal_scale
        scales[i, 0] = width * texel_scale * math.exp(offsets[i, LOG_WIDTH] * _bend(offsets[i, LOG_WIDTH] * log_bound))
        scales[i, 1] = height * texel_scale * math.exp(offsets[i, LOG_HEIGHT] * _bend(offsets[i, LOG_HEIGHT] * log_bound))
        scales[i, 2] = thick * math.exp(offsets[i, LOG_NORMAL] * _bend(offsets[i, LOG_NORMAL] * log_bound))


@compiled(nogil=True, **_OPTIONS)
def place_backward(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, offsets: np.ndarray, settings: Settings,
    g_means: np.ndarray, g_quats: np.ndarray, g_scales: np.ndarray, g_offsets: np.ndarray, g_texels: np.ndarray,
    first: int, last: int,
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
        g_texels: Written: of the interpolated corner values, [N, CORNER_VALUES], for `scatter`.
        first: As there.
        last: As there.
    """
    unit, _, _, texel_scale, normal_scale = settings
    bound, log_bound = _limits(settings)
    for i in range(first, last):
        _, _, _, width, height, w, x, y, z, inverse = _frame(corners, corner, barycentric, i)
        sx, sy, sz = _bend(offsets[i, DX] * bound), _bend(offsets[i, DY] * bound), _bend(offsets[i, DZ] * bound)
        mx, my, mz = unit * offsets[i, DX] * sx, unit * offsets[i, DY] * sy, unit * offsets[i, DZ] * sz
        gx, gy, gz = g_means[i, 0], g_means[i, 1], g_means[i, 2]
        # rotation of the offset: y = m + 2 w (a x m) + 2 a x (a x m) with the quaternion (w, a); its transpose turns g back
        bx, by, bz = _turn(w, -x, -y, -z, gx, gy, gz)
        g_offsets[i, DX] = bx * unit * sx * sx * sx
        g_offsets[i, DY] = by * unit * sy * sy * sy
        g_offsets[i, DZ] = bz * unit * sz * sz * sz
        cx, cy, cz = my * gz - mz * gy, mz * gx - mx * gz, mx * gy - my * gx  # m x g
        am, ag, gm = x * mx + y * my + z * mz, x * gx + y * gy + z * gz, gx * mx + gy * my + gz * mz
        hw = _TWO * (x * cx + y * cy + z * cz)  # g . (a x m) = a . (m x g)
        hx = _TWO * (w * cx + gx * am + mx * ag - _TWO * x * gm)
        hy = _TWO * (w * cy + gy * am + my * ag - _TWO * y * gm)
        hz = _TWO * (w * cz + gz * am + mz * ag - _TWO * z * gm)
        # unit product q r
        a, b, c, d, length = _turned_frame(w, x, y, z, offsets, i)
        ga, gb, gc, gd = g_quats[i, 0], g_quats[i, 1], g_quats[i, 2], g_quats[i, 3]
        along = a * ga + b * gb + c * gc + d * gd
        ga, gb = (ga - a * along) * length, (gb - b * along) * length
        gc, gd = (gc - c * along) * length, (gd - d * along) * length
        g_offsets[i, RW] = w * ga + x * gb + y * gc + z * gd
        g_offsets[i, RX] = -x * ga + w * gb + gc * z - gd * y
        g_offsets[i, RY] = -y * ga + w * gc + gd * x - gb * z
        g_offsets[i, RZ] = -z * ga + w * gd + gb * y - gc * x
        rw, rx, ry, rz = offsets[i, RW] + _ONE, offsets[i, RX], offsets[i, RY], offsets[i, RZ]
        hw += ga * rw + gb * rx + gc * ry + gd * rz
        hx += -ga * rx + rw * gb + ry * gd - rz * gc
        hy += -ga * ry + rw * gc + rz * gb - rx * gd
        hz += -ga * rz + rw * gd + rx * gc - ry * gb
        along = hw * w + hx * x + hy * y + hz * z
        # scales
        su, sv, sn = (
            _bend(offsets[i, LOG_WIDTH] * log_bound), _bend(offsets[i, LOG_HEIGHT] * log_bound),
            _bend(offsets[i, LOG_NORMAL] * log_bound),
        )  # fmt: skip
        fu = math.exp(offsets[i, LOG_WIDTH] * su) * g_scales[i, 0] * texel_scale
        fv = math.exp(offsets[i, LOG_HEIGHT] * sv) * g_scales[i, 1] * texel_scale
        fn = math.exp(offsets[i, LOG_NORMAL] * sn) * g_scales[i, 2] * normal_scale
        g_offsets[i, LOG_WIDTH] = fu * width * su * su * su
        g_offsets[i, LOG_HEIGHT] = fv * height * sv * sv * sv
        g_offsets[i, LOG_NORMAL] = fn * min(width, height) * sn * sn * sn
        g_texels[i, X], g_texels[i, Y], g_texels[i, Z] = gx, gy, gz
        g_texels[i, WIDTH], g_texels[i, HEIGHT] = fu + fn if width < height else fu, fv if width < height else fv + fn
        g_texels[i, QW], g_texels[i, QX] = (hw - w * along) * inverse, (hx - x * along) * inverse
        g_texels[i, QY], g_texels[i, QZ] = (hy - y * along) * inverse, (hz - z * along) * inverse


@compiled(**_OPTIONS)
def scatter(
    corners: np.ndarray, corner: np.ndarray, barycentric: np.ndarray, g_texels: np.ndarray, g_corners: np.ndarray
) -> None:
    """Add the gradients of interpolated values [N, CORNER_VALUES] to those of the corners [T, CORNER_VALUES]."""
    for i in range(len(corner)):
        sb, sc = _signs(corners, corner, barycentric, i)
        for j in range(3):
            target = corner[i, j]
            weight = barycentric[i, j]
            turn = weight if j == 0 else sb if j == 1 else sc
            for k in range(QW):
                g_corners[target, k] += weight * g_texels[i, k]
            for k in range(QW, CORNER_VALUES):
                g_corners[target, k] += turn * g_texels[i, k]
