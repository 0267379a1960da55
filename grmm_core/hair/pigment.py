"""Colors of strands from a few pigments, for a person's settings, and their locks. Needs numpy only."""

from __future__ import annotations

import numpy as np

from ..pictures.color import srgb_to_linear
from .grids import nearest
from .groom import Groom
from .settings import HairSettings

# linear RGB: what eumelanin leaves of light hair, what red pigment leaves, and hair without pigment
ABSORPTION, BLOND = np.array([3.4, 4.1, 5.0]), np.array([0.62, 0.44, 0.235])
GINGER, GINGER_ABSORPTION = np.array([0.34, 0.10, 0.025]), 1.6
WHITE = np.array([0.46, 0.455, 0.45])
ROOT_SHADE = 0.78  # of the color at the tip
LOCKS = 400  # of differing color
LOCK_TONE, OWN_TONE = 0.55, 1.6  # how much tones of locks and of single hairs differ where `variation` is 1


def albedos(settings: HairSettings, lock: np.ndarray, chance: np.ndarray, hairs: float = 1.0, share: float = 1.0) -> np.ndarray:
    """Return linear RGB at root and tip of each strand.

    A drawn strand stands for a bundle: it is as grey as a sample of so many hairs, and differs from its neighbours as means do.

    Args:
        settings: Pigments.
        lock: Tone of the strand's lock, about -1..1, [N].
        chance: Even random numbers for grey and for tone, 0..1, [N, 2].
        hairs: How many a strand stands for where all strands are drawn, which `variation` speaks of.
        share: Of the strands that are drawn, 0..1.

    Returns:
        [N, 2, 3] float32.
    """
    s = settings
    tone = 1.0 + s.variation * (LOCK_TONE * lock + OWN_TONE * (chance[:, 1] - 0.5) * share**0.5)
    melanin = s.melanin * (1.0 + 0.12 * s.variation * lock)[:, None]
    pigmented = np.exp(-ABSORPTION * melanin) * BLOND
    red = GINGER * np.exp(-GINGER_ABSORPTION * melanin)
    color = (1 - s.redness) * pigmented + s.redness * red
    off = (12.0 * s.grey * (1.0 - s.grey) / max(hairs / share, 1.0)) ** 0.5  # as wide as the binomial distribution
    grey = np.clip(s.grey + off * (chance[:, 0] - 0.5), 0.0, 1.0)[:, None]
    color = (color + grey * (WHITE - color)) * np.maximum(tone, 0.1)[:, None]
    dyed = srgb_to_linear(np.array([s.dye_red, s.dye_green, s.dye_blue])) * np.maximum(tone, 0.1)[:, None]
    color = color + s.dye * (dyed - color)
    tip = color * (1.0 + 1.2 * max(s.tips, 0.0)) * (1.0 + 0.7 * min(s.tips, 0.0)) + 0.05 * max(s.tips, 0.0)
    return np.clip(np.stack([color * ROOT_SHADE, tip], 1), 0.0, 0.95).astype(np.float32)


def locks_of(groom: Groom, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How strands differ by the locks that they are in, about -1..1, float32 [N]; the same of the same strands.

    Args:
        groom: The strands of one group, in the order in which they are recorded.
        vertices: The head model's mean, metres, [V, 3].
        faces: Its triangles, [F, 3].
    """
    roots, axes = groom.frames(vertices, faces).at(vertices)
    ends = np.einsum("ni,nij->nj", groom.points[groom.offsets[1:] - 1].astype(float), axes)
    tips, g = roots + ends + 0.4 * roots, np.random.default_rng(len(groom))
    seeds = tips[g.integers(len(tips), size=min(LOCKS, len(tips)))]
    near = nearest(seeds, tips, 1)[0][:, 0]
    return np.clip(g.normal(0, 0.5, len(seeds)), -1, 1)[near].astype(np.float32)
