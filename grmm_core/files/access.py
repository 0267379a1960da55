"""Safe file access: whole-or-nothing writes and one-sentence errors.

Used by every writer of the project. A file appears under its final name only when it is complete, so that a full disk, a
crash or a cancel never leaves half a file behind.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from ..errors import FileAccessError, FileFormatError

_CHUNK = 1 << 20
_PREFIX, _SUFFIX = ".grmm-", ".tmp"
TEMPORARY_PATTERN = f"{_PREFIX}*{_SUFFIX}"
"""Names of files that are being written; a killed process leaves one behind."""


def describe_os_error(error: OSError) -> str:
    """Return the system's reason in lower case, without path and number ("no space left on device")."""
    return (error.strerror or str(error) or type(error).__name__).lower()


def bad_file(path: str | os.PathLike[str], kind: str, reason: str) -> FileFormatError:
    """One sentence that names the file, what it was taken for, and why it cannot be read."""
    return FileFormatError(f"{path} is not a readable {kind} ({reason}); export it again or choose another file.")


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; rename it to `path` when the block ends without an error.

    Args:
        path: Final file name. Its folder must exist.

    Yields:
        A binary file open for writing.

    Raises:
        FileAccessError: The folder is missing or not writable, or the disk is full. `path` is then unchanged.
    """
    path = Path(path)
    try:
        descriptor, temporary = tempfile.mkstemp(prefix=_PREFIX, suffix=_SUFFIX, dir=path.parent)
    except OSError as error:
        raise FileAccessError(
            f"Cannot write {path}: {describe_os_error(error)}; choose another folder or change its permissions."
        ) from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o666 & ~_umask())
        Path(temporary).replace(path)
    except OSError as error:
        raise FileAccessError(
            f"Cannot write {path}: {describe_os_error(error)}; free some space or choose another folder."
        ) from error
    finally:
        # After a successful rename there is nothing left under the temporary name.
        Path(temporary).unlink(missing_ok=True)


def atomic_write_bytes(path: str | os.PathLike[str], data: bytes | memoryview) -> None:
    """Write `data` to `path` as a whole or not at all. Raises `FileAccessError`."""
    with atomic_write(path) as file:
        file.write(data)


@contextmanager
def open_file(path: str | os.PathLike[str]) -> Iterator[BufferedReader]:
    """Open a file for reading, and turn the system's errors into sentences.

    Devices and named pipes are refused: their size says nothing, they may never end, and opening one may wait for ever.

    Raises:
        FileAccessError: Missing, a folder, a device, or not readable; also for errors while the block reads.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise FileAccessError(f"{path} is a folder; choose a file.")
        with open(path, "rb", opener=_open_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise FileAccessError(f"{path} is a device or a pipe; save what it gives as a file and choose that.")
            yield file
    except FileNotFoundError as error:
        raise FileAccessError(f"{path} does not exist; check the file name.") from error
    except OSError as error:
        raise FileAccessError(f"Cannot read {path}: {describe_os_error(error)}; check the file and its permissions.") from error
    except ValueError as error:
        if "\0" not in str(path):
            raise
        raise FileAccessError("The file name contains a null character; choose another name.") from error


def _open_without_waiting(path: str, flags: int) -> int:
    """Opener that does not wait for somebody to write into a pipe. Regular files read as ever."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_bytes(path: str | os.PathLike[str], limit: int | None = None) -> bytes:
    """Read a whole file.

    Args:
        path: File to read.
        limit: Largest size in bytes that is accepted, whatever the file system says about the size.

    Raises:
        FileAccessError: Missing, a folder, a device, not readable, or larger than `limit`.
    """
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if limit is None:
            return file.read()
        parts, total = [], size  # a size of zero may be a file that the system makes up while it is read
        while total <= limit:
            parts.append(file.read(max(size + 1, _CHUNK)))
            total = sum(map(len, parts))
            if not parts[-1] or total == size:
                return b"".join(parts) if len(parts) > 1 else parts[0]
        raise FileAccessError(f"{path} has more than the {limit} bytes that are read; choose a smaller file.")


def read_start(path: str | os.PathLike[str], count: int = 4096) -> bytes:
    """Read the first bytes of a file. Raises as `open_file`."""
    with open_file(path) as file:
        return file.read(count)


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder, and those above it, where there is none. Raises `FileAccessError`."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileAccessError(f"Cannot make the folder {path}: {describe_os_error(error)}; choose another folder.") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
