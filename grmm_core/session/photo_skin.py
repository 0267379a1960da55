"""How far what a photo shows of skin under its own hair still holds: not where that hair is cut off, thinned or dyed.

A fitted person's texels show the photo's hair at temples, hairline and nape. Under the same strands they belong there; a host's
curves may have lost some of these, and the panel's sliders give them another color. Called by `wardrobe`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..hair.groom import Groom
from ..hair.pigment import albedos
from ..hair.roots import SCALP
from ..hair.settings import HairSettings
from ..head import HeadModel
from ..pictures.color import linear_to_srgb
from .evaluator import OpenAvatar
from .scalp import ramp, smoothed

REACH = 0.02  # metres of a strand from its root on that cover the skin there
SPREAD = 6  # triangles over which roots count: painted hair lies beside them, too
FEW = 0.05  # of the middle density of roots: where there are fewer, nothing of a photo's hair is missed
GONE, THERE = 0.2, 0.7  # of what covers the skin: up to where the photo's hair is gone, and from where on it is there
ALIKE, UNLIKE = 0.04, 0.16  # of full brightness, by which hair may differ from the photo's before its paint is not hair's


def still_there(target: OpenAvatar, photo: Groom | None, worn: Sequence[Groom], settings: HairSettings) -> np.ndarray:
    """How far the hair of a photo still covers the skin of each texel, 0..1, float32 [N].

    Args:
        target: Whose texels.
        photo: The groom of its file, None where that has none.
        worn: What is worn instead, made of it.
        settings: That this is drawn with; less density covers less.
    """
    layout, head = target.model.layout, target.model.head_model
    if photo is None:
        return np.ones(len(layout), np.float32)
    before = _roots(head, [photo])
    few = FEW * float(np.median(before[before > 0])) if (before > 0).any() else 1.0
    left = (_roots(head, worn) * min(settings.density, 1.0) + few) / (before + few)
    there = (left[np.asarray(head.faces)[layout.face]] * layout.barycentric).sum(1)
    return np.asarray(ramp(there, GONE, THERE), np.float32)


def as_found(settings: HairSettings, photo: HairSettings) -> float:
    """How far hair has the color that it has in the photo, 0..1."""
    colors = [linear_to_srgb(albedos(one, np.zeros(1), np.full((1, 2), 0.5))[0].mean(0)) for one in (settings, photo)]
    return float(ramp(np.abs(colors[0] - colors[1]).max(), UNLIKE, ALIKE))


def _roots(head: HeadModel, grooms: Sequence[Groom]) -> np.ndarray:
    """Area of strands near their roots, by the vertices that these stand on, of one unit or another, [V]."""
    faces, found = np.asarray(head.faces), np.zeros(len(head.v_template))
    for whole in grooms:
        groom = whole.select(whole.groups == SCALP)
        if not len(groom):
            continue
        steps = np.linalg.norm(np.diff(groom.points.astype(float), axis=0), axis=1)
        steps[groom.offsets[1:-1] - 1] = 0.0  # from one strand to the next
        lengths = np.add.reduceat(np.append(steps, 0.0), groom.offsets[:-1]).clip(max=REACH)
        np.add.at(found, faces[groom.triangles], groom.weights * (lengths * groom.widths[:, 0])[:, None])
    for _ in range(SPREAD):
        found = smoothed(found, faces)
    return found
