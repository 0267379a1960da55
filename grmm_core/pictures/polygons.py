"""Areas that outlines enclose in a picture. Needs numpy only."""

from __future__ import annotations

import numpy as np


def polygon(shape: tuple[int, ...], outline: np.ndarray) -> np.ndarray:
    """Pixels whose middle a closed outline encloses, by the even-odd rule, [H, W] bool.

    Args:
        shape: Height and width of the picture.
        outline: Pixels, the centre of the first one at (0.5, 0.5), [N, 2].
    """
    found, ends = np.zeros(shape, bool), np.asarray(outline, float)
    left, top = np.clip(np.floor(ends.min(0)).astype(int), 0, shape[::-1])
    right, bottom = np.clip(np.ceil(ends.max(0)).astype(int), 0, shape[::-1])
    rows, columns = np.mgrid[top:bottom, left:right] + 0.5
    for (x, y), (u, v) in zip(ends, np.roll(ends, -1, 0), strict=True):
        found[top:bottom, left:right] ^= ((y > rows) != (v > rows)) & (
            columns < (u - x) * (rows - y) / (v - y if v != y else 1.0) + x
        )
    return found
