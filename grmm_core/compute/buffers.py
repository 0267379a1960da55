"""Memory for pictures, kept when nobody holds the picture any more and given out again.

Touching new memory for the first time costs the system more than drawing does: a third of the time of a picture of 1024 x 1024
with 36 channels. Used by `splat.cpu.drawing`, `light.relight` and `session.stacking`.
"""

from __future__ import annotations

import math
import threading
import weakref

import numpy as np

SMALLEST = 1 << 20  # bytes; smaller arrays come from numpy
KEPT_BYTES = 384 << 20  # of memory that nobody holds

_lock = threading.RLock()  # a finaliser may run in the middle of `empty`
_free: list[np.ndarray] = []


def empty(shape: tuple[int, ...]) -> np.ndarray:
    """Return a float32 array of undefined values; its memory returns here when the array and all views of it are gone."""
    size = 4 * math.prod(shape)
    if size < SMALLEST:
        return np.empty(shape, np.float32)
    memory: np.ndarray | None = None
    with _lock:
        for number in range(len(_free) - 1, -1, -1):
            if _free[number].nbytes == size:
                memory = _free.pop(number)
                break
    if memory is None:
        memory = np.empty(size, np.uint8)
    # Views of an array that stands on a memoryview keep that array alive, not what lies below it.
    array = np.frombuffer(memory.data, np.float32)
    weakref.finalize(array, _give_back, memory).atexit = False
    return array.reshape(shape)


def _give_back(memory: np.ndarray) -> None:
    with _lock:
        _free.append(memory)
        total = sum(one.nbytes for one in _free)
        while total > KEPT_BYTES:
            total -= _free.pop(0).nbytes
