"""Facts about processes for diagnostics. Standard library only."""

from __future__ import annotations

import os
from pathlib import Path


def resident_memory(pid: int | None = None) -> int:
    """Return the resident memory of a process in bytes, or 0 where the system does not tell (it does on Linux)."""
    try:
        pages = Path(f"/proc/{'self' if pid is None else pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError, AttributeError):
        return 0
