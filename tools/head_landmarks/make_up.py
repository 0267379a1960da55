"""Lipstick, eye shadow, lid lines, darkened brows and dark corners of the mouth, which people in photos have.

Those of the package have none of them: a network that never saw the dark beside teeth took their ends for the mouth's corners.
Painted on finished pictures, so that each is made up anew whenever it is learned from (`photo_parser.props` does so on meshes).
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

from grmm_core.photo.lenses import BROWS as OUTLINES
from grmm_core.photo.lenses import EYES

from ..photo_parser.drawn import Generator

LIPS, SHADOW, LINE, BROWS, CORNERS = 0.3, 0.25, 0.35, 0.25, 0.4  # shares of pictures
FINER = 2  # pixels of a mask for one of the picture, each way
_OUTER_LIPS = 61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146
_INNER_LIPS = 78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95
_LIDS = tuple(outline[:9] for outline in EYES)
_UNDER_BROWS = tuple(outline[:4:-1] for outline in OUTLINES)


def made_up(picture: np.ndarray, points: np.ndarray, g: Generator) -> np.ndarray:
    """Make a face up, or leave it as it is.

    Args:
        picture: [S, S, 3] float, 0..1.
        points: Landmarks in it, pixels, [478, 2].
        g: Draws what is worn.

    Returns:
        Another picture.
    """
    if g.random() < LIPS:
        tint = np.array([g.uniform(0.5, 1.0), g.uniform(0.1, 0.7), g.uniform(0.15, 0.75)])
        picture = _tinted(picture, tint, g.uniform(0.2, 0.9), 1.5, [points[list(_OUTER_LIPS)]], [points[list(_INNER_LIPS)]])
    if g.random() < CORNERS:
        inner = points[list(_INNER_LIPS)]
        corners, middle = points[[78, 308]], points[[13, 14]].mean(0)
        reach = g.uniform(0.3, 0.75)
        pieces = [_beyond(inner, corner + (middle - corner) * reach, corner - middle) for corner in corners]
        picture = _tinted(picture, g.uniform(0.0, 0.25) * np.ones(3), g.uniform(0.5, 1.0), g.uniform(0.7, 2.5), pieces)
    if g.random() < SHADOW:
        reach = g.uniform(0.3, 0.8)
        above = [_lids_to(points, lid, brow, reach) for lid, brow in zip(_LIDS, _UNDER_BROWS, strict=True)]
        picture = _tinted(picture, g.uniform(0.1, 0.7, 3), g.uniform(0.2, 0.8), 4.0, above)
    if g.random() < LINE:
        width = g.uniform(1.0, 5.0)
        picture = _tinted(
            picture, np.full(3, 0.05), g.uniform(0.3, 0.95), 0.7, lines=[points[list(lid)] for lid in _LIDS], width=width
        )
    if g.random() < BROWS:
        rows = [points[list(outline)] for outline in OUTLINES]
        picture = _tinted(picture, g.uniform(0.05, 0.25) * np.ones(3), g.uniform(0.2, 0.8), 2.0, rows)
    return picture


def _beyond(outline: np.ndarray, place: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """An outline, [N, 2], of which what lies before a place is pulled there along a direction."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-6)
    lacking = np.maximum((place - outline) @ unit, 0.0)
    pulled: np.ndarray = outline + lacking[:, None] * unit
    return pulled


def _lids_to(points: np.ndarray, lid: tuple[int, ...], brow: tuple[int, ...], reach: float) -> np.ndarray:
    """The outline of what lies between a lid's edge and a share of the way to the brow."""
    edge, under = points[list(lid)], points[list(brow)]
    shares = np.linspace(0, len(under) - 1, len(edge))
    top = np.stack([np.interp(shares, np.arange(len(under)), under[:, axis]) for axis in range(2)], 1)
    return np.concatenate([edge, (edge + (top - edge) * reach)[::-1]])


def _tinted(
    picture: np.ndarray,
    tint: np.ndarray,
    strength: float,
    soft: float,
    shapes: list[np.ndarray] | None = None,
    holes: list[np.ndarray] | None = None,
    lines: list[np.ndarray] | None = None,
    width: float = 1.0,
) -> np.ndarray:
    """A picture that is multiplied by a color within shapes and along lines, with edges as soft as that many pixels."""
    size = picture.shape[0] * FINER
    mask = Image.new("L", (size, size))
    pen = ImageDraw.Draw(mask)
    for outline in shapes or []:
        pen.polygon([tuple(point) for point in outline * FINER], fill=255)
    for outline in holes or []:
        pen.polygon([tuple(point) for point in outline * FINER], fill=0)
    for line in lines or []:
        pen.line([tuple(point) for point in line * FINER], fill=255, width=max(1, round(width * FINER)))
    mask = mask.filter(ImageFilter.GaussianBlur(soft * FINER)).resize(
        (picture.shape[1], picture.shape[0]), Image.Resampling.BOX
    )
    share = np.asarray(mask, np.float32)[..., None] / 255 * strength
    return picture * (1 - share * (1 - tint.astype(np.float32)))
