"""A lock that is waited for so long and no longer. Used by both sessions."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def held(lock: threading.RLock, seconds: float) -> Iterator[bool]:
    """Hold a lock that comes free within some seconds; tells whether it did."""
    free = lock.acquire(timeout=seconds)
    try:
        yield free
    finally:
        if free:
            lock.release()
