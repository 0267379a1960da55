"""Colors of strands from a few pigments, for a person's settings. Needs numpy only."""

from __future__ import annotations

import numpy as np

from ..pictures.color import srgb_to_linear
from .settings import HairSettings

# linear RGB: what eumelanin leaves of light hair, what red pigment leaves, and hair without pigment
ABSORPTION, BLOND = np.array([3.4, 4.1, 5.0]), np.array([0.62, 0.44, 0.235])
GINGER, GINGER_ABSORPTION = np.array([0.34, 0.10, 0.025]), 1.6
WHITE = np.array([0.46, 0.455, 0.45])
ROOT_SHADE = 0.78  # of the color at the tip
GREY_EDGE = 0.12  # share of the hairs that are on the way to grey


def albedos(settings: HairSettings, lock: np.ndarray, chance: np.ndarray) -> np.ndarray:
    """Return linear RGB at root and tip of each strand.

    Args:
        settings: Pigments.
        lock: Tone of the strand's lock, about -1..1, [N].
        chance: Even random numbers for grey and for tone, 0..1, [N, 2].

    Returns:
        [N, 2, 3] float32.
    """
    s = settings
    tone = 1.0 + s.variation * (0.55 * lock + 0.55 * (chance[:, 1] - 0.5))
    melanin = s.melanin * (1.0 + 0.12 * s.variation * lock)[:, None]
    pigmented = np.exp(-ABSORPTION * melanin) * BLOND
    red = GINGER * np.exp(-GINGER_ABSORPTION * melanin)
    color = (1 - s.redness) * pigmented + s.redness * red
    grey = np.clip((s.grey * (1 + GREY_EDGE) - chance[:, 0]) / GREY_EDGE, 0.0, 1.0)[:, None]
    color = (color + grey * (WHITE - color)) * np.maximum(tone, 0.1)[:, None]
    dyed = srgb_to_linear(np.array([s.dye_red, s.dye_green, s.dye_blue])) * np.maximum(tone, 0.1)[:, None]
    color = color + s.dye * (dyed - color)
    tip = color * (1.0 + 1.2 * max(s.tips, 0.0)) * (1.0 + 0.7 * min(s.tips, 0.0)) + 0.05 * max(s.tips, 0.0)
    return np.clip(np.stack([color * ROOT_SHADE, tip], 1), 0.0, 0.95).astype(np.float32)
