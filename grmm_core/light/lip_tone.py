"""Lips as dark as people's. Needs numpy only.

On photos a lower lip is half as bright as the cheek and an upper one two fifths, both are less red than they were learned, and
the corners of the mouth are dark creases (docs/rendering.md, "Mouths"). The capture studio painted lips too light and lights
them from below as well, so that they were one red patch that ended without a crease.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..head.lip_border import falls, lip_borders

if TYPE_CHECKING:
    from ..head import HeadModel
    from .resting import Texels

UPPER, LOWER = np.array([0.68, 0.73, 0.77]), np.array([0.76, 0.84, 0.94])  # of the linear colors that were learned
EDGE, SEAM = 0.0009, 0.0008  # metres about the borders within which lips end, and about the line where they meet
CORNERS, BEHIND = (0.94, 1.02), (0.006, 0.012)  # share of the mouth's half width, metres behind the borders: lips end there
CORNER = np.array([0.55, 0.62, 0.62])  # of light, what a corner of the mouth keeps off: a crease that goes on into the cheek
OUTWARDS, INWARDS, ACROSS, DOWN = 0.0035, 0.0025, 0.0012, 0.15  # metres along and across it; how far it drops on its way
_MEET = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308), (78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308)  # MediaPipe's
_GAMMA = 2.2  # of display values, nearly


def tone_at(head: HeadModel, places: np.ndarray) -> np.ndarray | None:
    """What linear colors are multiplied by on skin, lips and the lining of the mouth; None for heads without landmarks of lips.

    Args:
        head: Head model.
        places: On its template, metres, [N, 3].

    Returns:
        [N, 3], 1 beside lips.
    """
    borders = lip_borders(head)
    if not borders:
        return None
    marks = head.landmark_positions(head.v_template, 478)
    x, y = (np.mean([marks[list(row), axis] for row in _MEET], 0) for axis in (0, 1))
    upper = (0.5 + 0.5 * (places[:, 1] - np.interp(places[:, 0], x, y)) / SEAM).clip(0.0, 1.0)[:, None]
    share = falls(np.abs(places[:, 0]) / borders[0].points[-1, 0], *CORNERS)
    for border in borders:
        behind = np.interp(places[:, 0], border.points[:, 0], border.points[:, 2]) - places[:, 2]
        share = share * border.share(places, EDGE) * falls(behind, *BEHIND)
    found: np.ndarray = 1.0 + (LOWER + (UPPER - LOWER) * upper - 1.0) * share[:, None]
    for corner in marks[[61, 291]]:
        along = (places[:, 0] - corner[0]) * np.sign(corner[0])
        across = places[:, 1] - corner[1] + DOWN * along.clip(0.0, None)
        near = np.exp(-0.5 * ((along / np.where(along > 0.0, OUTWARDS, INWARDS)) ** 2 + (across / ACROSS) ** 2))
        found *= 1.0 - CORNER * (near * falls(corner[2] - places[:, 2], *BEHIND))[:, None]
    return found


def lip_tone(head: HeadModel, texels: Texels) -> np.ndarray | None:
    """What display colors of texels are multiplied by, [N, 3] float32; None for heads without landmarks of lips."""
    rows = np.flatnonzero(~head.marked("upper_teeth", "lower_teeth", "tongue", "lashes")[texels.corners].any(1))
    tone = tone_at(head, np.einsum("nk,nkx->nx", texels.barycentric[rows], head.v_template[texels.corners[rows]]))
    if tone is None:
        return None
    found = np.ones((len(texels.corners), 3), np.float32)
    found[rows] = tone ** (1.0 / _GAMMA)
    return found
