"""What networks say of where a face's landmarks are. Needs numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LANDMARK_COUNT = 478
EYE_CORNERS = (33, 263)  # outer corners: subject's right, left


@dataclass(frozen=True)
class HeadLandmarks:
    """The head model's landmarks in a picture.

    Attributes:
        points: Pixels, [478, 2].
        sigma: Expected error of each, pixels, [478].
    """

    points: np.ndarray
    sigma: np.ndarray
