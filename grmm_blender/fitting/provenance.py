"""Where an avatar comes from, in a sentence for the panel: photos, their date. Knows no bpy."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from ...grmm_core.avatar import EXTENSION, read_avatar_header
from ...grmm_core.errors import GrmmError

_NAMED = 3  # photos that are named; of more the number is said
_KEPT = 16


def provenance_sentence(source: str) -> str:
    """Say that an avatar's file was made from photos; "" of other avatars and of files that cannot be read.

    Panels draw often: a file is read again only when it has changed.
    """
    if not source.endswith(EXTENSION):
        return ""
    try:
        state = Path(source).stat()
    except (OSError, ValueError):
        return ""
    return _sentence(source, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=_KEPT)
def _sentence(source: str, _changed: int, _size: int) -> str:
    try:
        made = read_avatar_header(Path(source)).provenance
    except GrmmError:
        return ""  # the avatar panel says what is wrong with it
    if not made.from_photos:
        return ""
    names = [photo.name for photo in made.photos]
    which = ", ".join(names) if 0 < len(names) <= _NAMED else f"{len(names)} photos"
    date = f" on {made.date}" if made.date else ""
    return f"Made from {which}{date}. It shows a real person: use it only with that person's agreement."
