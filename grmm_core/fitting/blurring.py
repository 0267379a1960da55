"""Planes of a picture smoothed and widened. Imports torch."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional


def blurred(planes: np.ndarray, sigma: float) -> np.ndarray:
    """Planes [C, H, W] smoothed by a Gaussian of some pixels."""
    reach = int(np.ceil(3.0 * sigma))
    weights = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / sigma) ** 2)
    kernel = (weights / weights.sum())[None, None, :, None]
    stacked = torch.from_numpy(np.ascontiguousarray(planes, np.float32))[:, None]
    for turned in (kernel, kernel.transpose(2, 3)):
        padding = (0, 0, reach, reach) if turned.shape[2] > 1 else (reach, reach, 0, 0)
        stacked = functional.conv2d(functional.pad(stacked, padding, mode="replicate"), turned)
    return stacked[:, 0].numpy()


def widened(planes: Tensor, reach: int) -> Tensor:
    """The largest value within a square of `reach` pixels to each side, planes [C, H, W]; one way after the other is faster."""
    size = 2 * reach + 1
    rows = functional.max_pool2d(planes[None], (size, 1), 1, (reach, 0))
    return functional.max_pool2d(rows, (1, size), 1, (0, reach))[0]
