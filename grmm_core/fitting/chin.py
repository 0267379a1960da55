"""Where a head is below its chin: neck, bust, and the underside of the jaw. Used by `surface` and `photo_light`."""

from __future__ import annotations

import numpy as np

from ..geometry.triangles import vertex_normals
from ..head import HeadModel

BELOW = (0.035, 0.05)  # metres below the lips: the chin is before the first, its underside beyond the second
# likewise of skin that faces down, by the normal's share: towards the ears the jaw's underside lies higher than the chin's
UNDER_LIPS, DOWNWARDS = (0.015, 0.025), (0.35, 0.65)


def below_chin(head: HeadModel) -> np.ndarray:
    """How far the vertices of the mean head are below its chin, 0..1 [V]; 0 for a head whose lips are not known."""
    vertices = np.asarray(head.v_template, np.float64)
    if "lips" not in head.regions:
        return np.zeros(len(vertices))
    lower = vertices[head.regions["lips"], 1].min() - vertices[:, 1]
    down = np.interp(-vertex_normals(vertices, head.faces)[:, 1], DOWNWARDS, (0.0, 1.0))
    below = np.maximum(np.interp(lower, BELOW, (0.0, 1.0)), np.interp(lower, UNDER_LIPS, (0.0, 1.0)) * down)
    if "neck" in head.regions:
        below[head.regions["neck"]] = 1.0
    return below
