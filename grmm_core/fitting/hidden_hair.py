"""Short hair that no photo shows: as flat as the photos made the rest of the groom.

A photo from the front says nothing of the back of the head, where bent strands stand as far off as the groom's always do: a man
with hair of a few millimetres came out with a thick pelt behind. Long hair falls as it does, and is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..hair.groom import Groom
from ..hair.strands import lengthened
from .hair_shape import Seen

if TYPE_CHECKING:
    from ..head import HeadModel

SHORT = 0.04  # metres from roots to tips, in the median: longer hair is left
OUTLINE = (-0.15, 0.3)  # cosines between skin and view where hair is the head's outline, which tells how far it stands off
HIDDEN = (-0.15, -0.5)  # likewise from where on it is hidden, and where wholly
STANDS = 0.002  # metres off the skin from which on strands tell how flat they became
FEW = 50  # strands: fewer tell nothing
FLATTEST = 0.35  # of the height before


def as_flat(groom: Groom, before: Groom, length: float, photos: Sequence[Seen], head: HeadModel) -> Groom:
    """A groom of scalp hair whose hidden strands are as flat as those of the outline became.

    Args:
        groom: Bent, its strands of one number of points.
        before: The same strands before.
        length: How many times as long these were drawn.
        photos: That it was bent to.
        head: Whose mesh they stand on.
    """
    count = int(groom.counts.max())
    now = groom.points.reshape(len(groom), count, 3)  # in the axes of the roots: the last is the height above the skin
    was = lengthened(before.resampled(count).points.reshape(now.shape), length)
    if np.median(np.linalg.norm(was[:, -1] - was[:, 0], axis=1)) > SHORT:
        return groom
    facing = np.full(len(groom), -1.0)
    frames = groom.frames(np.asarray(head.v_template, np.float64), head.faces)
    for photo in photos:
        origin, axes = frames.at(photo.vertices)
        way = photo.camera.position - origin
        facing = np.maximum(facing, (axes[:, 2] * way).sum(1) / np.linalg.norm(way, axis=1))
    height, stood = now[..., 2].max(1), was[..., 2].max(1)
    telling = (facing > OUTLINE[0]) & (facing < OUTLINE[1]) & (stood > STANDS)
    if telling.sum() < FEW:
        return groom
    flat = float(np.clip(np.median(height[telling] / stood[telling]), FLATTEST, 1.0))
    hidden = ((HIDDEN[0] - facing) / (HIDDEN[0] - HIDDEN[1])).clip(0.0, 1.0)
    points = now.copy()
    points[..., 2] *= (1.0 - hidden * (1.0 - flat))[:, None]
    return replace(groom, points=points.reshape(-1, 3).astype(groom.points.dtype))
