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

from ..photo.widening import widened

WINDOW, GRAIN_WINDOW = 5, 9  # px: over which a structure tensor is averaged, for directions and for grain
CLEAR = 0.25  # coherence below which a photo's hair has no clear direction
INSIDE, MARGIN = 0.6, 2  # cover above which a pixel is hair, and how far around it all must be
FEW = 3000  # pixels of hair: fewer tell nothing
ABOVE_SKIN = 2.0  # squared gradients of hair over those of skin: below, they are the picture's noise
COILY, STRAIGHT = 0.32, 0.5  # mean coherence of what is surely coily, and of what is surely not
SHOWN = 0.012  # metres: shorter strands show no coils, as stubble
# metres: over which the directions of waves are averaged, of a line along strands, and of its steps; lines, and how many of
# them must stay in clear hair
WAVE_WINDOW, LINE, STEP, LINES, LEAST_LINES = 0.017, 0.08, 0.005, 1500, 60
HARDLY_CLEAR = 0.3  # length of a direction that a line still follows
SMOOTHED = 3  # pixels over which directions are averaged for these
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


def waviness(image: np.ndarray, hair: np.ndarray, pixels_per_metre: float) -> float | None:
    """Radians by which hair in a picture turns to and fro over `LINE`; None where too little shows.

    The median of lines that follow the directions step by step, without what they turn altogether. Straight hair in photos has
    up to 0.4, as it is noisy, wavy hair 0.5 to 0.8, ringlets more.

    Args:
        image: [H, W, 3].
        hair: Cover, [H, W].
        pixels_per_metre: At the head.
    """
    inside = np.asarray(hair) > INSIDE
    rows, columns = np.nonzero(inside)
    if len(rows) < FEW:
        return None
    chosen = (np.arange(LINES) * 0.6180339887498949 % 1.0 * len(rows)).astype(int)
    place = np.stack([columns[chosen], rows[chosen]], 1).astype(np.float64)
    window = 2 * round(0.5 * WAVE_WINDOW * pixels_per_metre) + 1
    planes = torch.from_numpy(np.stack(directions(image, hair, window)))[None]
    cosine, sine = functional.avg_pool2d(planes, SMOOTHED, 1, SMOOTHED // 2)[0].numpy()
    angle, clear = 0.5 * np.arctan2(sine, cosine), (np.hypot(cosine, sine) > HARDLY_CLEAR) & inside
    way, follows = np.zeros_like(place), np.ones(LINES, bool)
    turns = []
    for step in range(round(LINE / STEP) + 1):
        column, row = (np.clip(place[:, k], 0, size - 1).astype(int) for k, size in ((0, hair.shape[1]), (1, hair.shape[0])))
        follows &= clear[row, column] & (place >= 0).all(1) & (place < hair.shape[::-1]).all(1)
        here = np.stack([np.cos(angle[row, column]), np.sin(angle[row, column])], 1)
        here *= np.where((here * way).sum(1) < 0, -1.0, 1.0)[:, None]
        if step:
            turns.append(np.arctan2(way[:, 0] * here[:, 1] - way[:, 1] * here[:, 0], (way * here).sum(1)))
        way = here
        place = place + way * STEP * pixels_per_metre
    if follows.sum() < LEAST_LINES:
        return None
    turned = np.stack(turns, 1)[follows]
    return float(np.median(np.abs(turned).sum(1) - np.abs(turned.sum(1))))


def coils(strands: np.ndarray) -> float:
    """How coily strands [N, K, 3] are, 0..1: by their turning over their length, metres."""
    ways, lengths = _ways(strands)
    turning = float(np.median(np.degrees(_angles(ways[:, 1:], ways[:, :-1]).sum(1)) / np.maximum(100.0 * lengths, 1e-6)))
    shown = min(1.0, float(np.median(lengths)) / SHOWN)
    return shown * float(np.clip((turning - TURNING[0]) / (TURNING[1] - TURNING[0]), 0.0, 1.0))


def waves(strands: np.ndarray) -> float:
    """Radians by which strands [N, K, 3] turn to and fro over `LINE`, beside their turn from root to tip; the mean of all."""
    ways, lengths = _ways(strands)
    turned = _angles(ways[:, 1:], ways[:, :-1]).sum(1) - _angles(ways[:, 0], ways[:, -1])
    return float(np.mean(turned * LINE / np.maximum(lengths, LINE)))


def _ways(strands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of strands' segments, [N, K - 1, 3], and strands' lengths, [N] metres."""
    steps = np.diff(strands, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    return steps / np.maximum(lengths, 1e-9)[..., None], lengths.sum(1)


def _angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Radians between directions [..., 3]."""
    angles: np.ndarray = np.arccos(np.clip((first * second).sum(-1), -1.0, 1.0))
    return angles
