"""Strands as Gaussians with gradients, for training and fitting. Importing this module imports torch.

On the CPU the compiled `strand_kernels` compute both passes; elsewhere, and for other float types, `ribbons.segments` does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from .ribbons import Eye, Segments, segments


class _Segments(torch.autograd.Function):
    """`strand_kernels.segments_forward` as an operation of PyTorch."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, radii: Tensor, opacities: Tensor, eye: Eye | None) -> tuple[Tensor, ...]:
        from .strand_kernels import segments_forward

        numbers = np.zeros(14, np.float32) if eye is None else eye.numbers()
        inputs = [part.detach().contiguous().numpy() for part in (points, radii, opacities)]
        total = points.shape[0] * (points.shape[1] - 1)
        made = [np.ones((total, *shape), np.float32) for shape in ((3,), (4,), (3,), ())]
        segments_forward(*inputs, numbers, eye is not None, *made)
        ctx.inputs, ctx.numbers, ctx.antialias = inputs, numbers, eye is not None
        return tuple(torch.from_numpy(part) for part in made)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        from .strand_kernels import segments_backward

        given = [part.contiguous().numpy() for part in gradients]
        made = [np.zeros_like(part) for part in ctx.inputs]
        segments_backward(*ctx.inputs, ctx.numbers, ctx.antialias, *given, *made)
        return (*(torch.from_numpy(part) for part in made), None)


def strand_segments(points: Tensor, radii: Tensor, opacities: Tensor, eye: Eye | None = None) -> Segments[Tensor]:
    """`ribbons.segments`, differentiable in points [N, K, 3], radii [N, 2] and opacities [N].

    Colors need no step of their own: those of the points of a strand, [N, K, 3], are averaged over a segment's two ends.
    """
    if points.device.type != "cpu" or points.dtype != torch.float32:
        return segments(points, radii, opacities, eye)
    shape = (points.shape[0], points.shape[1] - 1)
    parts = _Segments.apply(points, radii, opacities, eye)
    return Segments(*(part.reshape(*shape, *part.shape[1:]) for part in parts))
