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
def skin_share(alpha: np.ndarray, skin: np.ndarray, least: float, share: np.ndarray, first: int, last: int) -> None:
    """Write how much of each pixel's cover, if that is `least` or more, is skin, in rows first..last; arrays as above."""
    for y in range(first, last):
        for x in range(alpha.shape[1]):
            share[y, x] = skin[y, x] / max(alpha[y, x], np.float32(least))
