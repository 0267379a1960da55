"""What an avatar wears in a picture, as callers of a session say it (see `api`). Needs numpy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import ShapeError
from ..hair.roots import GROUPS, SCALP
from ..hair.settings import HairSettings

OWN_HAIR, NO_HAIR = "own", "none"
PUT_PREFIX, GROOM_PREFIX, RANDOM_PREFIX = "put:", "groom:", "random:"
PARTS = tuple(name for group, name in enumerate(GROUPS) if group != SCALP)  # brows, beard, lashes
USUAL = {"brows": "natural", "lashes": "natural"}  # of heads whose Gaussians have no hair, where nothing else is said


@dataclass(frozen=True, eq=False)
class HairUse:
    """The hair that an avatar wears in a picture.

    Brows, beard and lashes are chosen beside the hairstyle. "own" is what the avatar's file has of a part; where it has
    nothing, what its Gaussians were trained with, or, on weights trained on people without hair, what is `USUAL`.

    Attributes:
        groom: "own": what the avatar has; "none": neither strands nor the hair that its Gaussians were trained with;
            "groom:NAME": one of the package's grooms (`hair.packaged`); "random:SEED": one that `hair.prior` draws; or what
            `Session.put_groom` returned.
        settings: Length, color and so on; None: those that the avatar or the groom comes with.
        points: Where a host that moves strands by itself (Blender's evaluated curves) has the points of the groom, head space,
            metres, [P, 3]; None: the strands follow the head.
        brows, beard, lashes: "own", "none", or the name of one of the package's grooms of the part.
        parts: Settings of brows, beard and lashes, by these names; where there are none, those of the avatar, or the colors
            of `settings`.
        swing: How far the strands of the groom have swung from where they follow the head, head space, metres, [N, S, 3] at S
            even places from the root on: `hair.swing` computes it. None: not at all.
        of_own: The groom was made of the avatar's own hair, as curves that a host edits are: what a photo shows of skin under
            that stays where strands still stand.
    """

    groom: str = OWN_HAIR
    settings: HairSettings | None = None
    points: np.ndarray | None = None
    brows: str = OWN_HAIR
    beard: str = OWN_HAIR
    lashes: str = OWN_HAIR
    parts: Mapping[str, HairSettings] = field(default_factory=dict)
    swing: np.ndarray | None = None
    of_own: bool = False

    def __post_init__(self) -> None:
        unknown = sorted(set(self.parts) - set(PARTS))
        if unknown:
            raise ShapeError(f"Hair has no part {unknown[0]!r} with settings of its own; it has {', '.join(PARTS)}.")
        if self.points is not None:
            points = np.ascontiguousarray(self.points, np.float32)
            if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
                raise ShapeError(f"Moved hair points have the shape {points.shape} or are not finite; [P, 3] metres is needed.")
            object.__setattr__(self, "points", points)
        if self.swing is not None:
            swing = np.ascontiguousarray(self.swing, np.float32)
            if swing.ndim != 3 or swing.shape[1] < 2 or swing.shape[2] != 3 or not np.isfinite(swing).all():
                raise ShapeError(f"Swinging hair has the shape {swing.shape} or is not finite; [N, S, 3] metres is needed.")
            object.__setattr__(self, "swing", swing)
