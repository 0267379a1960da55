"""Small meshes for the tests of formats."""

from __future__ import annotations

import numpy as np


def grid(n=8, seed=0):
    """A bumpy sheet of n x n vertices and its triangles."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, n), np.linspace(-0.1, 0.1, n))
    vertices = np.stack([x.ravel(), y.ravel(), 0.02 * rng.normal(size=n * n)], 1).astype(np.float32)
    cell = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([cell, cell + 1, cell + n], 1), np.stack([cell + 1, cell + n + 1, cell + n], 1)])
    return vertices, faces


def seamed_mesh():
    """A sheet whose texture coordinates have a seam between its two halves of triangles."""
    vertices, faces = grid()
    rng = np.random.default_rng(6)
    uv = rng.uniform(size=(2 * len(vertices), 2)).astype(np.float32)
    uv_faces = faces + np.where(np.arange(len(faces)) % 2, len(vertices), 0)[:, None]
    jaw = np.zeros_like(vertices)
    jaw[10:20] = rng.normal(size=(10, 3))
    return vertices, faces, uv, uv_faces, {"jawOpen": jaw, "still": np.zeros_like(vertices)}
