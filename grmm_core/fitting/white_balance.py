"""What of the first photo's white balance is the light's: skin is never green, nor magenta.

Skins of all people, and skins in warmer and cooler light, lie along one line of colors, from pale to dark red-brown; light of
fluorescent tubes and of colored lamps lies beside it. How warm a light is, nothing of a face tells; how far it is beside that
line the skin does. As much is taken out of the avatar's colors and put into its photos' lights. Used by `person_lights`. Needs
numpy only.
"""

from __future__ import annotations

import numpy as np

SKIN_GREEN = -0.137  # logarithm of linear green over the geometric mean of red and blue: skins of the package, by 0.02
FREE, MOST = 0.1, 0.3  # of that: photos in plain light deviate by the first; beyond the second it is no skin's color
GREY = 0.2  # logarithm of red over blue: skins have 0.3 and more, and what has none is a photo without colors
_LUMINANCE = 0.7152  # of green: the avatar is as light as it was


def cast(tone: np.ndarray) -> np.ndarray:
    """Factor of a light whose skin looks like that, linear RGB [3], beside the same light without a cast, [3]."""
    red, green, blue = np.log(np.maximum(np.asarray(tone, np.float64), 1e-4))
    off = green - 0.5 * (red + blue) - SKIN_GREEN
    excess = np.sign(off) * np.clip(abs(off) - FREE, 0.0, MOST) * np.clip((red - blue) / GREY, 0.0, 1.0)
    factor: np.ndarray = np.exp(excess * (np.array([0.0, 1.0, 0.0]) - _LUMINANCE)).astype(np.float32)
    return factor
