"""Sharing a capture between processes: claims on pieces of work by lock files, and an estimate of the time left.

A claim is a file made with O_EXCL that holds host and process; it is stale when that process is gone or, from another host,
when it is old. Needs the standard library only.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileAccessError
from ..files import describe_os_error

STALE_SECONDS = 3600.0  # of a claim from another host


@contextmanager
def claim(path: Path) -> Iterator[bool]:
    """Claim a piece of work; yields whether it is ours. The claim ends with the block.

    Raises:
        FileAccessError: The folder is not writable.
    """
    mine = _take(path) or (_is_stale(path) and _steal(path))
    try:
        yield mine
    finally:
        if mine:
            path.unlink(missing_ok=True)


def _take(path: Path) -> bool:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
    except FileExistsError:
        return False
    except OSError as error:
        raise FileAccessError(f"Cannot write {path}: {describe_os_error(error)}; choose another folder.") from error
    with os.fdopen(descriptor, "w") as file:
        json.dump({"host": socket.gethostname(), "process": os.getpid()}, file)
    return True


def _is_stale(path: Path) -> bool:
    try:
        age = time.time() - path.stat().st_mtime
        owner = json.loads(path.read_text() or "{}")
    except FileNotFoundError:
        return False  # just finished elsewhere
    except (OSError, ValueError):
        return False
    if owner.get("host") != socket.gethostname():
        return age > STALE_SECONDS if owner else age > 60.0
    try:
        os.kill(int(owner["process"]), 0)
    except ProcessLookupError:
        return True
    except (OSError, KeyError, ValueError):
        return False
    return int(owner["process"]) == os.getpid()  # a claim that an earlier run of this very process number left


def _steal(path: Path) -> bool:
    """Replace a stale claim; of several processes that try, one wins because the rename of the old file succeeds once."""
    grave = path.with_suffix(f".stale{os.getpid()}")
    try:
        path.rename(grave)
    except OSError:
        return False
    grave.unlink(missing_ok=True)
    return _take(path)


class TimeLeft:
    """Estimate of the time left from the pace of this process."""

    def __init__(self, total: int) -> None:
        self.total, self.done, self._worked, self._start = total, 0, 0, time.monotonic()

    def step(self, worked: bool) -> None:
        """One more piece is done, by us (`worked`) or before."""
        self.done += 1
        self._worked += worked

    @property
    def seconds(self) -> float:
        """Seconds left at the present pace; infinite before the first piece."""
        if not self._worked:
            return float("inf")
        return (time.monotonic() - self._start) / self._worked * (self.total - self.done)
