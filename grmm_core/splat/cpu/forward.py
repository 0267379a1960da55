"""Blending, tile by tile, compiled: the hot loop of the forward pass. The twin of `reference.blend`.

A tile keeps, block by block (see `blocks.py`), the channels blended so far (r, g, b, depth, features: WIDTH lanes each) and the
transmittance; a pixel that has ended, or lies outside the picture, has its transmittance stored with a minus sign. A batch of
Gaussians is blended in two steps: first the weight of every Gaussian in every block that it reaches, listed by block; then, for
each block, the sums of weight times value, which stay in registers for the whole batch.
"""

from __future__ import annotations

import numpy as np

from ..rules import TILE
from .binning import BUCKETS, DIGITS, sort_by_depth
from .blocks import (
    BASE,
    BATCH,
    BLOCK_X,
    BLOCK_Y,
    BLOCKS,
    BLOCKS_X,
    HALF,
    ONE,
    PIXEL_X,
    PIXEL_Y,
    ROOM,
    SHRINK,
    ZERO,
    F,
    all_ended,
    falloff,
    find_blocks,
    gather,
    padded,
    start_tile,
)
from .jit import kernel
from .projection import VALUES
from .simd import WIDTH, any_at_least, choose, load, negative, smaller, spread, store


@kernel
def _blend_tile(
    low: int,
    high: int,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    features: np.ndarray,
    left: float,
    top: float,
    constants: np.ndarray,
    sums: np.ndarray,
    through: np.ndarray,
    values: np.ndarray,
    places: np.ndarray,
    pairs: np.ndarray,
    first: np.ndarray,
    weights: np.ndarray,
    sources: np.ndarray,
    counts: np.ndarray,
) -> int:
    """Blend the instances low..high over the tile whose corner is left, top; return the end of those looked at.

    Arrays, besides those of `draw` and `blocks`:
        sums: [BLOCKS * channels * WIDTH] blended channels.
        through: [BLOCKS * WIDTH] transmittance.
        weights: Scratch [BLOCKS * ROOM * WIDTH]: weights of a batch, by block.
        sources: Scratch [BLOCKS * ROOM] int64: where the values of each weight's Gaussian begin.
        counts: Scratch [BLOCKS] int64: end of each block's weights.
    """
    channels = values.shape[1]
    flat = values.reshape(-1)
    one, e1, e2, e3 = spread(constants[0]), spread(constants[1]), spread(constants[2]), spread(constants[3])
    e4, e5, farthest, floor = spread(constants[4]), spread(constants[5]), spread(constants[6]), spread(constants[7])
    cap, stop, zero, tiny = spread(constants[8]), spread(constants[9]), spread(constants[10]), spread(constants[11])
    for batch in range(low, high, BATCH):
        if batch > low and all_ended(through):
            return batch
        end = min(batch + BATCH, high)
        gather(batch, end, gaussian, geometry, features, values, places)
        found = find_blocks(end - batch, places, left, top, pairs, first)
        for block in range(BLOCKS):
            counts[block] = block * ROOM
        for pair in range(found):
            k, block = pairs[pair] // BLOCKS, pairs[pair] % BLOCKS
            mx, my = places[k, 0] - left - HALF, places[k, 1] - top - HALF
            l11, l12, l22 = spread(places[k, 2] * SHRINK), spread(places[k, 3] * SHRINK), spread(places[k, 4] * SHRINK)
            dx, dy = load(PIXEL_X, block * WIDTH) - spread(mx), load(PIXEL_Y, block * WIDTH) - spread(my)
            s, q = l11 * dx + l12 * dy, l22 * dy
            alpha = smaller(spread(places[k, 5]) * falloff(s * s + q * q, one, e1, e2, e3, e4, e5, farthest), cap)
            alpha = choose(alpha, floor, alpha, zero)
            before = load(through, block * WIDTH)
            after = before * (one - alpha)
            weight = choose(after, stop, alpha * before, zero)
            store(through, block * WIDTH, choose(after, stop, after, negative(before)))
            entry = counts[block]
            store(weights, entry * WIDTH, weight)
            sources[entry] = k * channels
            counts[block] = entry + (1 if any_at_least(weight, tiny) else 0)
        for block in range(BLOCKS):
            entry_low, entry_high = block * ROOM, counts[block]
            if entry_high == entry_low:
                continue
            to = block * channels * WIDTH
            c = 0
            while c + 8 <= channels:
                a0, a1, a2, a3 = load(sums, to), load(sums, to + WIDTH), load(sums, to + 2 * WIDTH), load(sums, to + 3 * WIDTH)
                a4, a5 = load(sums, to + 4 * WIDTH), load(sums, to + 5 * WIDTH)
                a6, a7 = load(sums, to + 6 * WIDTH), load(sums, to + 7 * WIDTH)
                for entry in range(entry_low, entry_high):
                    weight = load(weights, entry * WIDTH)
                    at = sources[entry] + c
                    a0 = a0 + weight * spread(flat[at])
                    a1 = a1 + weight * spread(flat[at + 1])
                    a2 = a2 + weight * spread(flat[at + 2])
                    a3 = a3 + weight * spread(flat[at + 3])
                    a4 = a4 + weight * spread(flat[at + 4])
                    a5 = a5 + weight * spread(flat[at + 5])
                    a6 = a6 + weight * spread(flat[at + 6])
                    a7 = a7 + weight * spread(flat[at + 7])
                store(sums, to, a0)
                store(sums, to + WIDTH, a1)
                store(sums, to + 2 * WIDTH, a2)
                store(sums, to + 3 * WIDTH, a3)
                store(sums, to + 4 * WIDTH, a4)
                store(sums, to + 5 * WIDTH, a5)
                store(sums, to + 6 * WIDTH, a6)
                store(sums, to + 7 * WIDTH, a7)
                to += 8 * WIDTH
                c += 8
            if c < channels:
                a0, a1, a2, a3 = load(sums, to), load(sums, to + WIDTH), load(sums, to + 2 * WIDTH), load(sums, to + 3 * WIDTH)
                for entry in range(entry_low, entry_high):
                    weight = load(weights, entry * WIDTH)
                    at = sources[entry] + c
                    a0 = a0 + weight * spread(flat[at])
                    a1 = a1 + weight * spread(flat[at + 1])
                    a2 = a2 + weight * spread(flat[at + 2])
                    a3 = a3 + weight * spread(flat[at + 3])
                store(sums, to, a0)
                store(sums, to + WIDTH, a1)
                store(sums, to + 2 * WIDTH, a2)
                store(sums, to + 3 * WIDTH, a3)
    return high


@kernel
def _write_tile(
    x0: int,
    y0: int,
    columns: int,
    rows: int,
    sums: np.ndarray,
    through: np.ndarray,
    channels: int,
    background: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
) -> None:
    """Write a blended tile's pixels to the picture."""
    count, width = blended.shape[2], blended.shape[1]
    out = blended.reshape(-1)
    for r in range(rows):
        y = y0 + r
        by = min(y, background.shape[0] - 1)
        for c in range(columns):
            x = x0 + c
            bx = min(x, background.shape[1] - 1)
            block, lane = r // BLOCK_Y * BLOCKS_X + c // BLOCK_X, r % BLOCK_Y * BLOCK_X + c % BLOCK_X
            left = abs(through[block * WIDTH + lane])
            at = block * channels * WIDTH + lane
            for k in range(3):
                rgb[y, x, k] = sums[at + k * WIDTH] + left * background[by, bx, k]
            cover = ONE - left
            alpha[y, x] = cover
            depth[y, x] = sums[at + 3 * WIDTH] / cover if cover > ZERO else ZERO
            # Unsigned, so that the compiler need not look for negative indices.
            source, to = np.uint64(at + BASE * WIDTH), np.uint64((y * width + x) * count)
            for _ in range(count):
                out[to] = sums[source]
                to += np.uint64(1)
                source += np.uint64(WIDTH)


@kernel
def draw(
    first_tile: int,
    end_tile: int,
    tiles_x: int,
    starts: np.ndarray,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
    constants: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Sort and draw some tiles.

    Arguments by group:
        first_tile, end_tile: Which.
        tiles_x: Tiles in a row of the grid.
        starts, gaussian: Instances, of `binning`; those of the tiles are sorted by depth in place.
        geometry, whole: Of `projection.project`.
        features: [N, C] float32.
        background: [1, 1, 3] or [H, W, 3] float32.
        constants: CONSTANTS.
        rgb, alpha, depth, blended: Outputs [H, W, 3], [H, W], [H, W], [H, W, C] float32.
        ends: Output [tiles] int64: end of the instances of each tile that any pixel was still open to.
    """
    height, width = alpha.shape
    channels = padded(features.shape[1])
    sums = np.empty(BLOCKS * channels * WIDTH, np.float32)
    through = np.empty(BLOCKS * WIDTH, np.float32)
    values = np.zeros((BATCH, channels), np.float32)
    places = np.empty((BATCH, VALUES), np.float32)
    pairs = np.empty((BATCH + 1) * BLOCKS, np.int32)
    first = np.empty(BATCH + 1, np.int64)
    weights = np.empty(ROOM * BLOCKS * WIDTH, np.float32)
    sources = np.empty(ROOM * BLOCKS, np.int64)
    counts = np.empty(BLOCKS, np.int64)
    most = 0
    for tile in range(first_tile, end_tile):
        most = max(most, starts[tile + 1] - starts[tile])
    keys = np.empty((2, most), np.int32)
    spare = np.empty(most, np.int32)
    histogram = np.empty((DIGITS, BUCKETS), np.int32)
    for tile in range(first_tile, end_tile):
        x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        columns, rows = min(TILE, width - x0), min(TILE, height - y0)
        low, high = starts[tile], starts[tile + 1]
        if high > low:
            sort_by_depth(gaussian[low:high], whole, keys, spare, histogram)
            sums[:] = ZERO
            start_tile(through, columns, rows)
            ends[tile] = _blend_tile(
                low,
                high,
                gaussian,
                geometry,
                features,
                F(x0),
                F(y0),
                constants,
                sums,
                through,
                values,
                places,
                pairs,
                first,
                weights,
                sources,
                counts,
            )
            _write_tile(x0, y0, columns, rows, sums, through, channels, background, rgb, alpha, depth, blended)
        else:
            ends[tile] = low
            for y in range(y0, y0 + rows):
                alpha[y, x0 : x0 + columns] = ZERO
                depth[y, x0 : x0 + columns] = ZERO
                blended[y, x0 : x0 + columns] = ZERO
                for x in range(x0, x0 + columns):
                    for k in range(3):
                        rgb[y, x, k] = background[min(y, background.shape[0] - 1), min(x, background.shape[1] - 1), k]
