"""Levels of detail: one larger Gaussian in the place of a block of texels.

Level 0 is every Gaussian; each further level has about a quarter of them. Needs numpy only; `thin_out` takes tensors as well.
Used by sessions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..geometry.libraries import Array, as_like, library_of, zeros
from ..geometry.rotations import quaternion_to_matrix
from ..splat.types import Gaussians

CLOSING = 4.0  # over the variance of a block's texels, which alone leaves gaps between blocks
_LEAST = 1e-4  # of an opacity; keeps the means of hidden texels defined


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


def thin_out(gaussians: Gaussians, blocks: Blocks, lod: int) -> Gaussians:
    """Replace each block of texels by one Gaussian.

    It has the axes of the block's middle texel, and the mean of what can be averaged, in which texels count by their opacity.
    Its variance in the surface is a texel's and `CLOSING` times that of the texels' places, so that the skin stays closed and
    little stands out beside a curved one; it is never wider than 2^lod texels, whatever lies in the block beyond a seam.

    Args:
        gaussians: All Gaussians, [N].
        blocks: Of `texel_blocks`.
        lod: Level of detail, at least 1.
    """
    order = np.argsort(blocks.block, kind="stable")
    ends = np.cumsum(blocks.counts).astype(np.int64)
    library = library_of(gaussians.means)
    weights = library.clip(gaussians.opacities, _LEAST, None)
    total = _block_sums(weights, order, ends)

    def mean(values: Array) -> Array:
        columns = (-1, *[1] * (values.ndim - 1))
        result: Array = _block_sums(values * weights.reshape(columns), order, ends) / total.reshape(columns)
        return result

    means, scales, quats = mean(gaussians.means), mean(gaussians.scales), gaussians.quats[blocks.middle]
    axes = quaternion_to_matrix(quats)  # its columns
    offsets = gaussians.means - means[blocks.block]
    apart = CLOSING * mean((offsets[:, :, None] * axes[blocks.block]).sum(1)[:, :2] ** 2)
    flat = (scales[:, :2] ** 2 + library.minimum(apart, (4**lod - 1) * scales[:, :2] ** 2)) ** 0.5
    return Gaussians(
        means=means,
        quats=quats,
        scales=library.concatenate([flat, scales[:, 2:]], -1),
        opacities=_block_sums(gaussians.opacities, order, ends) / as_like(blocks.counts, total),
        colors=mean(gaussians.colors),
        features=None if gaussians.features is None else mean(gaussians.features),
    )


def _block_sums(values: Array, order: np.ndarray, ends: np.ndarray) -> Array:
    """Sums of runs of `values` [N, ...] in an order, each up to one of the ends: [M, ...]."""
    if isinstance(values, np.ndarray):
        return np.add.reduceat(values[order], np.concatenate([[0], ends[:-1]]), axis=0)
    import torch

    block = torch.as_tensor(np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0)), device=values.device)
    return zeros((len(ends), *values.shape[1:]), values).index_add_(0, block, values[order])
