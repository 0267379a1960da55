"""The backend "cpu" for PyTorch: `drawing.py` on the memory of tensors. `backends.py` calls `rasterize_cpu`."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ...errors import BackendError
from ..autograd import rasterize_with
from ..rules import View
from ..types import GaussianArrays, Gaussians, PictureArrays, RasterOutput
from .drawing import Drawing, differentiate, draw


def _gaussians(tensors: Sequence[Tensor]) -> GaussianArrays:
    return GaussianArrays(*(tensor.numpy() for tensor in tensors))


def _pictures(tensors: Sequence[Tensor]) -> PictureArrays:
    return PictureArrays(*(tensor.numpy() for tensor in tensors))


class CpuEngine:
    """The compiled kernels as an `autograd.Engine`."""

    def draw(self, inputs: Sequence[Tensor], background: Tensor, view: View, antialiased: bool) -> tuple[list[Tensor], Drawing]:
        """See `autograd.Engine.draw`."""
        pictures, drawing = draw(_gaussians(inputs), background.numpy(), view, antialiased)
        return [torch.from_numpy(array) for array in pictures[:4]], drawing

    def differentiate(
        self, inputs: Sequence[Tensor], outputs: Sequence[Tensor], drawing: Drawing, d_outputs: Sequence[Tensor]
    ) -> list[Tensor]:
        """See `autograd.Engine.differentiate`."""
        gradients = differentiate(_gaussians(inputs), _pictures(outputs), drawing, _pictures(d_outputs))
        return [torch.from_numpy(array) for array in gradients]


def rasterize_cpu(gaussians: Gaussians, view: View, background: Tensor | None, antialiased: bool) -> RasterOutput[Tensor]:
    """Draw Gaussians with the compiled kernels; arguments as in `reference.rasterize_reference`, computed in float32.

    Raises:
        BackendError: The tensors are not on the CPU, or the scene is too large.
    """
    if gaussians.means.device.type != "cpu":
        raise BackendError(f"The CPU rasteriser needs tensors on the CPU; these are on {gaussians.means.device}.")
    return rasterize_with(CpuEngine(), gaussians, view, background, antialiased)
