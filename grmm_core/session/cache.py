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

    def drop(self, owner: Hashable) -> None:
        """Forget every entry of an owner."""
        for key in [key for key in self._entries if key[0] == owner]:
            self.size -= _bytes(self._entries.pop(key))

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()
        self.size = 0


def _bytes(value: tuple[Any, ...]) -> int:
    return sum(int(array.nbytes) for array in value)
