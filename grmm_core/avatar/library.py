"""The avatars that come with the package: people of the capture studio, trained one by one on top of the embedded weights.

`default` among them is what the source "default" opens with the embedded weights. Called by sessions and by Blender, which
offers them by name. Needs numpy only.
"""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import FileAccessError
from .file import EXTENSION

LIBRARY_FOLDER = Path(__file__).resolve().parent.parent / "assets" / "avatars"
LIBRARY_PREFIX = "library:"
DEFAULT_NAME = "default"
_NAME = re.compile(r"[a-z0-9_]{1,40}")


def library_names() -> tuple[str, ...]:
    """Names of the avatars, the default one first."""
    names = sorted(path.stem for path in LIBRARY_FOLDER.glob(f"*{EXTENSION}"))
    return tuple(sorted(names, key=lambda name: name != DEFAULT_NAME))


def library_file(source: str) -> Path | None:
    """Return the file behind "library:NAME", or None for a source of another kind. Raises as `library_path`."""
    return library_path(source.removeprefix(LIBRARY_PREFIX)) if source.startswith(LIBRARY_PREFIX) else None


def library_path(name: str) -> Path:
    """Return an avatar's file. Raises `FileAccessError` where there is none of the name."""
    path = LIBRARY_FOLDER / f"{name}{EXTENSION}"
    if not _NAME.fullmatch(name) or not path.is_file():
        known = ", ".join(library_names()) or "none"
        raise FileAccessError(f"There is no avatar {name[:40]!r} in the library; there are {known}.")
    return path
