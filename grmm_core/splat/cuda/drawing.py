"""Drawing with the CUDA kernels: tensors in and out, sorting by torch, gradients by the kernels of `kernels.cu`.

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


@dataclass
class CudaEngine:
    """The kernels as an `autograd.Engine`.

    Attributes:
        kernels: For the features' number of channels.
    """

    kernels: Kernels

    def draw(self, inputs: Sequence[Tensor], background: Tensor, view: View, antialiased: bool) -> tuple[list[Tensor], Drawing]:
        """See `autograd.Engine.draw`.

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
            self.kernels.launch("project", rows, count, *inputs, camera, records, touched)
        ends = touched.cumsum(0, dtype=torch.int64)
        instances = int(ends[-1]) if count else 0
        if instances > MAX_INSTANCES:
            raise BackendError("The Gaussians are too large and too many to draw: scale them down or make the picture smaller.")
        keys = torch.empty(instances, dtype=torch.int64, device=means.device)
        owners = torch.empty(instances, dtype=torch.int32, device=means.device)
        if instances:
            self.kernels.launch("list_tiles", rows, count, tiles_x, records, touched, ends, keys, owners)
        keys, order = torch.sort(keys, stable=True)  # slots follow the index, and so equal depths keep its order
        starts = torch.searchsorted(keys, torch.arange(tiles_x * tiles_y + 1, device=means.device) << 32)
        gaussian = owners[order]
        outputs = [means.new_empty(shape) for shape in ((height, width, 3), (height, width), (height, width))]
        outputs.append(means.new_empty(height, width, features.shape[1]))
        self.kernels.launch(
            "blend", (tiles_x, tiles_y), tiles_x, width, height, starts, gaussian, records, features, background,
            0 if background.shape[:2] == (1, 1) else 3, *outputs,
        )  # fmt: skip
        return outputs, Drawing(camera, (tiles_x, tiles_y), records, touched, ends, starts, gaussian, order)

    def differentiate(
        self, inputs: Sequence[Tensor], outputs: Sequence[Tensor], drawing: Drawing, d_outputs: Sequence[Tensor]
    ) -> list[Tensor]:
        """See `autograd.Engine.differentiate`."""
        gradients = [torch.zeros_like(tensor) for tensor in inputs]
        count, (height, width) = len(inputs[0]), outputs[1].shape
        if len(drawing.gaussian):
            rows = inputs[0].new_zeros(len(drawing.gaussian), row_length(inputs[5].shape[1]))
            self.kernels.launch(
                "replay", drawing.tiles, drawing.tiles[0], width, height, drawing.starts, drawing.gaussian, drawing.order,
                drawing.records, inputs[5], *outputs, *d_outputs, rows,
            )  # fmt: skip
            self.kernels.launch(
                "collect", (-(-count // THREADS), 1), count, *inputs[:4], drawing.camera, drawing.records, drawing.touched,
                drawing.ends, rows, *gradients,
            )  # fmt: skip
        return gradients
