"""Color: display sRGB, scene-linear, premultiplied and straight alpha.

The network works in display sRGB and its pictures are premultiplied in that space (a covered fraction a of color c gives
a c). Blender wants scene-linear premultiplied, PNG wants straight alpha. Used by the render engine and the command line;
needs numpy only.
"""

from __future__ import annotations

import numpy as np

SRGB_TOE = 0.0031308  # linear value where the sRGB curve leaves its straight part (IEC 61966-2-1)
SRGB_TOE_SLOPE = 12.92
SRGB_GAMMA = 2.4
SRGB_OFFSET = 0.055
MIN_ALPHA = 0.5 / 255.0
"""Coverage below which the color of a pixel cannot be told and is left black."""


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Return scene-linear values of display sRGB values, any shape; below 0 counts as 0, above 1 the curve goes on."""
    values = np.asarray(np.maximum(np.asarray(values, np.float32), 0.0))
    curve = np.add(values, np.float32(SRGB_OFFSET), out=np.empty_like(values))
    curve *= np.float32(1.0 / (1.0 + SRGB_OFFSET))
    np.power(curve, np.float32(SRGB_GAMMA), out=curve)
    return np.divide(values, np.float32(SRGB_TOE_SLOPE), out=curve, where=values <= SRGB_TOE * SRGB_TOE_SLOPE)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Return display sRGB values of scene-linear values, any shape; the inverse of `srgb_to_linear`."""
    values = np.maximum(np.asarray(values, np.float32), 0.0)
    curve = (1.0 + SRGB_OFFSET) * values ** (1.0 / SRGB_GAMMA) - SRGB_OFFSET
    return np.where(values <= SRGB_TOE, values * SRGB_TOE_SLOPE, curve).astype(np.float32)


def straight_srgb(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Divide premultiplied sRGB by its alpha.

    Args:
        rgb: Premultiplied display sRGB, [H, W, 3].
        alpha: Coverage, [H, W, 1].

    Returns:
        Straight color clipped to 0..1, [H, W, 3] float32; black where the coverage is below `MIN_ALPHA`.
    """
    alpha = np.asarray(alpha, np.float32)
    visible = alpha >= MIN_ALPHA
    return np.where(visible, np.clip(rgb / np.where(visible, alpha, 1.0), 0.0, 1.0), 0.0).astype(np.float32)


def scene_linear_premultiplied(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return what a Blender render result holds: linear color times alpha, and alpha.

    Args:
        rgb: Premultiplied display sRGB of a transparent picture, [H, W, 3].
        alpha: Coverage, [H, W, 1].

    Returns:
        [H, W, 4] float32. Under the view transform Standard the saved PNG shows the network's sRGB.
    """
    # One channel at a time: numpy is slow at spreading an alpha over three neighbouring values.
    cover = np.clip(np.asarray(alpha, np.float32)[..., 0], 0.0, 1.0)
    divisor = np.divide(1.0, cover, out=np.zeros_like(cover), where=cover >= MIN_ALPHA)
    result = np.empty((*cover.shape, 4), np.float32)
    for channel in range(3):
        straight = np.asarray(rgb, np.float32)[..., channel] * divisor
        np.clip(straight, 0.0, 1.0, out=straight)
        np.multiply(srgb_to_linear(straight), cover, out=result[..., channel])
    result[..., 3] = cover
    return result


def straight_rgba(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return what a PNG holds: straight display sRGB and alpha, 0..1, [H, W, 4] float32. Arguments as above."""
    return np.concatenate([straight_srgb(rgb, alpha), np.clip(np.asarray(alpha, np.float32), 0.0, 1.0)], axis=-1)
