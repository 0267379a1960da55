"""Levels of detail: one larger Gaussian in the place of a block of texels.

Level 0 is every Gaussian; each further level has about a quarter of them. Needs numpy only; `thin_out` takes tensors.
Used by sessions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..splat.types import Gaussians

if TYPE_CHECKING:
    from torch import Tensor


class Blocks(NamedTuple):
    """Blocks of 2^lod x 2^lod texels, M of them.

    Attributes:
        middle: The texel that stands for each block, [M] int64.
        block: Block of each texel, [N] int64.
        counts: Texels in each block, [M] float32.
    """

    middle: np.ndarray
    block: np.ndarray
    counts: np.ndarray


def texel_blocks(texel: np.ndarray, grid: int, lod: int) -> Blocks:
    """Find the blocks of the active texels.

    Args:
        texel: Flat index row * grid + column of each active texel, [N].
        grid: Texels along a side.
        lod: Level of detail, at least 1.
    """
    side = 1 << lod
    row, column = np.divmod(np.asarray(texel, np.int64), grid)
    _, block = np.unique((row // side) * grid + column // side, return_inverse=True)
    block = block.reshape(-1)
    counts = np.bincount(block)
    distance = np.abs(row % side - side // 2) + np.abs(column % side - side // 2)
    order = np.lexsort((distance, block))  # by block, the middle first; the first texel where several are as near
    middle = order[np.cumsum(counts) - counts]
    return Blocks(middle, block, counts.astype(np.float32))


def thin_out(gaussians: Gaussians, blocks: tuple[Tensor, Tensor, Tensor], lod: int) -> Gaussians:
    """Replace each block of texels by one Gaussian.

    It takes the place and frame of the block's middle texel, the mean of what can be averaged, and 2^lod times the size in the
    surface, so that the skin stays closed.

    Args:
        gaussians: All Gaussians, [N].
        blocks: `texel_blocks` as tensors like them.
        lod: Level of detail, at least 1.
    """
    middle, block, counts = blocks

    def mean(values: Tensor) -> Tensor:
        total = values.new_zeros((len(middle), *values.shape[1:])).index_add_(0, block, values)
        return total / counts.view(-1, *[1] * (values.ndim - 1))

    grow = gaussians.scales.new_tensor([1 << lod, 1 << lod, 1])
    return Gaussians(
        means=gaussians.means[middle],
        quats=gaussians.quats[middle],
        scales=mean(gaussians.scales) * grow,
        opacities=mean(gaussians.opacities),
        colors=mean(gaussians.colors),
        features=None if gaussians.features is None else mean(gaussians.features),
    )
