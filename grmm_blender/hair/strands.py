"""Strands of a Curves object in one frame, as plain values that refer to none of Blender's data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grmm_core.hair import Groom


@dataclass(frozen=True, eq=False)
class StrandShot:
    """Strands in one frame; what has not changed is the same object, so that shots can be compared.

    Attributes:
        key: Of the Curves object.
        version: Changes with the groom.
        groom: At rest: where the strands stand, how they are lit, what is drawn of them far away.
        points: Where Blender has the groom's points, head space, metres, float32 [P, 3]; None: they follow the head.
        shaped: Whether these have the length and the curls of the panel's sliders.
    """

    key: str
    version: str
    groom: Groom
    points: np.ndarray | None = None
    shaped: bool = False
