"""Hair that swings while an avatar plays: `hair.swing` fed with what a session says of the head."""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Iterator, Sequence

import numpy as np

from ..avatar.file import load_avatar
from ..avatar.library import DEFAULT_NAME, LIBRARY_PREFIX, library_path
from ..controls.frame import Controls
from ..errors import RuntimeMissingError, ShapeError
from ..hair.groom import Groom
from ..hair.packaged import library_groom
from ..hair.prior import random_groom
from ..hair.swing import Swing
from ..head import load_open_head
from .api import Session
from .sources import DEFAULT_SOURCE
from .values import AvatarInfo
from .wearing import GROOM_PREFIX, OWN_HAIR, RANDOM_PREFIX, HairUse


def swinging(
    session: Session, avatar: AvatarInfo, use: HairUse, frames: Sequence[Controls], fps: float,
    places: Sequence[np.ndarray | None] | None = None,
) -> Iterator[HairUse]:  # fmt: skip
    """Simulate a performance from its first frame on.

    Args:
        session: Where the avatar is open.
        avatar: Who.
        use: What it wears.
        frames: All of the performance.
        fps: Frames a second.
        places: Where the head is in each frame, see `Swing.step`; None: where it always is.

    Yields:
        What to wear in each frame.

    Raises:
        RuntimeMissingError: Numba is not installed here; a worker may have it, but the simulation runs with its caller.
        ShapeError: Hair that stands on another head than the open one.
    """
    if importlib.util.find_spec("numba") is None:
        raise RuntimeMissingError("Hair is simulated with numba, which is not in this Python; install the zip that brings it.")
    groom = worn_groom(avatar, use)
    if groom is None or not frames:
        yield from [use] * len(frames)
        return
    head = load_open_head()
    if head.name != avatar.head_name:
        raise ShapeError(f"Hair swings on the head {head.name}, not {avatar.head_name}; leave the swing out.")
    swing = Swing(head, groom, session.deform(avatar.id, frames[0].at_rest()).vertices, fps)
    for controls, place in zip(frames, places or [None] * len(frames), strict=True):
        yield dataclasses.replace(use, swing=swing.step(session.deform(avatar.id, controls).vertices, place))


def worn_groom(avatar: AvatarInfo, use: HairUse) -> Groom | None:
    """The groom that an avatar wears; None where it has none, or it was put into a session, whose caller has it."""
    found = named_groom(use, avatar.head_name)
    if found is not None:
        return found
    if use.groom != OWN_HAIR or avatar.hair is None:
        return None
    source = avatar.source
    if source == DEFAULT_SOURCE or source.startswith(LIBRARY_PREFIX):
        source = str(library_path(DEFAULT_NAME if source == DEFAULT_SOURCE else source.removeprefix(LIBRARY_PREFIX)))
    hair = load_avatar(source).hair
    return None if hair is None else hair.groom


def named_groom(use: HairUse, head_name: str) -> Groom | None:
    """The groom on the scalp where its name says which, whoever wears it; else None."""
    if use.groom.startswith(GROOM_PREFIX):
        return library_groom(use.groom.removeprefix(GROOM_PREFIX), head_name)
    if use.groom.startswith(RANDOM_PREFIX):
        return random_groom(use.groom.removeprefix(RANDOM_PREFIX), head_name)
    return None
