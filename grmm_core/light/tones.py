"""What colors that the capture studio taught lack: whites of eyes, the shade of lids, dark mouths, the tone of lips.

All of it are factors of colors, for sessions, fits and files alike. Needs numpy only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .eye_shade import Eyes, eyes_of
from .lip_tone import lip_tone
from .mouth_shade import mouth_shade

if TYPE_CHECKING:
    from ..head import HeadModel
    from .resting import Texels


class Tones(NamedTuple):
    """Of a head's texels.

    Attributes:
        eyes: What lies in the shade of lids, or None.
        steady: What display colors are multiplied by in every pose, [N, 1 or 3], or None for nothing.
    """

    eyes: Eyes | None
    steady: np.ndarray | None

    @staticmethod
    def of(head: HeadModel, texels: Texels, eyes: bool = True, mouth: bool = True) -> Tones:
        """Those of a head, or of its eyes or its mouth alone."""
        steady = [tone for tone in (mouth_shade(head, texels), lip_tone(head, texels)) if mouth and tone is not None]
        return Tones(eyes_of(head, texels) if eyes else None, np.prod(np.broadcast_arrays(*steady), 0) if steady else None)

    def shade(self, vertices: np.ndarray) -> np.ndarray | None:
        """What display colors are multiplied by on posed vertices [V, 3], metres: [N, 1 or 3] float32; None for nothing."""
        if self.eyes is None or self.steady is None:
            return self.steady if self.eyes is None else self.eyes.shade(vertices)
        return self.eyes.shade(vertices) * self.steady
