"""Counts of the work that a drawing took, for `grmm bench`: what was computed, and what no rasteriser could leave out.

Plain loops over the lists that `forward.draw` left; not used for drawing. Imports numba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..rules import ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from .blocks import OPEN, find_blocks, place_on
from .jit import kernel
from .records import RECORD, SHAPE, SQUEEZE
from .simd import WIDTH
from .tiling import BATCH, BLOCK_X, BLOCK_Y, BLOCKS, BLOCKS_X

if TYPE_CHECKING:
    from .drawing import Drawing

F = np.float32


@dataclass(frozen=True)
class Work:
    """What drawing one picture took.

    Attributes:
        gaussians: Gaussians that can be seen.
        instances: Pairs of a Gaussian and a tile that it may touch.
        evaluated: Pairs of a pixel and a Gaussian whose alpha was computed (all lanes of all blocks visited).
        blended: Evaluations in blocks where at least one pixel blends: all channels are summed there.
        needed: Pairs of a pixel and a Gaussian that is blended into it: the rules of 3DGS leave none of them out.
    """

    gaussians: int
    instances: int
    evaluated: int
    blended: int
    needed: int


def count_work(drawing: Drawing, width: int, height: int) -> Work:
    """Count the work behind a drawing of `drawing.draw`.

    Args:
        drawing: What `draw` returned beside the pictures.
        width: Pixels.
        height: Pixels.
    """
    blocks, busy, needed = _count(
        drawing.starts, drawing.ends, drawing.gaussian, drawing.geometry, drawing.tiles_x, width, height
    )
    seen = int(np.count_nonzero(drawing.whole[:, RECORD.touched]))
    return Work(seen, len(drawing.gaussian), blocks * WIDTH, busy * WIDTH, needed)


@kernel
def _count(
    starts: np.ndarray, ends: np.ndarray, gaussian: np.ndarray, geometry: np.ndarray, tiles_x: int, width: int, height: int
) -> tuple[int, int, int]:
    """Return blocks visited, blocks with a blended pixel, and pixels blended, over all instances."""
    blocks, busy, needed = 0, 0, 0
    through = np.empty((TILE, TILE), np.float32)
    place = np.empty((1, SHAPE), np.float32)
    pairs = np.empty((BATCH + 1) * BLOCKS, np.int32)
    first = np.empty(BATCH + 1, np.int64)
    limits = np.full(BLOCKS, OPEN, np.float32)
    for tile in range(ends.shape[0]):
        x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        for y in range(TILE):
            for x in range(TILE):
                through[y, x] = F(1.0) if x0 + x < width and y0 + y < height else F(-1.0)
        for n in range(starts[tile], ends[tile]):
            place[0, :] = geometry[gaussian[n], :SHAPE]
            place_on(place, 0, F(x0), F(y0))
            mx, my = place[0, RECORD.x], place[0, RECORD.y]
            found = find_blocks(1, place, limits, pairs, first)
            for pair in range(found):
                block, here = pairs[pair], 0
                left, top = block % BLOCKS_X * BLOCK_X, block // BLOCKS_X * BLOCK_Y
                for y in range(top, top + BLOCK_Y):
                    for x in range(left, left + BLOCK_X):
                        s = place[0, RECORD.l11] * (F(x) - mx) + place[0, RECORD.l12] * (F(y) - my)
                        q = place[0, RECORD.l22] * (F(y) - my)
                        alpha = place[0, RECORD.opacity] * np.exp(F(-0.5 / SQUEEZE**2) * (s * s + q * q))
                        if alpha < ALPHA_MIN or through[y, x] < 0:
                            continue
                        after = through[y, x] * (F(1.0) - alpha)
                        through[y, x] = after if after >= TRANSMITTANCE_MIN else F(-1.0)
                        here += 1
                blocks += 1
                busy += 1 if here else 0
                needed += here
    return blocks, busy, needed
