"""A rasteriser with gradients of its own as a PyTorch operation: what the backends "cpu" and "cuda" share. Imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import torch
from torch import Tensor

from .rules import View
from .types import Gaussians, RasterOutput


class Engine(Protocol):
    """Something that draws and differentiates plain tensors, all float32, contiguous, without gradients.

    Inputs are means [N, 3], quats [N, 4], scales [N, 3], opacities [N], colors [N, 3], features [N, C]; outputs rgb [H, W, 3],
    alpha [H, W], depth [H, W], features [H, W, C].
    """

    def draw(self, inputs: Sequence[Tensor], background: Tensor, view: View, antialiased: bool) -> tuple[list[Tensor], Any]:
        """Return the outputs over a background [1, 1, 3] or [H, W, 3], and what `differentiate` needs of the drawing."""
        ...

    def differentiate(
        self, inputs: Sequence[Tensor], outputs: Sequence[Tensor], drawing: Any, d_outputs: Sequence[Tensor]
    ) -> list[Tensor]:
        """Return the gradients of the inputs, given those of the outputs."""
        ...


def _plain(tensor: Tensor) -> Tensor:
    return tensor.detach().to(torch.float32).contiguous()


class _Rasterize(torch.autograd.Function):
    """Autograd wrapper around an engine."""

    @staticmethod
    def forward(
        ctx: Any, engine: Engine, view: View, antialiased: bool, background: Tensor, *inputs: Tensor
    ) -> tuple[Tensor, ...]:
        outputs, drawing = engine.draw([_plain(tensor) for tensor in inputs], _plain(background), view, antialiased)
        ctx.engine, ctx.drawing = engine, drawing
        ctx.save_for_backward(background, *inputs, *outputs)
        return tuple(outputs)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *d_outputs: Tensor) -> tuple[Tensor | None, ...]:
        background, *tensors = ctx.saved_tensors
        inputs, outputs = tensors[: -len(d_outputs)], tensors[-len(d_outputs) :]
        gradients = ctx.engine.differentiate(
            [_plain(tensor) for tensor in inputs], outputs, ctx.drawing, [_plain(tensor) for tensor in d_outputs]
        )
        _, _, _, ground_needed, *needed = ctx.needs_input_grad
        d_background = None
        if ground_needed:
            d_background = ((1 - outputs[1])[..., None] * d_outputs[0]).sum_to_size(background.shape).to(background.dtype)
        return (
            None, None, None, d_background,
            *(d.to(x.dtype) if wanted else None for d, x, wanted in zip(gradients, inputs, needed, strict=True)),
        )  # fmt: skip


def rasterize_with(
    engine: Engine, gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput[Tensor]:
    """Draw Gaussians with an engine; the other arguments as in `reference.rasterize_reference`, computed in float32."""
    means = gaussians.means
    features = means.new_empty(len(gaussians), 0) if gaussians.features is None else gaussians.features
    ground = means.new_zeros(3) if background is None else background
    ground = ground.reshape(1, 1, 3) if ground.ndim == 1 else ground
    inputs = (means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors, features)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (*inputs, ground)):
        rgb, alpha, depth, blended = _Rasterize.apply(engine, view, antialiased, ground, *inputs)
    else:
        outputs, _ = engine.draw([_plain(tensor) for tensor in inputs], _plain(ground), view, antialiased)
        rgb, alpha, depth, blended = outputs
    return RasterOutput(rgb, alpha, depth, None if gaussians.features is None else blended)
