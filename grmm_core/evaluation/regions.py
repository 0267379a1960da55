"""Which region of the head each pixel of a captured view shows: the exact mesh, drawn by a depth buffer.

Hair has no surface of its own in the head model. It is what the mask covers where the mesh shows its scalp or nothing at all,
or where the captured depth lies clearly before the mesh. Used by `protocols`. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..head import HeadModel

# in order: a triangle belongs to the first group that holds all its corners
GROUPS: Mapping[str, tuple[str, ...]] = {
    "mouth": ("mouth_interior", "upper_teeth", "lower_teeth", "tongue"),
    "eyes": ("left_eyeball", "right_eyeball", "lids", "lashes"),
    "neck": ("neck",),
    "scalp": ("scalp",),
    "face": ("face", "lips", "brows"),
}
SCALP, REST, HAIR = "scalp", "rest", "hair"
REGIONS = ("mouth", "eyes", "hair", "face", "neck")
"""Regions that are reported; "mouth" is its interior with teeth and tongue, "face" the skin without eyes and mouth."""
HAIR_DEPTH = 0.004  # metres before the mesh


def triangle_groups(head: HeadModel) -> dict[str, np.ndarray]:
    """Triangles of each group and of the rest, as row numbers of `head.faces`."""
    label = np.full(len(head.faces), REST, dtype=object)
    for name, regions in reversed(list(GROUPS.items())):
        label[head.marked(*regions)[head.faces].all(1)] = name
    return {name: np.flatnonzero(label == name) for name in (*GROUPS, REST)}


def region_pixels(
    head: HeadModel,
    groups: Mapping[str, np.ndarray],
    vertices: np.ndarray,
    camera: Camera,
    mask: np.ndarray,
    depth: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """Pixels that show each of `REGIONS`.

    Args:
        head: Mesh.
        groups: Of `triangle_groups`.
        vertices: Posed vertices, metres, [V, 3].
        camera: In head space.
        mask: Coverage 0..1, [H, W].
        depth: Captured depth in metres, 0 where empty, [H, W]; None leaves hair before the face undiscovered.

    Returns:
        Name to [H, W] bool; a pixel has at most one.
    """
    names = list(groups)
    layers = np.stack([triangle_depth(vertices[head.faces[groups[name]]], camera) for name in names])  # [G, H, W]
    nearest = layers.argmin(0)
    surface = layers.min(0)
    covered = mask > 0.5
    hit = surface < EMPTY
    hair = covered & (~hit | (nearest == names.index(SCALP)))
    if depth is not None:
        hair |= covered & hit & (depth > 0) & (depth < surface - HAIR_DEPTH) & (nearest != names.index("mouth"))
    result = {HAIR: hair}
    for name in REGIONS:
        if name != HAIR:
            result[name] = covered & hit & (nearest == names.index(name)) & ~hair
    return {name: result[name] for name in REGIONS}
