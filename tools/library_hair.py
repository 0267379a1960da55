"""The hair of the library's avatars: of the capture's people, grown as the package's grooms are (`grooms`, `groom_finish`).

What a capture records of a person is what its pictures show: partings as wide as a finger, crowns that stand over them, long
beards whose strands stand apart, brows that stand too high. Called by `library`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grmm_core.avatar import Avatar
from grmm_core.hair.groom import Groom, join
from grmm_core.hair.roots import BEARD, BROWS, SCALP
from grmm_core.head.open_head import load_open_head, load_people_model
from grmm_studio.mesh import RenderMesh
from grmm_studio.styles import BALD
from grmm_studio.subjects import Subject, draw_subject

from .grooms import BEARD_STRANDS, average_person, change_styles, grown

# what is a person's own of the hair of somebody with the mean head
_OWN = (
    "hair_style", "hair_length", "hair_curl", "hair_volume", "hairline", "part", "stubble", "beard", "beard_cut", "macros",
    "brow_thickness", "brow_height", "brow_arch", "brow_density", "asymmetry",
)  # fmt: skip


class Dresser:
    """Grows hair for people of the capture. `dressed` is the whole of it."""

    def __init__(self) -> None:
        change_styles()
        self._head, self._people = load_open_head(), load_people_model()
        self._mesh = RenderMesh.build(self._head)
        self._someone, self._neutral = average_person(self._head)

    def dressed(self, avatar: Avatar, seed: int, number: int) -> Avatar:
        """Return the avatar of a person of a capture with scalp hair, brows and beard grown anew, in the pigments that it has.

        Lashes stay, and so does stubble, which is sparse as it is.

        Args:
            avatar: With hair.
            seed: Of the capture.
            number: Of the person in it.
        """
        assert avatar.hair is not None
        assert avatar.hair.groom is not None
        person = draw_subject(seed, number, self._people)
        subject = replace(self._someone, **{name: getattr(person, name) for name in _OWN})
        anew = [SCALP] * (person.hair_style != BALD) + [BROWS] + [BEARD] * (person.beard > 0.0)
        kept = avatar.hair.groom.select(np.flatnonzero(~np.isin(avatar.hair.groom.groups, anew)))
        grooms = [self._grown(group, subject) for group in anew]
        return replace(avatar, hair=replace(avatar.hair, groom=join([*grooms, kept])))

    def _grown(self, group: int, subject: Subject) -> Groom:
        groom = grown(self._head, self._mesh, self._neutral, group, subject)
        return groom.level(min(1.0, BEARD_STRANDS / len(groom))) if group == BEARD else groom
