"""The compiled twin of `ribbons`, with gradients; importing this module loads numba. Arrays are float32 and contiguous.

Columns of an eye: rotation by rows (0-8), translation (9-11), focal length (12), parallel projection (13); see `Eye.numbers`.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from ..pictures.color import linear_to_srgb
from ..splat.rules import ALPHA_MIN, DILATION
from .ribbons import (
    AMBIENT,
    BACK,
    COLORED,
    COLORED_SHARP,
    COLORED_SHIFT,
    DARKEST,
    FRONT,
    LAMPS,
    LONG,
    SCATTER,
    SMALLEST,
    TINY,
    WHITE,
    WHITE_SHARP,
    WHITE_SHIFT,
    WIDE,
)

_OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
F = np.float32
_LONG, _WIDE, _TINY2, _SMALLEST, _DILATION = F(LONG), F(WIDE), F(TINY * TINY), F(SMALLEST), F(DILATION)
_ONE, _TWO, _HALF, _ZERO, _LEAST = F(1.0), F(2.0), F(0.5), F(0.0), F(ALPHA_MIN)


@compiled(**_OPTIONS)
def stand(local: np.ndarray, origin: np.ndarray, axes: np.ndarray, points: np.ndarray) -> None:
    """Bring parents [M, K, 3] from the axes [N, 3, 3] of the first roots [N, 3] to head space, `points` [N, K, 3]."""
    for i in range(len(points)):
        for k in range(points.shape[1]):
            x, y, z = local[i, k, 0], local[i, k, 1], local[i, k, 2]
            for c in range(3):
                points[i, k, c] = x * axes[i, 0, c] + y * axes[i, 1, c] + z * axes[i, 2, c] + origin[i, c]


@compiled(**_OPTIONS)
def pose(
    parents: np.ndarray, axes: np.ndarray, owner: np.ndarray, spread: np.ndarray, local: np.ndarray, seen: np.ndarray,
    points: np.ndarray, light: np.ndarray,
) -> None:  # fmt: skip
    """Place strands around those that they were made from, and turn what they know about light.

    Args:
        parents: Head space, [M, K, 3].
        axes: Of their roots, as rows, [M, 3, 3].
        owner: Which of them each strand belongs to, [N] int32.
        spread: How far a strand is from it at root and tip, in the axes of the root, metres, [N, 2, 3].
        local: Openness with its gradient in the axes of the root, [M, K, 4].
        seen: Of the segments; points between two at 0 are left, [N * (K-1)].
        points: Written, [N, K, 3].
        light: Written, openness in head space, [N, K, 4].
    """
    count = parents.shape[1]
    for i in range(len(owner)):
        m, first = owner[i], i * (count - 1)
        for k in range(count):
            if (k == 0 or seen[first + k - 1] <= _ZERO) and (k == count - 1 or seen[first + k] <= _ZERO):
                continue
            t = F(k) / F(count - 1)
            dx = spread[i, 0, 0] + (spread[i, 1, 0] - spread[i, 0, 0]) * t
            dy = spread[i, 0, 1] + (spread[i, 1, 1] - spread[i, 0, 1]) * t
            dz = spread[i, 0, 2] + (spread[i, 1, 2] - spread[i, 0, 2]) * t
            lx, ly, lz = local[m, k, 1], local[m, k, 2], local[m, k, 3]
            light[i, k, 0] = local[m, k, 0]
            for c in range(3):
                points[i, k, c] = parents[m, k, c] + dx * axes[m, 0, c] + dy * axes[m, 1, c] + dz * axes[m, 2, c]
                light[i, k, 1 + c] = lx * axes[m, 0, c] + ly * axes[m, 1, c] + lz * axes[m, 2, c]


@compiled(**_OPTIONS)
def segments_forward(
    points: np.ndarray, radii: np.ndarray, opacity: np.ndarray, eye: np.ndarray, antialias: bool,
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, opacities: np.ndarray,
) -> None:  # fmt: skip
    """`ribbons.segments`: points [N, K, 3], radii [N, 2], opacity [N] to the last four, [N * (K-1), ...], which are written.

    Segments whose opacity is given as 0 are left.
    """
    count = points.shape[1] - 1
    for i in range(len(points)):
        for k in range(count):
            row = i * count + k
            if opacities[row] <= _ZERO:
                continue
            dx = points[i, k + 1, 0] - points[i, k, 0]
            dy = points[i, k + 1, 1] - points[i, k, 1]
            dz = points[i, k + 1, 2] - points[i, k, 2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY2)
            inverse = (-_ONE if dx < _ZERO else _ONE) / length
            ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
            half = math.sqrt(_TWO * (_ONE + ux))
            quats[row, 0], quats[row, 1], quats[row, 2], quats[row, 3] = _HALF * half, _ZERO, -uz / half, uy / half
            place = (F(k) + _HALF) / F(count)
            radius = _WIDE * (radii[i, 0] + (radii[i, 1] - radii[i, 0]) * place * place)
            long = _LONG * length
            scales[row, 0], scales[row, 1], scales[row, 2] = long, radius, radius
            mx = _HALF * (points[i, k, 0] + points[i, k + 1, 0])
            my = _HALF * (points[i, k, 1] + points[i, k + 1, 1])
            mz = _HALF * (points[i, k, 2] + points[i, k + 1, 2])
            means[row, 0], means[row, 1], means[row, 2] = mx, my, mz
            opacities[row] = opacity[i]
            if antialias and opacity[i] > _ZERO:
                across, down = _areas(mx, my, mz, ux, uy, uz, long, radius, eye)
                factor = math.sqrt(across * down / ((across + _DILATION) * (down + _DILATION)))
                opacities[row] = opacity[i] * factor + _LEAST


@compiled(**_OPTIONS)
def _areas(
    mx: float, my: float, mz: float, ux: float, uy: float, uz: float, long: float, wide: float, eye: np.ndarray
) -> tuple[float, float]:
    """Variances on the picture across and along a segment, px^2."""
    qx = eye[0] * mx + eye[1] * my + eye[2] * mz + eye[9]
    qy = eye[3] * mx + eye[4] * my + eye[5] * mz + eye[10]
    qz = eye[6] * mx + eye[7] * my + eye[8] * mz + eye[11]
    wz = eye[6] * ux + eye[7] * uy + eye[8] * uz
    if eye[13] > _HALF:
        pixels, cosine = eye[12], wz
    else:
        wx = eye[0] * ux + eye[1] * uy + eye[2] * uz
        wy = eye[3] * ux + eye[4] * uy + eye[5] * uz
        pixels = eye[12] / max(qz, F(TINY))
        cosine = (wx * qx + wy * qy + wz * qz) / math.sqrt(qx * qx + qy * qy + qz * qz + _TINY2)
    scale = pixels * pixels
    across = scale * wide * wide
    return across + _SMALLEST, scale * long * long * (_ONE - cosine * cosine) + across * cosine * cosine + _SMALLEST


@compiled(**_OPTIONS)
def segments_backward(
    points: np.ndarray, radii: np.ndarray, opacity: np.ndarray, eye: np.ndarray, antialias: bool,
    g_means: np.ndarray, g_quats: np.ndarray, g_scales: np.ndarray, g_opacities: np.ndarray,
    g_points: np.ndarray, g_radii: np.ndarray, g_opacity: np.ndarray,
) -> None:  # fmt: skip
    """Gradients of `segments_forward`; the last three, zeros like points, radii and opacity, are added to."""
    count = points.shape[1] - 1
    for i in range(len(points)):
        for k in range(count):
            row = i * count + k
            dx = points[i, k + 1, 0] - points[i, k, 0]
            dy = points[i, k + 1, 1] - points[i, k, 1]
            dz = points[i, k + 1, 2] - points[i, k, 2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY2)
            sign = -_ONE if dx < _ZERO else _ONE
            inverse = sign / length
            ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
            n = math.sqrt(_TWO * (_ONE + ux))
            gx = g_quats[row, 0] * _HALF / n + (g_quats[row, 2] * uz - g_quats[row, 3] * uy) / (n * n * n)
            gy, gz = g_quats[row, 3] / n, -g_quats[row, 2] / n
            place = (F(k) + _HALF) / F(count)
            place *= place
            long, wide = _LONG * length, _WIDE * (radii[i, 0] + (radii[i, 1] - radii[i, 0]) * place)
            g_long, g_wide = g_scales[row, 0], g_scales[row, 1] + g_scales[row, 2]
            hx, hy, hz = g_means[row, 0], g_means[row, 1], g_means[row, 2]
            if antialias:
                mx = _HALF * (points[i, k, 0] + points[i, k + 1, 0])
                my = _HALF * (points[i, k, 1] + points[i, k + 1, 1])
                mz = _HALF * (points[i, k, 2] + points[i, k + 1, 2])
                across, down = _areas(mx, my, mz, ux, uy, uz, long, wide, eye)
                factor = math.sqrt(across * down / ((across + _DILATION) * (down + _DILATION)))
                g_opacity[i] += g_opacities[row] * factor
                shared = g_opacities[row] * opacity[i] * factor * _HALF * _DILATION
                g_across, g_down = shared / (across * (across + _DILATION)), shared / (down * (down + _DILATION))
                qx = eye[0] * mx + eye[1] * my + eye[2] * mz + eye[9]
                qy = eye[3] * mx + eye[4] * my + eye[5] * mz + eye[10]
                qz = eye[6] * mx + eye[7] * my + eye[8] * mz + eye[11]
                wx = eye[0] * ux + eye[1] * uy + eye[2] * uz
                wy = eye[3] * ux + eye[4] * uy + eye[5] * uz
                wz = eye[6] * ux + eye[7] * uy + eye[8] * uz
                parallel = eye[13] > _HALF
                distance = math.sqrt(qx * qx + qy * qy + qz * qz + _TINY2)
                vx, vy, vz = _ZERO, _ZERO, _ONE
                pixels = eye[12]
                if not parallel:
                    vx, vy, vz = qx / distance, qy / distance, qz / distance
                    pixels = eye[12] / max(qz, F(TINY))
                cosine = wx * vx + wy * vy + wz * vz
                scale = pixels * pixels
                flat = _ONE - cosine * cosine
                g_long += g_down * _TWO * scale * long * flat
                g_wide += _TWO * scale * wide * (g_across + g_down * cosine * cosine)
                g_cosine = g_down * _TWO * scale * cosine * (wide * wide - long * long)
                jx, jy, jz = g_cosine * vx, g_cosine * vy, g_cosine * vz  # of the axis, in the camera
                gx += eye[0] * jx + eye[3] * jy + eye[6] * jz
                gy += eye[1] * jx + eye[4] * jy + eye[7] * jz
                gz += eye[2] * jx + eye[5] * jy + eye[8] * jz
                if not parallel:
                    g_cosine /= distance
                    jx, jy, jz = g_cosine * (wx - cosine * vx), g_cosine * (wy - cosine * vy), g_cosine * (wz - cosine * vz)
                    if qz > F(TINY):
                        jz -= _TWO / qz * (g_across * (across - _SMALLEST) + g_down * (down - _SMALLEST))
                    hx += eye[0] * jx + eye[3] * jy + eye[6] * jz
                    hy += eye[1] * jx + eye[4] * jy + eye[7] * jz
                    hz += eye[2] * jx + eye[5] * jy + eye[8] * jz
            else:
                g_opacity[i] += g_opacities[row]
            g_radii[i, 0] += _WIDE * g_wide * (_ONE - place)
            g_radii[i, 1] += _WIDE * g_wide * place
            along = gx * ux + gy * uy + gz * uz
            g_length = _LONG * g_long * sign
            gx = (gx - along * ux) * inverse + g_length * ux
            gy = (gy - along * uy) * inverse + g_length * uy
            gz = (gz - along * uz) * inverse + g_length * uz
            g_points[i, k, 0] += _HALF * hx - gx
            g_points[i, k, 1] += _HALF * hy - gy
            g_points[i, k, 2] += _HALF * hz - gz
            g_points[i, k + 1, 0] += _HALF * hx + gx
            g_points[i, k + 1, 1] += _HALF * hy + gy
            g_points[i, k + 1, 2] += _HALF * hz + gz


_LAMPS = LAMPS
_LAMP_COUNT = len(LAMPS)
_DISPLAY = np.append(linear_to_srgb(np.linspace(0.0, 1.0, 512) ** 2), 1.0).astype(np.float32)  # at even square roots


@compiled(**_OPTIONS)
def shade_into(
    points: np.ndarray, albedo: np.ndarray, light: np.ndarray, share: np.ndarray, opacities: np.ndarray, eye: np.ndarray,
    sheen: float, colors: np.ndarray,
) -> None:  # fmt: skip
    """`ribbons.shade` of every segment that has an opacity, as display sRGB.

    Args:
        points: [N, K, 3].
        albedo: Linear RGB at root and tip, [N, 2, 3].
        light: At the points, [N, K, 4].
        share: What of it each segment has, [N, K-1].
        opacities: [N * (K-1)]; where it is 0, nothing is computed.
        eye: See the module.
        sheen: As in `ribbons.shade`.
        colors: Written, [N * (K-1), 3].
    """
    count = points.shape[1] - 1
    ex = -(eye[0] * eye[9] + eye[3] * eye[10] + eye[6] * eye[11])
    ey = -(eye[1] * eye[9] + eye[4] * eye[10] + eye[7] * eye[11])
    ez = -(eye[2] * eye[9] + eye[5] * eye[10] + eye[8] * eye[11])
    parallel, glint = eye[13] > _HALF, max(F(sheen) - _ONE, _ZERO)
    for i in range(len(points)):
        for k in range(count):
            row = i * count + k
            if opacities[row] <= _ZERO:
                colors[row, 0] = colors[row, 1] = colors[row, 2] = _ZERO
                continue
            dx = points[i, k + 1, 0] - points[i, k, 0]
            dy = points[i, k + 1, 1] - points[i, k, 1]
            dz = points[i, k + 1, 2] - points[i, k, 2]
            inverse = _ONE / math.sqrt(dx * dx + dy * dy + dz * dz + _TINY2)
            ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
            vx, vy, vz = -eye[6], -eye[7], -eye[8]
            if not parallel:
                vx = ex - _HALF * (points[i, k, 0] + points[i, k + 1, 0])
                vy = ey - _HALF * (points[i, k, 1] + points[i, k + 1, 1])
                vz = ez - _HALF * (points[i, k, 2] + points[i, k + 1, 2])
                inverse = _ONE / math.sqrt(vx * vx + vy * vy + vz * vz + _TINY2)
                vx, vy, vz = vx * inverse, vy * inverse, vz * inverse
            t = (F(k) + _HALF) / F(count)
            red = albedo[i, 0, 0] + (albedo[i, 1, 0] - albedo[i, 0, 0]) * t
            green = albedo[i, 0, 1] + (albedo[i, 1, 1] - albedo[i, 0, 1]) * t
            blue = albedo[i, 0, 2] + (albedo[i, 1, 2] - albedo[i, 0, 2]) * t
            open_, lx = _HALF * (light[i, k, 0] + light[i, k + 1, 0]), _HALF * (light[i, k, 1] + light[i, k + 1, 1])
            ly, lz = _HALF * (light[i, k, 2] + light[i, k + 1, 2]), _HALF * (light[i, k, 3] + light[i, k + 1, 3])
            kept = max(open_, F(DARKEST)) ** (-F(SCATTER) * math.sqrt(min(max((red + green + blue) / F(3.0), _ZERO), _ONE)))
            open_, lx, ly, lz = open_ * kept, lx * kept, ly * kept, lz * kept
            sine_eye = ux * vx + uy * vy + uz * vz
            flat_eye = math.sqrt(max(_ONE - sine_eye * sine_eye, F(1e-4)))
            matte = F(AMBIENT) * open_
            white, colored = _ZERO, _ZERO
            for lamp in range(_LAMP_COUNT):
                x, y, z = _LAMPS[lamp, 0], _LAMPS[lamp, 1], _LAMPS[lamp, 2]
                reaching = _LAMPS[lamp, 3] * min(max(open_ + lx * x + ly * y + lz * z, _ZERO), _ONE)
                sine = ux * x + uy * y + uz * z
                flat = math.sqrt(max(_ONE - sine * sine, F(1e-4)))
                facing = (vx * x + vy * y + vz * z - sine * sine_eye) / (flat * flat_eye)
                facing = min(max(facing, -_ONE), _ONE)
                matte += reaching * flat * (F(BACK) + F(FRONT) * (_HALF + _HALF * facing))
                lean = sine + sine_eye
                a = (lean - F(WHITE_SHIFT)) * F(WHITE_SHARP)
                a = _ONE / (_ONE + a * a)
                white += reaching * flat * a * a
                if glint > _ZERO:
                    b = (lean - F(COLORED_SHIFT)) * F(COLORED_SHARP)
                    b = _ONE / (_ONE + b * b)
                    colored += reaching * flat * b * b
            matte += glint * F(COLORED) * colored
            matte, white = share[i, k] * matte, share[i, k] * white * F(sheen) * F(WHITE)
            colors[row, 0], colors[row, 1] = _display(red * matte + white), _display(green * matte + white)
            colors[row, 2] = _display(blue * matte + white)


@compiled(**_OPTIONS)
def _display(linear: float) -> float:
    """Linear to display sRGB (IEC 61966-2-1), up to 1: read from a table to 1e-5, which costs a tenth of the power."""
    at = math.sqrt(min(max(linear, _ZERO), _ONE)) * F(len(_DISPLAY) - 2)
    low = int(at)
    return _DISPLAY[low] + (at - F(low)) * (_DISPLAY[low + 1] - _DISPLAY[low])
