"""A cache bounded in bytes, for what a model computes from one avatar. Used by `evaluator`."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Value = TypeVar("Value", bound=tuple[Any, ...])


class ArrayCache:
    """Least-recently-used cache of tuples of arrays or tensors.

    Attributes:
        limit: Bytes of data to keep; the newest entry stays even if it alone is larger.
        size: Bytes held now.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0
        self._entries: OrderedDict[tuple[Hashable, ...], Any] = OrderedDict()

    def get(self, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        """Return the value of `key`, made by `make` if it is not there. The first part of a key is its owner."""
        if key in self._entries:
            self._entries.move_to_end(key)
            known: Value = self._entries[key]
            return known
        value = make()
        self._entries[key] = value
        self.size += _bytes(value)
        while self.size > self.limit and len(self._entries) > 1:
            _, dropped = self._entries.popitem(last=False)
            self.size -= _bytes(dropped)
        return value

    def latest(self, key: tuple[Hashable, ...], parts: tuple[Any, ...], make: Callable[[], Value]) -> Value:
        """Return what `make` makes of these very arrays; of each key only the last is kept, until there are others."""
        known = self._entries.get(key)
        if known is not None and any(a is not b for a, b in zip(known[0], parts, strict=True)):
            self.size -= _bytes(self._entries.pop(key))
        made: Value = self.get(key, lambda: (parts, make()))[1]
        return made

    def drop(self, owner: Hashable) -> None:
        """Forget every entry of an owner."""
        for key in [key for key in self._entries if key[0] == owner]:
            self.size -= _bytes(self._entries.pop(key))

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()
        self.size = 0


def _bytes(value: tuple[Any, ...]) -> int:
    return sum(_bytes(array) if isinstance(array, tuple) else int(array.nbytes) for array in value)
