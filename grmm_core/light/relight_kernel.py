"""The compiled twin of `relight.relit`: a block of pixels at a time, so that the compiler does eight colors at once.

Importing this loads numba. All arrays are contiguous float32.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from ..pictures.color import SRGB_GAMMA, SRGB_OFFSET, SRGB_TOE, SRGB_TOE_SLOPE
from .shadow_kernels import OPTIONS, single

_0, _1 = single(0.0), single(1.0)
BLOCK = 64  # pixels
LINEAR_END, DISPLAY_END = single(1.25), single(1.5)
"""Up to which display value, and which root of linear light, the polynomials of `relight` stand for the curves of sRGB."""
_TOE, _ROOT_OF_TOE = np.float32(SRGB_TOE * SRGB_TOE_SLOPE), np.float32(math.sqrt(SRGB_TOE))
_SLOPE, _OFFSET, _GAMMA = np.float32(SRGB_TOE_SLOPE), np.float32(SRGB_OFFSET), np.float32(SRGB_GAMMA)
# where a block's quantities begin
_COVER, _FLAT, _RATIO, _SHINE, _SHOWN, _STRONG, _ALL = [BLOCK * column for column in (0, 1, 4, 7, 10, 13, 16)]


@compiled(inline="always", **OPTIONS)
def _polynomial(at: float, factors: tuple[float, ...]) -> float:
    """Of degree 7, of what lies from -1 to 1; behind its eight factors the two that lead there."""
    a, b, c, d, e, f, g, h, scale, shift = factors
    x = at * scale + shift
    return a + x * (b + x * (c + x * (d + x * (e + x * (f + x * (g + x * h))))))


@compiled(**OPTIONS)
def _curved(flat: float, ratio: float, shine: float, most: float) -> float:
    """One color of a pixel by the curves themselves, which light needs that is stronger than the polynomials reach."""
    value = ((flat + _OFFSET) / (_1 + _OFFSET)) ** _GAMMA if flat > _TOE else flat / _SLOPE
    value *= ratio
    value = max(value + max(shine, -most * value), _0)
    return (_1 + _OFFSET) * value ** (_1 / _GAMMA) - _OFFSET if value > _ROOT_OF_TOE * _ROOT_OF_TOE else value * _SLOPE


@compiled(**OPTIONS)
def relit(
    rgb: np.ndarray, alpha: np.ndarray, light: np.ndarray, start: int, linear: tuple[float, ...], display: tuple[float, ...],
    least: float, most: float, out: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Pixels in another light; see `relight.relit`.

    Args:
        rgb: [P, 3].
        alpha: [P].
        light: Channels of the picture, [P, C].
        start: Of them the first of ratio (3), highlights (3) and cover that faces the viewer (1).
        linear: Of `relight.polynomials`, linear light by display values up to `LINEAR_END`, 10 numbers.
        display: Likewise, display values by the fourth root of linear light.
        least: Cover that is drawn.
        most: Share of a color that highlights may take off.
        out: Written, [P, 3].
        first: Row of `out`.
        last: The row after the last.
    """
    w = np.empty(_ALL, np.float32)
    part = np.float32(most)
    for begin in range(first, last, BLOCK):
        size, seen = min(BLOCK, last - begin), False
        for j in range(BLOCK):
            i = begin + min(j, size - 1)
            drawn = alpha[i] >= least
            seen = seen or drawn
            w[_COVER + j] = alpha[i] if drawn else _0
        if not seen:
            out[begin : begin + size] = _0
            continue
        for j in range(BLOCK):
            i = begin + min(j, size - 1)
            inverse, front = _1 / max(w[_COVER + j], np.float32(least)), _1 / max(light[i, start + 6], np.float32(1e-6))
            for c in range(3):
                w[_FLAT + c * BLOCK + j] = max(rgb[i, c] * inverse, _0)
                w[_RATIO + c * BLOCK + j] = light[i, start + c] * front
                w[_SHINE + c * BLOCK + j] = light[i, start + 3 + c] * front
        for j in range(3 * BLOCK):  # all at once
            flat, ratio, shine = w[_FLAT + j], w[_RATIO + j], w[_SHINE + j]
            bounded = min(flat, LINEAR_END)
            # both parts of each curve are worked out: a branch would be taken color by color
            curve, straight = _polynomial(bounded, linear), bounded / _SLOPE
            value = curve if bounded > _TOE else straight
            value *= ratio
            value = max(value + max(shine, -part * value), _0)
            root = math.sqrt(value)
            w[_STRONG + j] = max(flat * (DISPLAY_END / LINEAR_END), root)
            root = min(root, DISPLAY_END)
            curve, straight = _polynomial(math.sqrt(root), display), root * root * _SLOPE
            w[_SHOWN + j] = curve if root > _ROOT_OF_TOE else straight
        if w[_STRONG:_ALL].max() > DISPLAY_END:
            for j in range(3 * BLOCK):
                w[_SHOWN + j] = _curved(w[_FLAT + j], w[_RATIO + j], w[_SHINE + j], part)
        for j in range(size):
            for c in range(3):
                out[begin + j, c] = w[_SHOWN + c * BLOCK + j] * w[_COVER + j]
