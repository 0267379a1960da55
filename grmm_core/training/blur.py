"""The Gaussian window of SSIM as a fast separable filter, differentiable.

On the CPU in float32 a small numba kernel filters rows and columns; elsewhere two banded matrix products do the same. For the
pictures of a training step the kernel takes about a tenth of the products' time. Used by `losses`.
"""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

import numpy as np
import torch
from torch import Tensor

SIGMA = 1.5
RADIUS = 5
ROWS_MIN = 64  # rows of a parallel task


def blur(planes: Tensor) -> Tensor:
    """Filter planes [C, H, W] with a Gaussian window of 11 x 11 pixels, cut and renormalised at the border."""
    if planes.device.type == "cpu" and planes.dtype == torch.float32 and _has_numba():
        result: Tensor = _Blur.apply(planes)
        return result
    rows, columns = (banded(size, planes.dtype, planes.device) for size in planes.shape[-2:])
    return (rows @ planes) @ columns.T


def window() -> np.ndarray:
    """Weights of the window in one direction, [2 RADIUS + 1] float64, not normalised."""
    return np.exp(-(np.arange(-RADIUS, RADIUS + 1) ** 2) / (2.0 * SIGMA**2))


@functools.lru_cache(maxsize=16)
def banded(size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Matrix [size, size] that filters a column with the window."""
    matrix = np.zeros((size, size))
    for offset, weight in zip(range(-RADIUS, RADIUS + 1), window(), strict=True):
        matrix += weight * np.eye(size, k=offset)
    return torch.from_numpy(matrix / matrix.sum(1, keepdims=True)).to(dtype).to(device)


@functools.lru_cache(maxsize=16)
def _inverse_sums(size: int) -> np.ndarray:
    sums = np.convolve(np.ones(size), window(), mode="full")[RADIUS : RADIUS + size]
    return (1.0 / sums).astype(np.float32)


@functools.lru_cache(maxsize=1)
def _has_numba() -> bool:
    return importlib.util.find_spec("numba") is not None


class _Blur(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, planes: Tensor) -> Tensor:
        return _filter(planes, normalise_first=False)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        # the filter is D G with G symmetric and D the renormalisation; its transpose is G D
        return _filter(gradients[0], normalise_first=True)


def _filter(planes: Tensor, normalise_first: bool) -> Tensor:
    from ..compute.threads import for_rows
    from .blur_kernel import separable

    source = planes.detach().contiguous().numpy()
    result = np.empty_like(source)
    height, width = source.shape[1:]
    factors = (window().astype(np.float32), _inverse_sums(height), _inverse_sums(width))
    # numba's own parallel loop would set OpenMP's threads for the whole process, torch's too, whatever torch was told
    for_rows(separable, len(source) * height, source, result, *factors, normalise_first, smallest=ROWS_MIN)
    return torch.from_numpy(result)
