"""A cache bounded in bytes, for what a model computes from one avatar. Used by `evaluator`."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Value = TypeVar("Value", bound=tuple[Any, ...])
FEW, MANY = 4, 64  # values of one kind that are kept however large they are, and however small
SHARE = 1 / 16  # of a cache that one kind of more than a few may fill: what poses need would else fill it while a head plays


class ArrayCache:
    """Least-recently-used cache of tuples of arrays or tensors.

    The first part of a key is its owner, the second one says of what kind the value is. Of each kind of an owner no more
    than the latest are kept, so that memory does not grow with the frames that a head has played. Several threads may ask at a
    time; what two of them lack at once, both make.

    Attributes:
        limit: Bytes of data to keep; the newest entry stays even if it alone is larger.
        size: Bytes held now.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0
        self._entries: OrderedDict[tuple[Hashable, ...], Any] = OrderedDict()  # in the order of their use
        self._kinds: dict[tuple[Hashable, ...], _Kind] = {}
        self._lock = threading.RLock()

    def get(self, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        """Return the value of `key`, made by `make` if it is not there."""
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
                self._kinds[key[:2]].sizes.move_to_end(key)
                known: Value = self._entries[key]
                return known
        value = make()
        with self._lock:
            self._keep(key, value)
        return value

    def _keep(self, key: tuple[Hashable, ...], value: tuple[Any, ...]) -> None:
        self._forget(key)  # made within, by what asked for itself, or on another thread
        size = _bytes(value)
        self._entries[key] = value
        self.size += size
        kind = self._kinds.setdefault(key[:2], _Kind())
        kind.sizes[key] = size
        kind.held += size
        while len(kind.sizes) > FEW and (len(kind.sizes) > MANY or kind.held > SHARE * self.limit):
            self._forget(next(iter(kind.sizes)))
        while self.size > self.limit and len(self._entries) > 1:
            self._forget(next(iter(self._entries)))

    def _forget(self, key: tuple[Hashable, ...]) -> None:
        if self._entries.pop(key, None) is None:
            return
        kind = self._kinds[key[:2]]
        size = kind.sizes.pop(key)
        kind.held -= size
        self.size -= size
        if not kind.sizes:
            del self._kinds[key[:2]]

    def latest(self, key: tuple[Hashable, ...], parts: tuple[Any, ...], make: Callable[[], Value]) -> Value:
        """Return what `make` makes of these very arrays; of each key only the last is kept, until there are others."""
        known = self._entries.get(key)
        if known is not None and any(a is not b for a, b in zip(known[0], parts, strict=True)):
            self._forget(key)
        made: Value = self.get(key, lambda: (parts, make()))[1]
        return made

    def drop(self, owner: Hashable) -> None:
        """Forget every entry of an owner."""
        for key in [key for key in self._entries if key[0] == owner]:
            self._forget(key)

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()
        self._kinds.clear()
        self.size = 0


class _Kind:
    """The bytes of each value of a kind, in the order of their use, and of all."""

    def __init__(self) -> None:
        self.sizes: OrderedDict[tuple[Hashable, ...], int] = OrderedDict()
        self.held = 0


def _bytes(value: tuple[Any, ...]) -> int:
    return sum(_bytes(array) if isinstance(array, tuple) else int(array.nbytes) for array in value)
