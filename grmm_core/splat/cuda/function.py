"""The CUDA kernels as a PyTorch operation: tensors in and out, sorting by torch, gradients by the kernels of `kernels.cu`.

It knows no graphics card: whoever calls it gives the `Kernels` that run. `adapter.py` gives those of `launch.py`; the tests
give the same text compiled for the CPU, and so prove everything here and in the kernels but the launch itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ...errors import BackendError
from ..rules import TILE, View
from ..types import Gaussians, RasterOutput
from .source import RECORD, THREADS, camera_block, row_length

MAX_INSTANCES = 2**31 - 1
TILES_MAX = 1 << 14  # tiles in a row or column of the grid


class Kernels(Protocol):
    """Something that runs the kernels compiled for one number of features."""

    def launch(self, name: str, blocks: tuple[int, int], *arguments: Any) -> None:
        """Start a kernel on blocks of `THREADS` threads.

        Args:
            name: One of `source.KERNELS`.
            blocks: Grid, x and y.
            arguments: In the kernel's order: tensors (contiguous, on its device), ints (32 bit), float64 arrays (by value).
        """
        ...


@dataclass
class Drawing:
    """What the backward pass needs of a forward pass.

    Attributes:
        camera: `source.camera_block`.
        tiles: Tiles in a row and in a column of the grid.
        records: [N, RECORD] projected Gaussians.
        touched: [N] int32 tiles of each.
        ends: [N] int64 running sum of `touched`.
        starts: [tiles + 1] int64 first instance of each tile.
        gaussian: [M] int32 Gaussian of each instance, by tile and depth.
        order: [M] int64 slot of each instance: its place by Gaussian.
    """

    camera: np.ndarray
    tiles: tuple[int, int]
    records: Tensor
    touched: Tensor
    ends: Tensor
    starts: Tensor
    gaussian: Tensor
    order: Tensor


def draw(
    kernels: Kernels, inputs: Sequence[Tensor], background: Tensor, view: View, antialiased: bool
) -> tuple[list[Tensor], Drawing]:
    """Draw Gaussians.

    Args:
        kernels: For the features' number of channels.
        inputs: means [N, 3], quats [N, 4], scales [N, 3], opacities [N], colors [N, 3], features [N, C]; float32, contiguous.
        background: [3] or [H, W, 3] float32, contiguous.
        view: The camera.
        antialiased: Opacity compensation.

    Returns:
        rgb [H, W, 3], alpha [H, W], depth [H, W], features [H, W, C]; and what the backward pass needs.

    Raises:
        BackendError: The picture or the Gaussians' footprint is too large.
    """
    means, features = inputs[0], inputs[5]
    count, height, width = len(means), view.height, view.width
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    if max(tiles_x, tiles_y) > TILES_MAX:
        raise BackendError(f"A picture of {width}x{height} pixels is too large to draw at once; draw it in parts.")
    camera = camera_block(view, antialiased)
    records = means.new_empty(count, RECORD)
    touched = torch.zeros(count, dtype=torch.int32, device=means.device)
    rows = (-(-count // THREADS), 1)
    if count:
        kernels.launch("project", rows, count, *inputs, camera, records, touched)
    ends = touched.cumsum(0, dtype=torch.int64)
    instances = int(ends[-1]) if count else 0
    if instances > MAX_INSTANCES:
        raise BackendError("The Gaussians are too large and too many to draw: scale them down or make the picture smaller.")
    keys = torch.empty(instances, dtype=torch.int64, device=means.device)
    owners = torch.empty(instances, dtype=torch.int32, device=means.device)
    if instances:
        kernels.launch("list_tiles", rows, count, tiles_x, records, touched, ends, keys, owners)
    keys, order = torch.sort(keys, stable=True)  # slots follow the index, and so equal depths keep its order
    starts = torch.searchsorted(keys, torch.arange(tiles_x * tiles_y + 1, device=means.device) << 32)
    gaussian = owners[order]
    outputs = [means.new_empty(shape) for shape in ((height, width, 3), (height, width), (height, width))]
    outputs.append(means.new_empty(height, width, features.shape[1]))
    kernels.launch(
        "blend", (tiles_x, tiles_y), tiles_x, width, height, starts, gaussian, records, features, background,
        3 if background.ndim == 3 else 0, *outputs,
    )  # fmt: skip
    return outputs, Drawing(camera, (tiles_x, tiles_y), records, touched, ends, starts, gaussian, order)


def differentiate(
    kernels: Kernels, inputs: Sequence[Tensor], outputs: Sequence[Tensor], drawing: Drawing, d_outputs: Sequence[Tensor]
) -> list[Tensor]:
    """Return the gradients of `inputs`, given those of `outputs`; tensors as in `draw`."""
    gradients = [torch.zeros_like(tensor) for tensor in inputs]
    count, (height, width) = len(inputs[0]), outputs[1].shape
    if len(drawing.gaussian):
        rows = inputs[0].new_zeros(len(drawing.gaussian), row_length(inputs[5].shape[1]))
        kernels.launch(
            "replay", drawing.tiles, drawing.tiles[0], width, height, drawing.starts, drawing.gaussian, drawing.order,
            drawing.records, inputs[5], *outputs, *d_outputs, rows,
        )  # fmt: skip
        kernels.launch(
            "collect", (-(-count // THREADS), 1), count, *inputs[:4], drawing.camera, drawing.records, drawing.touched,
            drawing.ends, rows, *gradients,
        )  # fmt: skip
    return gradients


class _Rasterize(torch.autograd.Function):
    """Autograd wrapper around `draw` and `differentiate`."""

    @staticmethod
    def forward(ctx: Any, kernels: Kernels, view: View, antialiased: bool, background: Tensor, *inputs: Tensor) -> Any:
        plain = [_plain(tensor) for tensor in inputs]
        outputs, drawing = draw(kernels, plain, _plain(background), view, antialiased)
        ctx.kernels, ctx.drawing = kernels, drawing
        ctx.save_for_backward(background, *inputs, *outputs)
        return tuple(outputs)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *d_results: Tensor) -> tuple[Tensor | None, ...]:
        background, *tensors = ctx.saved_tensors
        inputs, outputs = tensors[:6], tensors[6:]
        gradients = differentiate(
            ctx.kernels, [_plain(t) for t in inputs], outputs, ctx.drawing, [_plain(d) for d in d_results]
        )
        d_background = None
        if ctx.needs_input_grad[3]:
            d_background = ((1 - outputs[1])[..., None] * d_results[0]).sum_to_size(background.shape).to(background.dtype)
        needed = [
            gradient.to(tensor.dtype) if wanted else None
            for gradient, tensor, wanted in zip(gradients, inputs, ctx.needs_input_grad[4:], strict=True)
        ]
        return (None, None, None, d_background, *needed)


def _plain(tensor: Tensor) -> Tensor:
    return tensor.detach().to(torch.float32).contiguous()


def rasterize_kernels(
    kernels: Kernels, gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput:
    """Draw Gaussians with the kernels; the other arguments as in `reference.rasterize_reference`, computed in float32."""
    means = gaussians.means
    features = means.new_empty(len(gaussians), 0) if gaussians.features is None else gaussians.features
    ground = torch.zeros(3, device=means.device) if background is None else background
    leaves = (means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors, features)
    rgb, alpha, depth, blended = _Rasterize.apply(kernels, view, antialiased, ground, *leaves)
    return RasterOutput(rgb, alpha, depth, None if gaussians.features is None else blended)
