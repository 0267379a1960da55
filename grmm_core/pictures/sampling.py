"""Values of a picture between its pixels. Needs numpy only."""

from __future__ import annotations

import numpy as np


def bilinear(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the values of a picture at points, between the four nearest pixels; beyond the border the border's.

    Args:
        picture: [H, W] or [H, W, C], at least two pixels high and wide.
        points: Pixels, the centre of the first one at (0.5, 0.5), [..., 2].

    Returns:
        [...] or [..., C], float64 for float64 pictures and else float32.
    """
    height, width = picture.shape[:2]
    x = np.clip(points[..., 0] - 0.5, 0.0, width - 1.0)
    y = np.clip(points[..., 1] - 0.5, 0.0, height - 1.0)
    x0, y0 = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    kind = np.result_type(picture, np.float32)
    u, v = (x - x0).astype(kind), (y - y0).astype(kind)
    if picture.ndim == 3:
        u, v = u[..., None], v[..., None]
    top = picture[y0, x0] * (1 - u) + picture[y0, x0 + 1] * u
    bottom = picture[y0 + 1, x0] * (1 - u) + picture[y0 + 1, x0 + 1] * u
    return top * (1 - v) + bottom * v
