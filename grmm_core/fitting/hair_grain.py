"""The grain of hair in a photo: how strands lie, and whether they are straight or coily.

A silhouette does not tell short coily hair from short combed hair. Strands that lie side by side make gradients of one
direction within a millimetre or two; coils make speckles. Blur and small faces leave only what has a direction, so that few are
taken for coily that are not. Imports torch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional

from ..hair.groom import Groom
from ..photo.widening import widened

WINDOW, GRAIN_WINDOW = 5, 9  # px: over which a structure tensor is averaged, for directions and for grain
CLEAR = 0.25  # coherence below which a photo's hair has no clear direction
INSIDE, MARGIN = 0.6, 2  # cover above which a pixel is hair, and how far around it all must be
FEW = 3000  # pixels of hair: fewer tell nothing
ABOVE_SKIN = 2.0  # squared gradients of hair over those of skin: below, they are the picture's noise
COILY, STRAIGHT = 0.32, 0.5  # mean coherence of what is surely coily, and of what is surely not
SHOWN = 0.012  # metres: shorter strands show no coils, as stubble
TURNING = (45.0, 90.0)  # degrees a centimetre: strands that turn less are straight, that turn more are coily


class Directions(NamedTuple):
    """Directions of strands on a picture: cosine and sine of twice the angle times how clear it is, [H, W] each."""

    cosine: np.ndarray
    sine: np.ndarray


def structure(image: np.ndarray, window: int = WINDOW) -> np.ndarray:
    """Structure tensor of the lightness (Bigun and Granlund 1987) of a picture [H, W, 3], averaged over a window, [3, H, W].

    Squared gradient times cosine and sine of twice its angle, and the squared gradient.
    """
    down, across = np.gradient(np.asarray(image, np.float64).mean(2))
    squares = torch.from_numpy(np.stack([across**2 - down**2, 2 * across * down, across**2 + down**2]))[None]
    mean: np.ndarray = functional.avg_pool2d(squares, window, 1, window // 2, count_include_pad=False)[0].numpy()
    return mean


def directions(image: np.ndarray, hair: np.ndarray, window: int = WINDOW, clear: float = CLEAR) -> Directions:
    """Directions of strands by the structure tensor of the lightness, clear ones of length 1.

    Args:
        image: [H, W, 3].
        hair: Cover, [H, W]; nothing is said elsewhere.
        window: Pixels over which the tensor is averaged, odd.
        clear: Coherence, 0..1, above which a direction is clear.
    """
    mean = structure(image, window)
    # the strand lies across the gradient: twice its angle is half a turn further
    coherence = np.hypot(mean[0], mean[1]) / (mean[2] + 1e-5)
    factor = np.where(coherence > clear, -np.asarray(hair) / (mean[2] + 1e-5), 0.0)
    return Directions(mean[0] * factor, mean[1] * factor)


def amid(mask: np.ndarray) -> np.ndarray:
    """Pixels of a mask [H, W] that lie `MARGIN` inside it, bool."""
    outside = torch.from_numpy(1.0 - np.asarray(mask, np.float32))[None]
    inside: np.ndarray = widened(outside, MARGIN)[0].numpy() == 0.0
    return inside


def coiliness(image: np.ndarray, hair: np.ndarray, skin: np.ndarray) -> float | None:
    """How coily hair in a picture looks, 0..1; None where too little shows.

    Args:
        image: [H, W, 3].
        hair: Cover, [H, W].
        skin: Pixels of plain skin, for the noise of the picture, [H, W] bool.
    """
    inside = amid(np.asarray(hair) > INSIDE)
    if inside.sum() < FEW:
        return None
    even, odd, energy = structure(image, GRAIN_WINDOW)
    bare = amid(skin)
    if bare.any() and np.median(energy[inside]) < ABOVE_SKIN * np.median(energy[bare]):
        return None
    coherence = float((np.hypot(even, odd) / (energy + 1e-6))[inside].mean())
    return float(np.clip((STRAIGHT - coherence) / (STRAIGHT - COILY), 0.0, 1.0))


def coils(groom: Groom) -> float:
    """How coily the strands of a groom are, 0..1: by their turning over their length (strands of one number of points)."""
    ways, lengths = _ways(groom)
    turning = float(np.median(np.degrees(_angles(ways[:, 1:], ways[:, :-1]).sum(1)) / np.maximum(100.0 * lengths, 1e-6)))
    shown = min(1.0, float(np.median(lengths)) / SHOWN)
    return shown * float(np.clip((turning - TURNING[0]) / (TURNING[1] - TURNING[0]), 0.0, 1.0))


def waves(groom: Groom) -> float:
    """Radians by which strands turn to and fro, beside what turns them from root to tip; mean of strands, as of `coils`."""
    ways, _ = _ways(groom)
    return float(np.mean(_angles(ways[:, 1:], ways[:, :-1]).sum(1) - _angles(ways[:, 0], ways[:, -1])))


def _ways(groom: Groom) -> tuple[np.ndarray, np.ndarray]:
    """Directions of strands' segments, [N, K - 1, 3], and strands' lengths, [N] metres."""
    steps = np.diff(groom.points.reshape(len(groom), -1, 3), axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    return steps / np.maximum(lengths, 1e-9)[..., None], lengths.sum(1)


def _angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Radians between directions [..., 3]."""
    angles: np.ndarray = np.arccos(np.clip((first * second).sum(-1), -1.0, 1.0))
    return angles
