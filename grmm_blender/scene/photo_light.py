"""The light of the photo that an avatar was made from, as its file keeps it."""

from __future__ import annotations

import functools
from pathlib import Path

from ...grmm_core.avatar import load_avatar
from ...grmm_core.errors import GrmmError
from ...grmm_core.fitting.result import photo_light
from ...grmm_core.light.lamps import Lighting


def photo_lighting(source: str) -> Lighting | None:
    """Return the light of an avatar's first photo in head space; None for the studio's and where no photo's is known."""
    try:
        return _read(source, Path(source).stat().st_mtime_ns)
    except OSError:
        return None  # of the package, or gone: whoever draws it says so


@functools.lru_cache(maxsize=16)
def _read(path: str, changed: int) -> Lighting | None:
    """As the file is since a time in nanoseconds."""
    try:
        return photo_light(load_avatar(path)).lighting
    except GrmmError:
        return None  # not made from photos; what cannot be read is said where it is drawn
