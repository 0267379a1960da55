"""Light on a picture: ratio and highlights, splatted like colors, applied in linear light. Numpy and torch."""

from __future__ import annotations

import functools

import numpy as np

from ..compute.buffers import empty
from ..geometry.libraries import Array, library_of
from ..pictures.color import MIN_ALPHA, SRGB_GAMMA, SRGB_OFFSET, SRGB_TOE, SRGB_TOE_SLOPE
from .shadows import compiled_kernels

_MOST = 0.5  # of a color that taking off the rig's highlights may cost
_DARKEST = 0.2  # of the rig's light: in deeper shadow colors are noise


def relit(rgb: Array, alpha: Array, ratio: Array, highlights: Array) -> Array:
    """A picture in another light.

    Args:
        rgb: Display sRGB premultiplied by alpha, refined, [H, W, 3].
        alpha: [H, W].
        ratio: Irradiance relative to the rig's, splatted (premultiplied), [H, W, 3].
        highlights: Radiance, splatted, [H, W, 3].

    Returns:
        As `rgb`; beyond 1 where the light is strong.
    """
    library = library_of(rgb)
    cover = library.clip(alpha, MIN_ALPHA, None)[..., None]
    lit = to_linear(rgb / cover) * (ratio / cover)
    # the rig's highlights are taken off; where a color never had them (hair, shadow) that must not blacken it
    linear = lit + library.maximum(highlights / cover, -_MOST * lit)
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
    kernels = compiled_kernels()
    if kernels is None:
        light = over_cover(channels[..., start : start + 7], alpha)
        return relit(rgb, alpha, light[..., :3], light[..., 3:6])
    from ..compute.threads import for_rows

    out = empty(rgb.shape)
    flat = (np.ascontiguousarray(array, np.float32) for array in (rgb.reshape(-1, 3), alpha.reshape(-1)))
    light = channels.reshape(-1, channels.shape[-1])
    for_rows(kernels.relit, alpha.size, *flat, light, start, *_tables(), MIN_ALPHA, _MOST, out.reshape(-1, 3))
    return out


def over_cover(light: Array, alpha: Array) -> Array:
    """Splatted channels of `shading.relative`, [H, W, >= 7], as if their cover were the picture's, `alpha` [H, W]."""
    result: Array = light * (alpha / library_of(light).clip(light[..., 6], 1e-6, None))[..., None]
    return result


@functools.lru_cache(maxsize=1)
def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Linear light by display values, and display values by the root of linear light."""
    from .light_kernels import DISPLAY_END, LINEAR_END, TABLE

    steps = np.arange(TABLE + 2) / TABLE
    return to_linear(steps * LINEAR_END).astype(np.float32), to_display((steps * DISPLAY_END) ** 2).astype(np.float32)


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
