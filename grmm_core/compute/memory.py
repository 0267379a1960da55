"""Memory of processes: how much there is, and giving back what is free. Standard library only."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from pathlib import Path


def resident_memory(pid: int | None = None) -> int:
    """Return the resident memory of a process in bytes, or 0 where the system does not tell (it does on Linux)."""
    try:
        pages = Path(f"/proc/{'self' if pid is None else pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError, AttributeError):
        return 0


def give_back() -> None:
    """Give memory that was freed back to the system, where the C library keeps it (glibc does: large arrays leave holes)."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):  # another C library has no such call
            ctypes.CDLL(None).malloc_trim(0)
