"""Safe file access: whole-or-nothing writes and one-sentence errors.

Used by every writer of the project. A file appears under its final name only when it is complete, so that a full disk, a
crash or a cancel never leaves half a file behind.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..errors import FileAccessError

_PREFIX, _SUFFIX = ".grmm-", ".tmp"
TEMPORARY_PATTERN = f"{_PREFIX}*{_SUFFIX}"
"""Names of files that are being written; a killed process leaves one behind."""


def describe_os_error(error: OSError) -> str:
    """Return the system's reason in lower case, without path and number ("no space left on device")."""
    return (error.strerror or str(error) or type(error).__name__).lower()


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


def read_bytes(path: str | os.PathLike[str], limit: int | None = None) -> bytes:
    """Read a whole file.

    Args:
        path: File to read.
        limit: Largest size in bytes that is accepted.

    Raises:
        FileAccessError: Missing, a folder, not readable, or larger than `limit`.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise FileAccessError(f"{path} is a folder; choose a file.")
        size = path.stat().st_size
        if limit is not None and size > limit:
            raise FileAccessError(f"{path} has {size} bytes, more than the {limit} that are read; choose a smaller file.")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise FileAccessError(f"{path} does not exist; check the file name.") from error
    except OSError as error:
        raise FileAccessError(f"Cannot read {path}: {describe_os_error(error)}; check the file and its permissions.") from error
    except ValueError as error:  # a null character in the name
        raise FileAccessError("The file name contains a null character; choose another name.") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
