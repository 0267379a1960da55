"""What an avatar wears in a picture, as callers of a session say it (see `api`). Needs numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ShapeError
from ..hair.settings import HairSettings

OWN_HAIR, NO_HAIR = "own", "none"
PUT_PREFIX, GROOM_PREFIX = "put:", "groom:"


@dataclass(frozen=True, eq=False)
class HairUse:
    """The hair that an avatar wears in a picture.

    Attributes:
        groom: "own": what the avatar has; "none": neither strands nor the hair that its Gaussians were trained with;
            "groom:NAME": one of the package's grooms (`hair.packaged`); or what `Session.put_groom` returned.
        settings: Length, color and so on; None: those that the avatar or the groom comes with.
        points: Where a host that moves strands by itself (Blender's evaluated curves) has the points of the groom, head space,
            metres, [P, 3]; None: the strands follow the head.
    """

    groom: str = OWN_HAIR
    settings: HairSettings | None = None
    points: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.points is not None:
            points = np.ascontiguousarray(self.points, np.float32)
            if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
                raise ShapeError(f"Moved hair points have the shape {points.shape} or are not finite; [P, 3] metres is needed.")
            object.__setattr__(self, "points", points)
