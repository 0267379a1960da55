"""The grooms that come with the package, for the open head; `python -m tools.grooms` rebuilds them. Needs numpy only."""

from __future__ import annotations

import functools
import re
from pathlib import Path

from ..errors import FileAccessError, FileFormatError, ShapeError
from ..files.npz import read_npz
from .compact import restored
from .groom import Groom

GROOM_FOLDER = Path(__file__).resolve().parent.parent / "assets" / "grooms"
GROOM_SUFFIX = ".npz"
HEAD = "open_head"
_NAME = re.compile(r"[a-z0-9_]{1,40}")


def groom_names() -> tuple[str, ...]:
    """Names of the grooms, in order."""
    return tuple(sorted(path.stem for path in GROOM_FOLDER.glob(f"*{GROOM_SUFFIX}")))


@functools.lru_cache(maxsize=8)
def library_groom(name: str, head: str = HEAD) -> Groom:
    """Return a groom by name.

    Args:
        name: One of `groom_names`.
        head: Name of the head model that is to wear it.

    Raises:
        FileAccessError: There is none of the name.
        ShapeError: The grooms are of another head.
        FileFormatError: The file is damaged.
    """
    path = GROOM_FOLDER / f"{name}{GROOM_SUFFIX}"
    if not _NAME.fullmatch(name) or not path.is_file():
        raise FileAccessError(f"There is no groom {name[:40]!r}; there are {', '.join(groom_names()) or 'none'}.")
    if head != HEAD:
        raise ShapeError(f"The groom {name} is for the head {HEAD}, not {head}; wear it on an avatar of that head.")
    try:
        return restored(read_npz(path)[0])
    except ShapeError as error:
        raise FileFormatError(f"{path} is damaged; install the package again.") from error
