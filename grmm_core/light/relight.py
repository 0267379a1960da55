"""Light on a picture: ratio and highlights, splatted like colors, applied in linear light. Numpy and torch."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly, chebfit

from ..compute.buffers import empty
from ..geometry.libraries import Array, library_of
from ..pictures.color import MIN_ALPHA, SRGB_GAMMA, SRGB_OFFSET, SRGB_TOE, SRGB_TOE_SLOPE
from .shadows import compiled_kernels

_MOST = 0.5  # of a color that taking off the rig's highlights may cost
_DEGREE = 7
_DARKEST = 0.2  # of the rig's light: in deeper shadow colors are noise


def relit(rgb: Array, alpha: Array, ratio: Array, highlights: Array | None = None) -> Array:
    """A picture in another light.

    Args:
        rgb: Display sRGB premultiplied by alpha, refined, [H, W, 3].
        alpha: [H, W].
        ratio: Irradiance relative to the rig's, splatted (premultiplied), [H, W, 3].
        highlights: Radiance, splatted, [H, W, 3]; None: as much as the rig's.

    Returns:
        As `rgb`; beyond 1 where the light is strong.
    """
    library = library_of(rgb)
    cover = library.clip(alpha, MIN_ALPHA, None)[..., None]
    linear = to_linear(rgb / cover) * (ratio / cover)
    if highlights is not None:  # less the rig's: where a color never had them (hair, shadow) that must not blacken it
        linear = linear + library.maximum(highlights / cover, -_MOST * linear)
    seen = (alpha >= MIN_ALPHA)[..., None]
    result: Array = to_display(linear) * cover * seen
    return result


def unlit(rgb: Array, ratio: Array) -> Array:
    """The inverse of `relit` without highlights: straight display sRGB [..., 3] in a light as the rig shows it."""
    library = library_of(rgb)
    result: Array = to_display(to_linear(rgb) / library.clip(ratio, _DARKEST, None))
    return result


def relit_pixels(rgb: np.ndarray, alpha: np.ndarray, channels: np.ndarray, start: int) -> np.ndarray:
    """`relit` in one compiled pass where there is numba, within 1e-5.

    Args:
        rgb: [H, W, 3].
        alpha: [H, W].
        channels: [H, W, C].
        start: The first of three channels of ratio, behind them three of highlights, and their cover (`shading.relative`).
    """
    if compiled_kernels() is None:
        light = over_cover(channels[..., start : start + 7], alpha)
        return relit(rgb, alpha, light[..., :3], light[..., 3:6])
    from ..compute.threads import for_rows
    from .relight_kernel import relit as compiled_relit

    out = empty(rgb.shape)
    flat = (np.ascontiguousarray(array, np.float32) for array in (rgb.reshape(-1, 3), alpha.reshape(-1)))
    light = channels.reshape(-1, channels.shape[-1])
    for_rows(compiled_relit, alpha.size, *flat, light, start, *_polynomials(), MIN_ALPHA, _MOST, out.reshape(-1, 3))
    return out


def over_cover(light: Array, alpha: Array) -> Array:
    """Splatted channels of `shading.relative`, [H, W, >= 7], as if their cover were the picture's, `alpha` [H, W]."""
    result: Array = light * (alpha / library_of(light).clip(light[..., 6], 1e-6, None))[..., None]
    return result


@functools.lru_cache(maxsize=1)
def _polynomials() -> tuple[tuple[np.float32, ...], tuple[np.float32, ...]]:
    """Both curves of sRGB above their straight parts, within 6e-6: factors of degree 7, and the line to -1..1 before them."""
    from .relight_kernel import DISPLAY_END, LINEAR_END

    def fitted(curve: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> tuple[np.float32, ...]:
        way = np.cos(np.pi * (np.arange(1000) + 0.5) / 1000)  # as Chebyshev has them: the error is spread evenly
        factors = cheb2poly(chebfit(way, curve(low + (high - low) * (0.5 + 0.5 * way)), _DEGREE))
        return tuple(map(np.float32, (*factors, 2.0 / (high - low), -(high + low) / (high - low))))

    return (
        fitted(to_linear, SRGB_TOE * SRGB_TOE_SLOPE, float(LINEAR_END)),
        fitted(lambda root: to_display(root**4), SRGB_TOE**0.25, math.sqrt(float(DISPLAY_END))),
    )


def to_linear(values: Array) -> Array:
    """Scene-linear values of display sRGB (IEC 61966-2-1), differentiably; below 0 counts as 0."""
    library = library_of(values)
    values = library.clip(values, 0.0, None)
    curve = ((values + SRGB_OFFSET) / (1.0 + SRGB_OFFSET)) ** SRGB_GAMMA
    result: Array = library.where(values <= SRGB_TOE * SRGB_TOE_SLOPE, values / SRGB_TOE_SLOPE, curve)
    return result


def to_display(values: Array) -> Array:
    """The inverse of `to_linear`."""
    library = library_of(values)
    bright = library.clip(values, SRGB_TOE, None)  # the root has no slope at 0
    curve = (1.0 + SRGB_OFFSET) * bright ** (1.0 / SRGB_GAMMA) - SRGB_OFFSET
    result: Array = library.where(values <= SRGB_TOE, library.clip(values, 0.0, None) * SRGB_TOE_SLOPE, curve)
    return result
