"""Which triangle covers which texel, for the tests of texture layouts."""

from __future__ import annotations

import numpy as np


def cover_texels(uv, size):
    count = np.zeros((size, size), np.int32)
    owner = np.full((size, size), -1)
    for number, triangle in enumerate(uv * size - 0.5):
        low, high = np.maximum(np.ceil(triangle.min(0)), 0).astype(int), np.minimum(triangle.max(0), size - 1).astype(int)
        if (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        (ax, ay), (bx, by), (cx, cy) = triangle
        inside = ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 1e-7) & ((cx - bx) * (y - by) - (cy - by) * (x - bx) > 1e-7)
        inside &= (ax - cx) * (y - cy) - (ay - cy) * (x - cx) > 1e-7
        view = (slice(low[1], high[1] + 1), slice(low[0], high[0] + 1))
        count[view] += inside
        owner[view][inside] = number
    return count, owner
