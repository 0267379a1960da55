"""The compiled twin of `roots.RootFrames.at`; importing this module loads numba."""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled

_LEAST = 1e-15


@compiled(fastmath=True, boundscheck=False, error_model="numpy", nogil=True)
def turn_patches(vertices: np.ndarray, members: np.ndarray, first: np.ndarray, second: np.ndarray, turned: np.ndarray) -> None:
    """Write the axes of patches of skin, as rows.

    Args:
        vertices: Posed, float32 [V, 3] metres.
        members: See `RootFrames`, and so `first`, `second`.
        first: [U, K].
        second: [U, K].
        turned: Written, float32 [U, 3, 3].
    """
    for u in range(len(members)):
        ax = ay = az = bx = by = bz = 0.0
        for k in range(members.shape[1]):
            v, a, b = members[u, k], first[u, k], second[u, k]
            x, y, z = float(vertices[v, 0]), float(vertices[v, 1]), float(vertices[v, 2])
            ax, ay, az = ax + a * x, ay + a * y, az + a * z
            bx, by, bz = bx + b * x, by + b * y, bz + b * z
        inverse = 1.0 / max(math.sqrt(ax * ax + ay * ay + az * az), _LEAST)
        ax, ay, az = ax * inverse, ay * inverse, az * inverse
        ox, oy, oz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        inverse = 1.0 / max(math.sqrt(ox * ox + oy * oy + oz * oz), _LEAST)
        ox, oy, oz = ox * inverse, oy * inverse, oz * inverse
        turned[u, 0, 0], turned[u, 0, 1], turned[u, 0, 2] = ax, ay, az
        turned[u, 1, 0], turned[u, 1, 1], turned[u, 1, 2] = oy * az - oz * ay, oz * ax - ox * az, ox * ay - oy * ax
        turned[u, 2, 0], turned[u, 2, 1], turned[u, 2, 2] = ox, oy, oz


@compiled(fastmath=True, boundscheck=False, error_model="numpy", nogil=True)
def stand_roots(
    vertices: np.ndarray, corners: np.ndarray, weights: np.ndarray, patch: np.ndarray, turned: np.ndarray,
    origin: np.ndarray, axes: np.ndarray,
) -> None:  # fmt: skip
    """Write origins, float32 [N, 3], and axes, float32 [N, 3, 3], of the first roots; see `RootFrames` and `turn_patches`."""
    for i in range(len(origin)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        for k in range(3):
            origin[i, k] = weights[i, 0] * vertices[a, k] + weights[i, 1] * vertices[b, k] + weights[i, 2] * vertices[c, k]
            for j in range(3):
                axes[i, k, j] = turned[patch[i], k, j]
