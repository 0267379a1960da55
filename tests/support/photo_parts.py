"""What pictures that tests draw show, as the photo parser would say it."""

from __future__ import annotations

import numpy as np

from grmm_core.photo.parser import LABELS, PhotoParts


def parts_of(background: np.ndarray, **parts: np.ndarray) -> PhotoParts:
    """What a picture that a test draws shows, by name of the label, each [H, W]; the rest is skin."""
    rest = 1.0 - sum(parts.values(), background)
    planes = {"background": background, "skin": rest, **parts}
    return PhotoParts(*(np.asarray(planes.get(name, 0.0 * rest), np.float32) for name in LABELS))
