"""A cache bounded in bytes, for what a model computes from one avatar. Used by `evaluate`."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Value = TypeVar("Value", bound="tuple[Tensor, ...]")


class TensorCache:
    """Least-recently-used cache of tuples of tensors.

    Attributes:
        limit: Bytes of tensor data to keep; the newest entry stays even if it alone is larger.
        size: Bytes held now.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0
        self._entries: OrderedDict[Hashable, tuple[Tensor, ...]] = OrderedDict()

    def get(self, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        """Return the value of `key`, made by `make` if it is not there. The first part of a key is its owner."""
        if key in self._entries:
            self._entries.move_to_end(key)
            return self._entries[key]  # type: ignore[return-value]
        value = make()
        self._entries[key] = value
        self.size += _bytes(value)
        while self.size > self.limit and len(self._entries) > 1:
            _, dropped = self._entries.popitem(last=False)
            self.size -= _bytes(dropped)
        return value

    def drop(self, owner: Hashable) -> None:
        """Forget every entry of an owner."""
        for key in [key for key in self._entries if key[0] == owner]:  # type: ignore[index]
            self.size -= _bytes(self._entries.pop(key))

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()
        self.size = 0


def _bytes(value: tuple[Tensor, ...]) -> int:
    return sum(tensor.numel() * tensor.element_size() for tensor in value)
