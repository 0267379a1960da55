"""The grooms that come with the package, for the open head; `python -m tools.grooms` rebuilds them. Needs numpy only."""

from __future__ import annotations

import functools
import re
from pathlib import Path

from ..errors import FileAccessError, FileFormatError, ShapeError
from ..files.npz import read_npz
from .compact import restored
from .groom import Groom
from .roots import GROUPS, SCALP

GROOM_FOLDER = Path(__file__).resolve().parent.parent / "assets" / "grooms"
GROOM_SUFFIX, PICTURE_SUFFIX = ".npz", ".jpg"
HEAD = "open_head"
_NAME = re.compile(r"[a-z0-9_]{1,40}")


def groom_folder(part: str = GROUPS[SCALP]) -> Path:
    """Where the grooms of a part of the hair are, one of `roots.GROUPS`."""
    return GROOM_FOLDER if part == GROUPS[SCALP] else GROOM_FOLDER / part


def groom_names(part: str = GROUPS[SCALP]) -> tuple[str, ...]:
    """Names of the grooms of a part, one of `roots.GROUPS`, in order."""
    return tuple(sorted(path.stem for path in groom_folder(part).glob(f"*{GROOM_SUFFIX}")))


@functools.lru_cache(maxsize=16)
def library_groom(name: str, head: str = HEAD, part: str = GROUPS[SCALP]) -> Groom:
    """Return a groom by name.

    Args:
        name: One of `groom_names(part)`.
        head: Name of the head model that is to wear it.
        part: One of `roots.GROUPS`.

    Raises:
        FileAccessError: There is none of the name.
        ShapeError: The grooms are of another head.
        FileFormatError: The file is damaged.
    """
    path = groom_folder(part) / f"{name}{GROOM_SUFFIX}"
    if not _NAME.fullmatch(name) or not path.is_file():
        kind = "groom" if part == GROUPS[SCALP] else f"groom of {part}"
        raise FileAccessError(f"There is no {kind} {name[:40]!r}; there are {', '.join(groom_names(part)) or 'none'}.")
    if head != HEAD:
        raise ShapeError(f"The groom {name} is for the head {HEAD}, not {head}; wear it on an avatar of that head.")
    try:
        return restored(read_npz(path)[0])
    except ShapeError as error:
        raise FileFormatError(f"{path} is damaged; install the package again.") from error
