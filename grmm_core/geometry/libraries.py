"""Functions that are one text for numpy arrays and torch tensors: the library is picked by the argument's type.

So the animation path (numpy, stock Blender) and the training path (torch, batched, differentiable) cannot drift apart.
Torch is never imported here.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

    Array = TypeVar("Array", np.ndarray, torch.Tensor)
else:
    Array = TypeVar("Array")


def library_of(array: np.ndarray | torch.Tensor) -> ModuleType:
    """Return torch for a tensor and numpy for anything else, without importing torch."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(array, torch.Tensor) else np
