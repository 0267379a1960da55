"""What of the light reaches eyes between their lids and the inside of a mouth, as factors of colors. Needs numpy only."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .eye_shade import Eyes, eyes_of
from .mouth_shade import mouth_shade

if TYPE_CHECKING:
    from ..head import HeadModel
    from .resting import Texels


class Hollows(NamedTuple):
    """Of a head's texels.

    Attributes:
        eyes: What lies in the shade of lids, or None.
        mouth: What the depth of the mouth leaves of display colors, [N, 1], or None.
    """

    eyes: Eyes | None
    mouth: np.ndarray | None

    @staticmethod
    def of(head: HeadModel, texels: Texels, eyes: bool = True, mouth: bool = True) -> Hollows:
        """Those of a head, or of its eyes or its mouth alone."""
        return Hollows(eyes_of(head, texels) if eyes else None, mouth_shade(head, texels) if mouth else None)

    def shade(self, vertices: np.ndarray) -> np.ndarray | None:
        """What display colors are multiplied by on posed vertices [V, 3], metres: [N, 3] or [N, 1] float32; None for nothing."""
        if self.eyes is None or self.mouth is None:
            return self.mouth if self.eyes is None else self.eyes.shade(vertices)
        return self.eyes.shade(vertices) * self.mouth
