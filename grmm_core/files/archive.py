"""Members of zip archives that nobody vouches for.

Called by `npz` and by the readers of zipped formats. Nothing is unpacked to disk, so names such as ``../x`` reach no file;
members are looked up by their last name part, and read up to a limit whatever the archive claims. Needs the standard library
only.
"""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileFormatError
from .access import bad_file, open_file, read_bytes

_MAX_MEMBERS = 1000
# RuntimeError: encrypted members; NotImplementedError: unknown compression; ValueError: null characters and bad offsets;
# MemoryError: an LZMA member that asks for gigabytes of dictionary
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError,
    MemoryError,
)  # fmt: skip


@contextmanager
def open_archive(path: Path, kind: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive; whatever damage shows while the block reads from it becomes one sentence.

    Args:
        path: The archive.
        kind: What the file was taken for, for messages.

    Raises:
        FileFormatError: Not an archive, damaged or encrypted.
        FileAccessError: Missing or unreadable.
    """
    with open_file(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                yield archive
        except _DAMAGE as error:
            raise bad_file(path, kind, "the archive is damaged") from error
        except OSError as error:
            if error.errno is not None:
                raise
            raise bad_file(path, kind, "the archive is damaged") from error  # how bzip2 says it


def read_members(path: Path, kind: str, limit: int) -> dict[str, bytes]:
    """Read all files of an archive.

    Args:
        path: A zip archive.
        kind: What the file was taken for, for messages.
        limit: Largest size of all members together, unpacked.

    Returns:
        Contents by base name; of members with the same base name the shortest path counts.

    Raises:
        FileFormatError: Not an archive, damaged, encrypted, or larger than `limit`.
        FileAccessError: Missing or unreadable.
    """
    with open_archive(path, kind) as archive:
        infos = [info for info in archive.infolist() if not info.is_dir()]
        if len(infos) > _MAX_MEMBERS:
            raise bad_file(path, kind, f"it has {len(infos)} members")
        chosen: dict[str, zipfile.ZipInfo] = {}
        for info in sorted(infos, key=lambda info: -len(info.filename)):
            chosen[info.filename.replace("\\", "/").rsplit("/", 1)[-1]] = info
        if sum(info.file_size for info in chosen.values()) > limit:
            raise bad_file(path, kind, f"unpacked it would take more than {limit} bytes")
        contents = {}
        for name, info in chosen.items():
            with archive.open(info) as file:
                contents[name] = file.read(info.file_size)
            if len(contents[name]) != info.file_size:
                raise bad_file(path, kind, f"its member {name[:60]!r} is truncated")
        return contents


def member(path: Path, kind: str, contents: dict[str, bytes], name: str) -> bytes:
    """One member by name. Raises `FileFormatError` if it is missing."""
    if name not in contents:
        raise bad_file(path, kind, f"it has no {name[:60]!r}")
    return contents[name]


def read_neighbour(path: Path, kind: str, name: str, limit: int) -> bytes:
    """A file in the folder of `path`, named by a data file.

    Raises:
        FileFormatError: The name leaves the folder.
        FileAccessError: Missing or unreadable.
    """
    if not name or name in (".", "..") or any(c in name for c in "/\\:\0"):
        raise FileFormatError(
            f"{path} names the file {name[:60]!r} outside its folder; get the file again from a source you trust."
        )
    return read_bytes(path.parent / name, limit)
