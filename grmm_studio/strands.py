"""Hair in the scene: a groom as Blender's own curves, one object for each group. Imports bpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from scipy.spatial import cKDTree

from grmm_core.hair.groom import Groom
from grmm_core.hair.lashes import Lashes
from grmm_core.hair.roots import GROUPS, LASHES
from grmm_core.head import HeadModel

LOCKS = 600  # of the hair that differ in color


def to_blender(points: np.ndarray) -> np.ndarray:
    """Head space (y up, face +z) to Blender (z up, face -y), [..., 3]."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], -1)


@dataclass
class _Part:
    item: Any
    first: int  # of its points among those of the groom
    last: int


class HairObjects:
    """The hair of one person; a shot rewrites its points."""

    def __init__(self, head: HeadModel, neutral: np.ndarray, groom: Groom, looks: dict[int, Any], seed: int) -> None:
        """Make the objects on the neutral head [V, 3]; `looks` has the material of each group."""
        self._groom = groom
        self._frames = groom.frames(head.v_template, head.faces)
        self._parts: list[_Part] = []
        self._lashes: tuple[Lashes, _Part] | None = None
        points = groom.posed(self._frames, neutral)
        g = np.random.default_rng(seed + 1)
        for group in range(len(GROUPS)):
            own = np.flatnonzero(groom.groups == group)
            if len(own):
                # the strands of a group follow each other
                part = _Part(None, int(groom.offsets[own[0]]), int(groom.offsets[own[-1] + 1]))
                some = groom.select(own)
                part.item = _curves(GROUPS[group], some, points[part.first : part.last], looks[group], g)
                self._parts.append(part)
                lashes = Lashes.build(head, neutral, some) if group == LASHES else None
                if lashes is not None:
                    self._lashes = lashes, part

    def pose(self, vertices: np.ndarray) -> None:
        """Move all strands with the posed head [V, 3]."""
        points = self._groom.posed(self._frames, vertices)
        if self._lashes is not None:
            lashes, part = self._lashes
            points[part.first : part.last] = lashes.points(vertices).reshape(-1, 3)
        for part in self._parts:
            data = part.item.data
            data.points.foreach_set("position", to_blender(points[part.first : part.last]).astype(np.float32).ravel())
            data.update_tag()

    def show(self, shown: bool) -> None:
        """Render the hair, or the head without it."""
        for part in self._parts:
            part.item.hide_render = not shown

    def remove(self) -> None:
        """Take the objects out of the scene."""
        for part in self._parts:
            data = part.item.data
            bpy.data.objects.remove(part.item)
            bpy.data.hair_curves.remove(data)


def _curves(name: str, groom: Groom, points: np.ndarray, material: Any, g: np.random.Generator) -> Any:
    data = bpy.data.hair_curves.new(name)
    data.add_curves(groom.counts.tolist())
    data.points.foreach_set("position", to_blender(points).astype(np.float32).ravel())
    root, tip = (np.repeat(groom.widths[:, k], groom.counts) for k in (0, 1))
    radius = 0.5 * (root + (tip - root) * groom.along**2)
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radius.astype(np.float32))
    # hair differs by lock more than by strand
    tips = points[groom.offsets[1:] - 1]
    lock = cKDTree(tips[g.integers(len(tips), size=LOCKS)]).query(tips)[1]
    tint = np.clip(0.5 + 0.22 * g.normal(0, 1, LOCKS)[lock] + 0.12 * g.normal(0, 1, len(tips)), 0, 1)
    data.attributes.new("tint", "FLOAT", "CURVE").data.foreach_set("value", tint.astype(np.float32))
    data.materials.append(material)
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item
