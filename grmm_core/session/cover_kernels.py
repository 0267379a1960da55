"""The compiled twin of what `compose` asks of a picture of skin and strands; importing this module loads numba."""

from __future__ import annotations

import numpy as np

from ..compute.kernels import compiled

_ZERO = np.float32(0.0)


@compiled(fastmath=True, boundscheck=False, error_model="numpy", nogil=True)
def skin_cover(
    alpha: np.ndarray, skin: np.ndarray, rounding: float, least: float, cover: np.ndarray, first: int, last: int
) -> None:
    """Write how much of each pixel of the rows first..last is skin that is worth refining.

    Args:
        alpha: Cover of everything, [H, W].
        skin: Cover of all but strands, [H, W].
        rounding: Cover of strands that is none.
        least: What is taken off.
        cover: Written, [H, W], not below 0.
        first: Row.
        last: The row after the last.
    """
    for y in range(first, last):
        for x in range(alpha.shape[1]):
            strands = alpha[y, x] - skin[y, x]
            left = alpha[y, x] - (strands if strands > np.float32(rounding) else _ZERO) - np.float32(least)
            cover[y, x] = max(left, _ZERO)


@compiled(fastmath=True, boundscheck=False, error_model="numpy", nogil=True)
def channels(
    out: np.ndarray, features: np.ndarray, at: int, skin: int, light: np.ndarray, more: np.ndarray, start: int, count: int,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write channels of Gaussians of rows first..last; see `stacking.with_light`.

    Args:
        out: Written, [R, C].
        features: Of the first Gaussians, [N, F].
        at: Their first channel, below 0 where they are not asked for.
        skin: Channel that is 1 on these, below 0 where that is not asked for.
        light: Of as many Gaussians or of all, [M, >= count].
        more: Of the others, likewise.
        start: The first channel of light.
        count: How many of them.
        first: Row.
        last: The row after the last.
    """
    for i in range(first, last):
        for k in range(out.shape[1]):
            out[i, k] = _ZERO
        if i < len(features):
            if skin >= 0:
                out[i, skin] = np.float32(1.0)
            if at >= 0:
                for k in range(features.shape[1]):
                    out[i, at + k] = features[i, k]
        if i < len(light):
            for k in range(count):
                out[i, start + k] = light[i, k]
        else:
            for k in range(count):
                out[i, start + k] = more[i - len(light), k]
