"""Frames of glasses too thin for the parser: found by the bar that runs over the bridge of the nose. Imports torch."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional

from .widening import widened

EYES = ((33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
        (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249))  # fmt: skip
"""Landmarks around each eye."""
_OUTER, _INNER, _SIDES = (33, 263), (133, 362), (234, 454)
BAR = (-0.12, 0.26)  # where the bar can run, above and below the inner corners, in distances of the outer corners
BRIDGE = 0.3  # of the way between the inner corners that every column of the bar must cross, in the middle
ZONE = (-0.33, 0.42)  # likewise: how far above and below the eyes frames reach
WIDTHS = (0.05, 0.09)  # likewise: how far beside the middle of a frame the skin is compared
BAR_CONTRAST, CONTRAST = 0.06, 0.16  # that a line is darker than what is on both sides of it, relative to that
CROSSED, CROOKED = 0.9, 0.03  # share of the columns; how far the bar may leave a parabola
WIDENED = 0.025  # distances of the outer corners: blur and shadow of frames
GAP = 0.02  # likewise: what is farther from the rest of the frames is a wrinkle, a shadow or a reflection
EYE = 1.35  # how much larger than its outline what of an eye stays


def thin_frames(image: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Pixels of the frames of glasses, dark lines near the eyes that hang together with a bar, [H, W] bool; none without it.

    Args:
        image: Display sRGB, [H, W, 3].
        landmarks: The 478 of the face, pixels, [478, 2].
    """
    height, width = image.shape[:2]
    nothing = np.zeros((height, width), bool)
    outer = landmarks[list(_OUTER)]
    unit = float(np.linalg.norm(outer[1] - outer[0]))
    if unit < 24.0:  # too small to tell
        return nothing
    across = (outer[1] - outer[0]) / unit
    down = np.array([-across[1], across[0]])
    rows, columns = np.mgrid[:height, :width] + 0.5
    plane = torch.from_numpy(np.ascontiguousarray(image.mean(2), np.float32))[None, None]
    light: np.ndarray = functional.avg_pool2d(plane, 3, 1, 1)[0, 0].numpy()
    upright = _lines(light, down, unit)

    inner = landmarks[list(_INNER)]
    places = np.linspace(0.5 - 0.5 * BRIDGE, 0.5 + 0.5 * BRIDGE, 24)
    heights = np.linspace(*BAR, 40)
    points = inner[0] + places[:, None, None] * (inner[1] - inner[0]) + heights[None, :, None] * unit * down
    column, row = (np.clip(points[..., k].astype(int), 0, size - 1) for k, size in ((0, width), (1, height)))
    across_bridge = upright[row, column]
    course = heights[across_bridge.argmax(1)]
    crooked = np.abs(course - np.polyval(np.polyfit(places, course, 2), places)).mean()
    if (across_bridge.max(1) > BAR_CONTRAST).mean() < CROSSED or crooked > CROOKED:
        return nothing
    off = np.maximum(upright, _lines(light, across, unit))
    middle = inner.mean(0)
    low = (columns - middle[0]) * down[0] + (rows - middle[1]) * down[1]
    side = (columns - middle[0]) * across[0] + (rows - middle[1]) * across[1]
    ends = (landmarks[list(_SIDES)] - middle) @ across
    zone = (low > ZONE[0] * unit) & (low < ZONE[1] * unit) & (side > ends.min()) & (side < ends.max())
    for outline in EYES:
        marks = landmarks[list(outline)]
        centre = marks.mean(0)
        half = EYE * 0.5 * np.array([np.ptp(marks @ across), np.ptp(marks @ down) + 0.04 * unit])
        offset = np.stack([columns - centre[0], rows - centre[1]], -1)
        zone &= ((offset @ across / half[0]) ** 2 + (offset @ down / half[1]) ** 2) > 1.0
    bar = np.zeros_like(zone)
    bar[row[np.arange(len(places)), across_bridge.argmax(1)], column[np.arange(len(places)), across_bridge.argmax(1)]] = True
    reach, gap = (max(1, round(part * unit)) for part in (WIDENED, GAP))
    lines = (off > CONTRAST) & zone
    half = _connected(lines, _grown(bar, reach), gap)
    # frames are the same on both sides of the nose
    other = np.stack([columns, rows], -1) - 2.0 * side[..., None] * across
    column, row = (np.clip(other[..., k].astype(int), 0, size - 1) for k, size in ((0, width), (1, height)))
    return _grown(_connected(lines, half | _grown(half, gap)[row, column], gap), reach) & zone


def _grown(mask: np.ndarray, reach: int) -> np.ndarray:
    """A mask [H, W] widened by so many pixels to each side."""
    grown: np.ndarray = widened(torch.from_numpy(mask.astype(np.float32))[None], reach)[0].numpy() > 0.5
    return grown


def _connected(mask: np.ndarray, begin: np.ndarray, gap: int) -> np.ndarray:
    """What of a mask [H, W] hangs together with where it begins, over gaps of so many pixels."""
    found = mask & begin
    while True:
        further = mask & _grown(found, gap)
        if further.sum() == found.sum():
            return found
        found = further


def _lines(light: np.ndarray, direction: np.ndarray, unit: float) -> np.ndarray:
    """How much darker pixels are than what is on both sides of them in a direction, relative to that, [H, W]."""
    found = np.zeros_like(light)
    for width in WIDTHS:
        x, y = np.round(width * unit * direction).astype(int)
        both = np.minimum(np.roll(light, (y, x), (0, 1)), np.roll(light, (-y, -x), (0, 1)))
        found = np.maximum(found, 1.0 - light / np.maximum(both, 0.05))
    return found
