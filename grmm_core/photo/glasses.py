"""Glasses in a photo: frames, and skin that is seen through lenses.

Thick frames and dark lenses are known to the parser. Dark frames too thin for it are found by the bar that runs over the bridge
of the nose (`thin_frames`), all others by their outlines (`lenses`). What clear lenses show of skin is no measure of it: they
tint, reflect and shift it, and frames throw their shadow there. Imports torch.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import torch
from torch.nn import functional

from ..pictures.polygons import polygon
from .lenses import BROWS, EYES, INNER, OUTER, SIDES, lens_outlines
from .widening import widened

if TYPE_CHECKING:
    from .parser import PhotoParts


BAR = (-0.12, 0.26)  # where the bar can run, above and below the inner corners, in distances of the outer corners
BRIDGE = 0.3  # of the way between the inner corners that every column of the bar must cross, in the middle
ZONE = (-0.33, 0.42)  # likewise: how far above and below the eyes frames reach
WIDTHS = (0.05, 0.09)  # likewise: how far beside the middle of a frame the skin is compared
BAR_CONTRAST, CONTRAST = 0.06, 0.16  # that a line is darker than what is on both sides of it, relative to that
CROSSED, CROOKED = 0.9, 0.03  # share of the columns; how far the bar may leave a parabola
WIDENED = 0.025  # distances of the outer corners: blur and shadow of frames
GAP = 0.02  # likewise: what is farther from the rest of the frames is a wrinkle, a shadow or a reflection
EYE = 1.35  # how much larger than its outline what of an eye stays
LIKELY = 0.5  # share of a pixel from which it is taken for glasses
CLEAR = 0.55  # of the face's lightness: skin behind darker lenses is not seen
# share of the brows' landmarks behind frames and lenses from which on what is seen above them tells nothing of brows; how far
# above their middle that is, in distances of the outer corners
HIDDEN, OVER = 0.85, 0.15
SHADOW = 0.05  # distances of the outer corners: how far frames throw their shadow on skin, and blur


class Marked(Protocol):
    """What is used of a `fitting.types.PhotoTrack`."""

    image: np.ndarray
    landmarks: np.ndarray


class Glasses(NamedTuple):
    """What glasses do to a picture.

    Attributes:
        covered: Pixels of frames and dark lenses, [H, W] bool.
        lenses: Pixels behind clear lenses, and beside frames, whose colors are not those of what is there, likewise.
    """

    covered: np.ndarray
    lenses: np.ndarray


@lru_cache(maxsize=8)
def worn_glasses(track: Marked, parts: PhotoParts) -> Glasses:
    """Glasses in a tracked photo; the last few answers are kept.

    Args:
        track: The photo.
        parts: What the parser says of it.
    """
    image, landmarks = track.image, track.landmarks
    thin, parsed = thin_frames(image, landmarks), parts.glasses > LIKELY
    found = lens_outlines(image, landmarks, known=bool(thin.any() or parsed.any()))
    if found is None:
        return Glasses(parsed | thin, np.zeros_like(parsed))
    eyes = np.zeros_like(parsed)
    for outline in EYES:
        eyes |= polygon(eyes.shape, landmarks[list(outline)])
    light, face = image.mean(2), (parts.skin > LIKELY) & ~found.inside & ~found.frames
    behind = found.inside & ~eyes
    if not face.any() or not behind.any() or np.median(light[behind]) < CLEAR * np.median(light[face]):
        return Glasses(parsed | thin | found.inside | found.frames, np.zeros_like(parsed))
    across = landmarks[OUTER[1]] - landmarks[OUTER[0]]
    unit = float(np.linalg.norm(across))
    near = _grown(found.inside | found.frames, max(1, round(SHADOW * unit)))
    rows, columns = np.mgrid[: near.shape[0], : near.shape[1]]
    side = (columns * across[0] + rows * across[1]) / unit
    beside = (side < side[found.inside].min()) | (side > side[found.inside].max())  # temples
    covered = (found.frames | parsed | thin & (near | beside)) & ~found.inside
    brows, down = [landmarks[list(brow)] for brow in BROWS], np.array([-across[1], across[0]]) / unit
    column, row = (np.clip(np.concatenate(brows)[:, k].astype(int), 0, near.shape[1 - k] - 1) for k in (0, 1))
    if near[row, column].mean() > HIDDEN:
        near = near | np.any([_above(marks, down, near.shape, unit) for marks in brows], 0)
    return Glasses(covered, near & ~covered)


def _above(marks: np.ndarray, down: np.ndarray, shape: tuple[int, ...], unit: float) -> np.ndarray:
    """Pixels of a brow [10, 2] that frames hide, and above it, [H, W] bool."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    low, side = columns * down[0] + rows * down[1], columns * down[1] - rows * down[0]
    height, place = marks @ down, marks[:, 0] * down[1] - marks[:, 1] * down[0]
    above: np.ndarray = (low > height.mean() - OVER * unit) & (low < height.max())
    return above & (side > place.min()) & (side < place.max())


def thin_frames(image: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Pixels of the frames of glasses, dark lines near the eyes that hang together with a bar, [H, W] bool; none without it.

    Args:
        image: Display sRGB, [H, W, 3].
        landmarks: The 478 of the face, pixels, [478, 2].
    """
    height, width = image.shape[:2]
    nothing = np.zeros((height, width), bool)
    outer = landmarks[list(OUTER)]
    unit = float(np.linalg.norm(outer[1] - outer[0]))
    if unit < 24.0:  # too small to tell
        return nothing
    across = (outer[1] - outer[0]) / unit
    down = np.array([-across[1], across[0]])
    rows, columns = np.mgrid[:height, :width] + 0.5
    plane = torch.from_numpy(np.ascontiguousarray(image.mean(2), np.float32))[None, None]
    light: np.ndarray = functional.avg_pool2d(plane, 3, 1, 1)[0, 0].numpy()
    upright = _lines(light, down, unit)

    inner = landmarks[list(INNER)]
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
    ends = (landmarks[list(SIDES)] - middle) @ across
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
