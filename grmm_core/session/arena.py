"""Memory shared by a session and its worker, for arrays too large for a pipe.

One growing block without a name in any folder, so that nothing is left behind however the two processes end: on Linux an
anonymous memory file, elsewhere on POSIX a temporary file that is unlinked at once, both inherited by the child as an open
descriptor; on Windows a tagged mapping that the system frees with its last user. `multiprocessing.shared_memory` was not used:
its names outlive a crash, and before Python 3.13 a child that only attaches starts a tracker process that frees the block under
its owner. The protocol lets one side speak at a time, so the arena needs no lock.

Used by `client` and `worker` through `codec`. Needs the standard library and numpy.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import secrets
import sys
import tempfile
from typing import Any

import numpy as np

from ..errors import SessionError
from ..files.access import describe_os_error

INITIAL_BYTES = 1 << 20
MAX_BYTES = 1 << 34  # 16 GiB; a picture of the largest size with every pass stays below
_ALIGNMENT = 64
_WINDOWS = sys.platform == "win32"


class SharedArena:
    """A block of shared memory that either side can make larger."""

    def __init__(self) -> None:
        """Create an empty arena (the parent's side). Raises `SessionError` when the system has no memory for it."""
        self._size = 0
        self._descriptor = -1
        self._tag = ""
        self._map: mmap.mmap | None = None
        try:
            if not _WINDOWS:
                self._descriptor = _anonymous_file()
        except OSError as error:
            raise _out_of_memory(INITIAL_BYTES, error) from error
        self.reserve(INITIAL_BYTES)

    @classmethod
    def attach(cls, spec: dict[str, Any]) -> SharedArena:
        """Open the arena that the parent described with `spec` (the child's side)."""
        arena = cls.__new__(cls)
        arena._size = 0
        arena._descriptor = int(spec["descriptor"])
        arena._tag = ""
        arena._map = None
        arena.follow(spec)
        return arena

    @property
    def descriptor(self) -> int:
        """File descriptor that the child must inherit under the same number, or -1 on Windows."""
        return self._descriptor

    def spec(self) -> dict[str, Any]:
        """Return what the other side needs for `follow` or `attach`."""
        return {"size": self._size, "descriptor": self._descriptor, "tag": self._tag}

    def reserve(self, size: int) -> None:
        """Make the arena at least `size` bytes large; contents may be lost. Raises `SessionError` when memory is short."""
        if size <= self._size:
            return
        if size > MAX_BYTES:
            raise SessionError(f"The picture needs {size >> 20} MiB of shared memory; choose a smaller size or fewer passes.")
        size = -(-max(size, 2 * self._size) // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        size = min(size, MAX_BYTES)
        try:
            if _WINDOWS:
                self._tag = f"grmm-{os.getpid()}-{secrets.token_hex(8)}"
            elif hasattr(os, "posix_fallocate"):
                # Without this a full memory file system would end the process at the first write, by a signal.
                os.posix_fallocate(self._descriptor, 0, size)
            else:
                os.ftruncate(self._descriptor, size)
            self._remap(size)
        except OSError as error:
            raise _out_of_memory(size, error) from error

    def follow(self, spec: dict[str, Any]) -> None:
        """Map again if the other side made the arena larger."""
        if spec["size"] != self._size or spec["tag"] != self._tag:
            self._tag = str(spec["tag"])
            self._remap(int(spec["size"]))

    def _remap(self, size: int) -> None:
        if self._map is not None:
            self._map.close()
            self._map = None
        if sys.platform == "win32":
            self._map = mmap.mmap(-1, size, tagname=self._tag)
        else:
            self._map = mmap.mmap(self._descriptor, size)
        self._size = size

    def _memory(self) -> mmap.mmap:
        if self._map is None:
            raise SessionError("The model worker's memory was given back; open the session again.")
        return self._map

    def write(self, arrays: list[np.ndarray]) -> list[int]:
        """Copy arrays into the arena, growing it as needed, and return their offsets in bytes. Views lie there as they look."""
        offsets = []
        end = 0
        for array in arrays:
            offsets.append(end)
            end += -(-array.nbytes // _ALIGNMENT) * _ALIGNMENT
        self.reserve(end)
        for array, offset in zip(arrays, offsets, strict=True):
            if array.size == 0:
                continue
            target = np.frombuffer(self._memory(), array.dtype, array.size, offset)
            target.reshape(array.shape)[...] = array
        return offsets

    def read(self, dtype: str, shape: tuple[int, ...], offset: int) -> np.ndarray:
        """Return a copy of an array in the arena."""
        count = int(np.prod(shape, dtype=np.int64))
        if count == 0:
            return np.empty(shape, np.dtype(dtype))
        return np.frombuffer(self._memory(), np.dtype(dtype), count, offset).reshape(shape).copy()

    def close(self) -> None:
        """Give the memory back; harmless when done twice."""
        if self._map is not None:
            self._map.close()
            self._map = None
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        self._size = 0


def _anonymous_file() -> int:
    if hasattr(os, "memfd_create"):
        with contextlib.suppress(OSError):  # a sandbox may forbid it
            return os.memfd_create("grmm", os.MFD_CLOEXEC)
    descriptor, path = tempfile.mkstemp(prefix="grmm-")
    os.unlink(path)  # noqa: PTH108 - a plain name, and the file must go before anything else can fail
    return descriptor


def _out_of_memory(size: int, error: OSError) -> SessionError:
    return SessionError(
        f"There is no room for {max(size >> 20, 1)} MiB of shared memory ({describe_os_error(error)}); "
        "close other programs or render at a smaller size."
    )
