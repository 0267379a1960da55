"""How dark a mouth is inside. Needs numpy only.

Between the teeth of people who speak or laugh, photos are nearly black (docs/rendering.md, "Mouths"). The head's mouth is a
shallow bag, and the capture studio makes up for light that bounces in it more often than a render follows, so that learned
colors glow: mouths of plastic. Here its lining and the tongue get darker the deeper they lie behind the front teeth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..head import HeadModel
    from .resting import Texels

LEFT, REACH = 0.4, 0.012  # share of light that is left deep inside, and metres behind the front teeth until most of it is lost
THIN, THICK = 0.010, 0.018  # metres from the outer skin: up to the first lining stays as it is, from the second on it is inside
_GAMMA = 2.2  # of display values, nearly


def depth_leaves(head: HeadModel) -> np.ndarray | None:
    """Share of the light that the depth of a mouth leaves to each vertex, [V]; None for heads without a mouth inside.

    The lining of cheeks stays as it is: it is hardly seen, and what of it shines through the cheek was learned with it.
    """
    if not {"upper_teeth", "mouth_interior"} <= head.regions.keys():
        return None
    vertices, lips = head.v_template, head.marked("lips")
    inside = np.flatnonzero(head.marked("mouth_interior", "tongue") & ~lips)
    skin = vertices[(head.marked("face", "neck") | lips) & ~head.marked("mouth_interior")]
    places = vertices[inside]
    squares = (places * places).sum(1)[:, None] + (skin * skin).sum(1) - 2.0 * (places @ skin.T)
    within = ((np.sqrt(squares.min(1).clip(0.0, None)) - THIN) / (THICK - THIN)).clip(0.0, 1.0)
    depth = (vertices[head.regions["upper_teeth"], 2].max() - places[:, 2]).clip(0.0, None)
    leaves = np.ones(len(vertices))
    leaves[inside] = 1.0 - (1.0 - LEFT) * within * (1.0 - np.exp(-((depth / REACH) ** 2)))
    return leaves


def mouth_shade(head: HeadModel, texels: Texels) -> np.ndarray | None:
    """What display colors of texels are multiplied by, [N, 1] float32; None for heads without a mouth inside."""
    leaves = depth_leaves(head)
    return None if leaves is None else texels.at(leaves[:, None]) ** np.float32(1.0 / _GAMMA)
