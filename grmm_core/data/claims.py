"""Sharing a capture between processes of one machine: claims on pieces of work by locked files.

A claim is the operating system's exclusive lock on a file. The system ends it with the process, however that dies, so no claim
is ever stale and none must be taken over: a file that is left behind is merely one that nobody has locked. Several machines
share their work through `jobs.cluster`. Needs the standard library only.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileAccessError
from ..files.access import describe_os_error


@contextmanager
def claim(path: Path) -> Iterator[bool]:
    """Claim a piece of work; yields whether it is ours. The claim ends with the block.

    Raises:
        FileAccessError: The folder is not writable or its file system has no locks.
    """
    descriptor = _take(path)
    try:
        yield descriptor is not None
    finally:
        if descriptor is not None:
            _release(path, descriptor)


def _take(path: Path) -> int | None:
    """The open and locked file, or None where another process has locked it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            descriptor = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
            try:
                ours = _lock(descriptor)
                current = _is_at(path, descriptor)
            except OSError:
                os.close(descriptor)
                raise
            if ours and current:
                return descriptor
            os.close(descriptor)
            if current:
                return None
            # an owner removed the file after we had opened it: what counts is its successor
    except OSError as error:
        raise FileAccessError(f"Cannot lock {path}: {describe_os_error(error)}; choose another folder.") from error


def _release(path: Path, descriptor: int) -> None:
    try:
        if sys.platform != "win32":  # Windows cannot remove an open file; there the empty file stays
            path.unlink(missing_ok=True)  # while it is still locked: nobody else can own this name
    except OSError:
        pass  # the folder has become read-only; a file that is left does no harm
    finally:
        os.close(descriptor)


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True

else:
    import fcntl

    def _lock(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
