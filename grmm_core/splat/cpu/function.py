"""The compiled rasteriser as a PyTorch operation: torch tensors in and out, gradients by hand-written kernels.

`api.py` imports this when the backend "cpu" is first used. Any number of threads may call it at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import BackendError
from ..rules import TILE, View
from ..types import Gaussians, RasterOutput
from . import backward, binning, blocks, buffers, forward, projection
from .threads import for_each, thread_count

TASKS = 16  # parallel tasks per thread, so that threads end together
CHUNK_MIN, TILES_MIN = 2048, 4  # smallest task
CHUNKS_MAX = 64  # chunks of Gaussians; each counts every tile
MAX_INSTANCES = 2**28  # pairs of a Gaussian and a tile: 1 GiB of numbers; a head has a million
MAX_GRADIENT_BYTES = 8 << 30  # of the pairs' gradients


@dataclass
class Drawing:
    """What the backward pass needs of a forward pass; arrays as their kernels describe them."""

    camera: np.ndarray
    tiles_x: int
    geometry: np.ndarray
    whole: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    gaussian: np.ndarray


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().to(torch.float32).contiguous().numpy()


def _pieces(count: int, smallest: int, most: int) -> list[tuple[int, int]]:
    """Split range(count) into at most `most` ranges of at least `smallest`, for parallel tasks."""
    size = max(smallest, -(-count // most), 1)
    return [(low, min(low + size, count)) for low in range(0, count, size)]


def draw(inputs: list[np.ndarray], background: np.ndarray, view: View, antialiased: bool) -> tuple[list[np.ndarray], Drawing]:
    """Draw Gaussians.

    Args:
        inputs: means [N, 3], quats [N, 4], scales [N, 3], opacities [N], colors [N, 3], features [N, C]; float32, contiguous.
        background: [1, 1, 3] or [H, W, 3] float32.
        view: The camera.
        antialiased: Opacity compensation.

    Returns:
        rgb [H, W, 3], alpha [H, W], depth [H, W] and features [H, W, C]; and what the backward pass needs.

    Raises:
        BackendError: The picture is too large, or the Gaussians cover so many tiles that they cannot be counted.
    """
    count = len(inputs[0])
    height, width = view.height, view.width
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    if max(tiles_x, tiles_y) > projection.TILES_MAX:
        raise BackendError(f"A picture of {width}x{height} pixels is too large to draw at once; draw it in parts.")
    tiles = tiles_x * tiles_y
    camera = projection.camera_array(view, antialiased)
    geometry = np.empty((count, projection.RECORD), np.float32)
    whole = geometry.view(np.int32)
    threads = thread_count()

    chunks = _pieces(count, CHUNK_MIN, min(TASKS * threads, CHUNKS_MAX))
    histogram = np.zeros((len(chunks), tiles), np.int32)
    touched = np.zeros(len(chunks), np.int64)
    starts = np.empty(tiles + 1, np.int64)

    def project(k: int) -> None:
        touched[k] = projection.project(*chunks[k], *inputs, camera, geometry, whole, tiles_x, histogram[k])

    for_each(len(chunks), project)
    instances = int(touched.sum())
    if instances > MAX_INSTANCES:
        raise BackendError("The Gaussians are too large and too many to draw: scale them down or make the picture smaller.")
    binning.place(histogram, touched, starts)
    gaussian = np.empty(instances, np.int32)
    for_each(len(chunks), lambda k: binning.fill(*chunks[k], whole, tiles_x, histogram[k], touched[k], gaussian))

    outputs = [buffers.empty(shape) for shape in ((height, width, 3), (height, width), (height, width))]
    outputs.append(buffers.empty((height, width, inputs[5].shape[1])))
    ends = np.empty(tiles, np.int64)
    groups = _pieces(tiles, TILES_MIN, TASKS * threads)
    for_each(
        len(groups),
        lambda k: forward.draw(
            *groups[k], tiles_x, starts, gaussian, geometry, whole, inputs[5], background, blocks.CONSTANTS, *outputs, ends
        ),
    )
    return outputs, Drawing(camera, tiles_x, geometry, whole, starts, ends, gaussian)


def differentiate(
    inputs: list[np.ndarray], outputs: list[np.ndarray], drawing: Drawing, d_outputs: list[np.ndarray]
) -> list[np.ndarray]:
    """Return the gradients of `inputs`, given those of `outputs`; arrays as in `draw`. Raises `BackendError` as `draw`."""
    shape = (len(drawing.gaussian), projection.MOMENTS + blocks.padded(inputs[5].shape[1]))
    if 4 * shape[0] * shape[1] > MAX_GRADIENT_BYTES:
        raise BackendError("The Gaussians are too large and too many to differentiate: scale them down.")
    rows = buffers.empty(shape)
    d_inputs = [np.zeros_like(array) for array in inputs]
    geometry, whole = drawing.geometry, drawing.whole
    groups = _pieces(len(drawing.ends), TILES_MIN, TASKS * thread_count())
    for_each(
        len(groups),
        lambda k: backward.replay(
            *groups[k], drawing.tiles_x, drawing.starts, drawing.ends, drawing.gaussian, geometry, whole, inputs[5],
            blocks.CONSTANTS, *outputs, *d_outputs, rows,
        ),
    )  # fmt: skip
    chunks = _pieces(len(inputs[0]), CHUNK_MIN, TASKS * thread_count())
    for_each(len(chunks), lambda k: backward.collect(*chunks[k], rows, *inputs[:4], drawing.camera, geometry, whole, *d_inputs))
    return d_inputs


class _Rasterize(torch.autograd.Function):
    """Autograd wrapper around `draw` and `differentiate`."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        features: Tensor,
        background: Tensor,
        view: View,
        antialiased: bool,
    ) -> tuple[Tensor, ...]:
        inputs = [_array(tensor) for tensor in (means, quats, scales, opacities, colors, features)]
        ground = _array(background)
        outputs, drawing = draw(inputs, ground, view, antialiased)
        results = tuple(torch.from_numpy(array) for array in outputs)
        ctx.drawing = drawing
        ctx.save_for_backward(means, quats, scales, opacities, colors, features, background, *results)
        ctx.set_materialize_grads(True)
        return results

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *d_results: Tensor) -> tuple[Tensor | None, ...]:
        *tensors, background, rgb, alpha, depth, features = ctx.saved_tensors
        inputs = [_array(tensor) for tensor in tensors]
        outputs = [tensor.detach().numpy() for tensor in (rgb, alpha, depth, features)]
        d_outputs = [_array(tensor) for tensor in d_results]
        d_inputs = differentiate(inputs, outputs, ctx.drawing, d_outputs)
        gradients: list[Tensor | None] = [
            torch.from_numpy(array).to(tensor.dtype) if needed else None
            for array, tensor, needed in zip(d_inputs, tensors, ctx.needs_input_grad[:6], strict=True)
        ]
        d_background = None
        if ctx.needs_input_grad[6]:
            d_background = ((1 - alpha)[..., None] * d_results[0]).sum_to_size(background.shape).to(background.dtype)
        return (*gradients, d_background, None, None)


def rasterize_cpu(
    gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput:
    """Draw Gaussians with the compiled kernels; arguments as in `reference.rasterize_reference`, computed in float32."""
    count = len(gaussians)
    features = gaussians.features
    if features is None:
        features = gaussians.means.new_empty(count, 0)
    ground = torch.zeros(1, 1, 3) if background is None else background.to(torch.float32)
    ground = ground.reshape(1, 1, 3) if ground.ndim == 1 else ground
    leaves = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors, features)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (*leaves, ground)):
        rgb, alpha, depth, blended = _Rasterize.apply(*leaves, ground, view, antialiased)
    else:
        outputs, _ = draw([_array(tensor) for tensor in leaves], _array(ground), view, antialiased)
        rgb, alpha, depth, blended = (torch.from_numpy(array) for array in outputs)
    return RasterOutput(rgb, alpha, depth, None if gaussians.features is None else blended)
