"""What a tracked photo says about hair: where it is, and which pixels are believed. Imports torch."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ..hair.coloring import HairView

if TYPE_CHECKING:
    from ..head import HeadModel
    from ..photo.parser import PhotoParts
    from .types import PhotoTrack

HARDLY_SHOWN = 0.03  # of the person's pixels: less hair tells no color
# how much less red than skin hair must be, as a share of all channels, and of how much of it that cannot be asked
SKIN_TINT, MOSTLY = 0.02, 0.9
_LIKELY = 0.5  # of a pixel, from where on it is hair, or skin
_SURE = 8  # power that labels are raised to


def hair_view(track: PhotoTrack, parts: PhotoParts, head: HeadModel) -> HairView:
    """What a tracked photo says about hair."""
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    labels = np.stack([getattr(parts, item.name) for item in dataclasses.fields(parts)])
    hair = parts.hair**_SURE / np.maximum((labels**_SURE).sum(0), 1e-6)  # a small network's doubts are no thin hair
    counts = track.valid * (1.0 - parts.hat) * (1.0 - parts.other)
    if _hatted(parts):
        counts = counts * (1.0 - _like_skin(track.image, hair * counts > _LIKELY, parts.skin > _LIKELY))
    return HairView(track.camera, vertices, track.image, hair, counts)


def _like_skin(image: np.ndarray, hair: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Pixels of the little hair beside a hat that are as red as skin or redder, [H, W] bool; none where most of it is.

    There thin hair lets the temples through, ears are taken for hair, and both are in the hat's shade.
    """
    tint = image[..., 0] / np.maximum(image.sum(2), 1e-3)
    found = hair & (tint > np.median(tint[skin]) - SKIN_TINT if skin.any() else False)
    return found if found.sum() < MOSTLY * hair.sum() else np.zeros_like(found)


def _hatted(parts: PhotoParts) -> bool:
    """Whether more of a hat shows than of hair."""
    return bool(parts.hat.sum() > parts.hair.sum())


def hardly_shown(view: HairView, parts: PhotoParts) -> bool:
    """Whether so little hair shows below a hat, in its shade, that the photo does not tell its color."""
    return _hatted(parts) and bool((view.hair * view.counts).sum() < HARDLY_SHOWN * (1.0 - parts.background).sum())
