"""How a tile is divided: blocks of 4 x 2 or 4 x 4 pixels, which fill the lanes of `simd`, and batches of Gaussians.

Four lanes in a row are 2 x 2 pixels, so that means over these are sums of neighbours.
"""

from __future__ import annotations

import numpy as np

from ..rules import TILE
from .jit import kernel, part
from .records import VALUES
from .simd import WIDTH

F = np.float32
ONE, ZERO, HALF = F(1.0), F(0.0), F(0.5)
BLOCK_X, BLOCK_Y = 4, WIDTH // 4  # pixels
QUAD = 4  # pixels of a square of 2 x 2
BLOCKS_X, BLOCKS_Y = TILE // BLOCK_X, TILE // BLOCK_Y
BLOCKS = BLOCKS_X * BLOCKS_Y
BATCH = 32  # Gaussians handled together
ROOM = BATCH + 1  # places of a block in a batch's lists: the one after the last is written too, and dropped
GROUP = 4  # channels are padded to a multiple of this, so that loops can be unrolled

_LANE, _BLOCK = np.arange(WIDTH), np.arange(BLOCKS)
BLOCK_LEFT = (_BLOCK % BLOCKS_X * BLOCK_X).astype(np.float32)
BLOCK_TOP = (_BLOCK // BLOCKS_X * BLOCK_Y).astype(np.float32)
_LANE_X, _LANE_Y = _LANE // QUAD % 2 * 2 + _LANE % 2, _LANE // (2 * QUAD) * 2 + _LANE // 2 % 2
PIXEL_X = np.add.outer(BLOCK_LEFT, _LANE_X.astype(np.float32)).reshape(-1)  # of every lane of every block
PIXEL_Y = np.add.outer(BLOCK_TOP, _LANE_Y.astype(np.float32)).reshape(-1)


@part
def lane_of(row: int, column: int, channels: int) -> tuple[int, int]:
    """Return where a tile's pixel is in one number per pixel, and in `channels` numbers per pixel."""
    block, quad = row // BLOCK_Y * BLOCKS_X + column // BLOCK_X, row % BLOCK_Y // 2 * 2 + column % BLOCK_X // 2
    lane = quad * QUAD + row % 2 * 2 + column % 2
    return block * WIDTH + lane, block * channels * WIDTH + lane


@kernel
def padded(count: int) -> int:
    """Return the number of channels kept per block for `count` features."""
    return (VALUES + count + GROUP - 1) // GROUP * GROUP


@kernel
def start_tile(through: np.ndarray, columns: int, rows: int) -> None:
    """Set the transmittance [BLOCKS * WIDTH] of a tile to one, and to ended outside its columns x rows pixels."""
    for k in range(BLOCKS * WIDTH):
        block, lane = k // WIDTH, k % WIDTH
        x = block % BLOCKS_X * BLOCK_X + lane // QUAD % 2 * 2 + lane % 2
        y = block // BLOCKS_X * BLOCK_Y + lane // (2 * QUAD) * 2 + lane // 2 % 2
        through[k] = ONE if x < columns and y < rows else -ONE
