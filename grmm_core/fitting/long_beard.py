"""Beards that hang lower than the package's fullest: grown on from the chin down to where the photo shows their end."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..hair.body import cut
from ..hair.coloring import HairView
from ..hair.groom import Groom
from ..hair.strands import lengthened
from ..head import HeadModel

POINTS = 12  # of a strand
LIKELY = 0.5  # of a pixel, from where on it is beard
# quantiles down the head: of pixels, where a beard ends; of tips, which are loose, likewise, and from where on they hang
LOWEST, ENDS, LOW = 0.97, 0.88, 0.6
CHIN = (-0.03, -0.06)  # metres: strands from below the second height hang, those from above the first are as long as they were
LONGEST = 5.0  # times as long as the groom's at most


def hanging(groom: Groom, cover: np.ndarray, down: np.ndarray, scale: float, view: HairView, head: HeadModel) -> Groom:
    """A beard that hangs as low as the photo shows it.

    Args:
        groom: On the mean head.
        cover: How much of each pixel is beard, [H, W] 0..1.
        down: Where the head's down goes in the picture, [2].
        scale: Pixels of a metre down the head.
        view: The photo with the tracked head.
        head: Whose mesh the strands stand on.
    """
    template, down = np.asarray(head.v_template, np.float64), down / np.linalg.norm(down)
    rows, columns = np.nonzero(cover > LIKELY)
    if not len(rows):
        return groom
    tips = groom.posed(groom.frames(template, head.faces), view.vertices)[groom.offsets[1:] - 1]
    low = view.camera.project(tips)[1] @ down
    even = groom.resampled(POINTS)
    points = even.points.reshape(len(even), POINTS, 3)
    missing = (np.quantile(np.stack([columns, rows], 1) @ down, LOWEST) - np.quantile(low, ENDS)) / scale
    usual = float(groom.lengths[low >= np.quantile(low, LOW)].mean())
    times = float(np.clip(1.0 + missing / usual, 1.0, LONGEST))
    heights = groom.frames(template, head.faces).at(template)[0][:, 1]
    each = 1.0 + (times - 1.0) * np.interp(heights, CHIN[::-1], (1.0, 0.0))
    return dataclasses.replace(even, points=cut(lengthened(points, times), each / times).reshape(-1, 3))
