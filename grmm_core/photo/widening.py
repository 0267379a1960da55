"""Planes of a picture widened. Imports torch."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional


def widened(planes: Tensor, reach: int) -> Tensor:
    """The largest value within a square of `reach` pixels to each side, planes [C, H, W]; one way after the other is faster."""
    size = 2 * reach + 1
    rows = functional.max_pool2d(planes[None], (size, 1), 1, (reach, 0))
    return functional.max_pool2d(rows, (1, size), 1, (0, reach))[0]
