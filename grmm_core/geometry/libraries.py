"""Functions that are one text for numpy arrays and torch tensors: the library is picked by the argument's type.

So the animation path (numpy, stock Blender) and the training path (torch, batched, differentiable) cannot drift apart.
Torch is never imported here.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..errors import ShapeError

if TYPE_CHECKING:
    import torch

    Array = TypeVar("Array", np.ndarray, torch.Tensor)
else:
    Array = TypeVar("Array")


def library_of(array: np.ndarray | torch.Tensor) -> ModuleType:
    """Return torch for a tensor and numpy for anything else, without importing torch."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(array, torch.Tensor) else np


def present(array: Array | None) -> Array:
    """Return an array that only other callers leave out. Raises `ShapeError` where it is left out."""
    if array is None:
        raise ShapeError("An array that is needed here was left out.")
    return array


def zeros(shape: tuple[int, ...], like: Array) -> Array:
    """Zeros of a shape, of the type and device of an array."""
    library = library_of(like)
    place: dict[str, Any] = {} if isinstance(like, np.ndarray) else {"device": like.device}
    result: Array = library.zeros(shape, dtype=like.dtype, **place)
    return result


def as_like(values: np.ndarray | tuple[float, ...], like: Array) -> Array:
    """Numbers as an array or tensor of the type and device of another one."""
    library = library_of(like)
    place: dict[str, Any] = {} if isinstance(like, np.ndarray) else {"device": like.device}
    result: Array = library.asarray(values, dtype=like.dtype, **place)
    return result


def to_numpy(array: np.ndarray | torch.Tensor) -> np.ndarray:
    """Contiguous float32 numbers of an array or tensor."""
    return np.ascontiguousarray(array if isinstance(array, np.ndarray) else array.detach().float().cpu().numpy(), np.float32)
