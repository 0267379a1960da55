"""The last few results of work that depends on nothing but what it is given, for those who ask for the same again.

A fit opens its avatar in a session again and again, and each time much of the person is what it was: the mesh, the strands, the
furrows. Caches of a session go by avatars (`session.cache`); this one goes by contents. Needs numpy only.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import numpy as np

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """Results that were made last; who gets one must not change its arrays.

    Args:
        count: How many are kept.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._known: OrderedDict[tuple[Hashable, ...], Value] = OrderedDict()  # in the order of their use
        self._lock = threading.Lock()

    def get(self, given: tuple[Any, ...], make: Callable[[], Value]) -> Value:
        """Return what `make` makes, or has made, of what is given: arrays go by their contents, all else by equality.

        Several threads may ask at a time; what two of them lack at once, both make.
        """
        key = tuple(_contents(one) for one in given)
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        made = make()
        with self._lock:
            self._known[key] = made
            while len(self._known) > self._count:
                self._known.popitem(last=False)
        return made


def _contents(one: Any) -> Hashable:
    """What stands for a value in a key."""
    if isinstance(one, tuple):
        return tuple(_contents(part) for part in one)
    if not isinstance(one, np.ndarray):
        kept: Hashable = one
        return kept
    data = np.ascontiguousarray(one).reshape(-1).view(np.uint8).data
    return one.shape, one.dtype.str, hashlib.blake2b(data, digest_size=16).digest()
