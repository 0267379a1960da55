"""How finely a head's skin should be textured: the face finer than the back, eyes and lips finest.

One text for the open head's builder (`tools/open_head`) and for the user's FLAME (`flame_uv`). Needs numpy only.
"""

from __future__ import annotations

import numpy as np

BACK, FACE, BUST = 0.36, 1.0, 0.3  # densities; the face's is the unit
EAR = 0.62
EYE_REGION, LIP_REGION = 0.35, 0.3  # added


def smoothstep(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def face_density(centres: np.ndarray) -> np.ndarray:
    """Wanted density on the skin at points of the open head's template, metres, [n, 3]; [n]."""
    x, y, z = centres.T
    density = BACK + (FACE - BACK) * smoothstep(z, -0.02, 0.055) * smoothstep(y, -0.115, -0.06)
    ears = np.exp(-(((np.abs(x) - 0.073) / 0.02) ** 2 + (y / 0.035) ** 2 + (z / 0.03) ** 2))
    density = np.maximum(density, BACK + (EAR - BACK) * ears)
    for side in (-0.03, 0.03):
        density = density + EYE_REGION * np.exp(-((x - side) ** 2 + (y - 0.036) ** 2 + (z - 0.09) ** 2) / 0.02**2)
    density = density + LIP_REGION * np.exp(-((x / 0.03) ** 2 + ((y + 0.03) / 0.016) ** 2 + ((z - 0.1) / 0.03) ** 2))
    return density * (1 - (1 - BUST / BACK) * smoothstep(-y, 0.1, 0.15))
