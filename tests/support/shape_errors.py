"""How far a fitted shape is from the truth, on people whose shape is known.

For the tests, and for whoever changes the tracking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from photos import analyse_picture

from grmm_core.errors import ConfigError, NoFaceError
from grmm_core.fitting.landmark_stage import similarity
from grmm_core.fitting.track import AnalysedPhoto, track_photos
from grmm_core.head.head_model import HeadModel

REGIONS = ("face", "ears")
_MILLIMETRES = 1000.0


@dataclass(frozen=True)
class ShapeErrors:
    """Shape errors of several people.

    Attributes:
        photos: How many photos each person was fitted from.
        millimetres: Error of each person.
        mean_head: Error of the mean head for the same people: what a fit must be better than.
    """

    photos: int
    millimetres: tuple[float, ...]
    mean_head: tuple[float, ...]


def shape_error(head: HeadModel, shape: np.ndarray, truth: np.ndarray, regions: Sequence[str] = REGIONS) -> float:
    """Mean distance of the neutral head's vertices after similarity alignment (rotation, shift, scale).

    A photo does not tell how large a head is, so scale is aligned away.

    Args:
        head: Head model of both.
        shape: Estimated coefficients, [S].
        truth: True ones, [S].
        regions: Vertices that count.

    Returns:
        Millimetres.
    """
    chosen = np.unique(np.concatenate([head.regions[name] for name in regions]))
    found = head.shaped(shape)[chosen].astype(np.float64)
    wanted = head.shaped(truth)[chosen].astype(np.float64)
    return float(np.linalg.norm(aligned(found, wanted) - wanted, axis=1).mean() * _MILLIMETRES)


def aligned(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Move points [N, 3] by the similarity that brings them nearest to `target` [N, 3] (Umeyama 1991)."""
    rotation, scale, shift = similarity(points, target)
    return scale * points @ rotation.T + shift


def measure_shapes(
    head: HeadModel, people: Sequence[tuple[np.ndarray, Sequence[np.ndarray]]], photos: int, *, size: int = 256
) -> ShapeErrors:
    """Track pictures of people with known shapes.

    Args:
        head: Head model of the shapes.
        people: True shape coefficients [S] and pictures (display sRGB 0..1, [H, W, 3]) of each person; pictures without a
            face are passed over.
        photos: Pictures used of each person; people with fewer are left out.
        size: Side of the working pictures.

    Raises:
        ConfigError: Nobody has that many usable pictures.
    """
    found, mean = [], []
    for truth, pictures in people:
        usable: list[AnalysedPhoto] = []
        for picture in pictures:
            if len(usable) == photos:
                break
            try:
                usable.append(analyse_picture(picture))
            except NoFaceError:
                continue
        if len(usable) == photos:
            tracks = track_photos(usable, head, size=size)
            found.append(shape_error(head, tracks[0].shape, truth))
            mean.append(shape_error(head, np.zeros_like(truth), truth))
    if not found:
        raise ConfigError(f"Nobody has {photos} pictures with a face; use a data set with more views.")
    return ShapeErrors(photos, tuple(found), tuple(mean))
