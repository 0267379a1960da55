"""What identifies an opened avatar, so that opening the same file twice gives one avatar. Used by both sessions."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from ..avatar.library import LIBRARY_PREFIX, library_path
from ..files.access import open_file

DEFAULT_SOURCE = "default"
SAMPLE_PREFIX = "sample:"
_SAMPLE = re.compile(SAMPLE_PREFIX + r"(-?[0-9]{1,18})")


@dataclass(frozen=True)
class SourceKey:
    """Identity of an avatar's source.

    Attributes:
        kind: "default", "sample", "library" or "file".
        name: "default", the seed, the name in the library, or the absolute path.
        stamp: Modification time in nanoseconds and size of the file, so that a rewritten file counts as another avatar.
    """

    kind: str
    name: str
    stamp: tuple[int, int] = (0, 0)

    @property
    def label(self) -> str:
        """What `AvatarInfo.source` shows."""
        return f"{self.kind}:{self.name}" if self.kind in ("sample", "library") else self.name


def source_key(source: str | os.PathLike[str]) -> SourceKey:
    """Return the identity of what `Session.open` was given. Raises `FileAccessError` for a missing file."""
    if source == DEFAULT_SOURCE:
        return SourceKey("default", DEFAULT_SOURCE)
    sample = _SAMPLE.fullmatch(source) if isinstance(source, str) else None
    if sample is not None:
        return SourceKey("sample", str(int(sample[1])))
    if isinstance(source, str) and source.startswith(LIBRARY_PREFIX):
        name = source.removeprefix(LIBRARY_PREFIX)
        library_path(name)
        return SourceKey("library", name)
    path = Path(source).absolute()
    with open_file(path) as file:
        status = os.fstat(file.fileno())
    return SourceKey("file", str(path), (status.st_mtime_ns, status.st_size))
