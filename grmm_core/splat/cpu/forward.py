"""Blending, tile by tile, compiled: the hot loop of the forward pass. The twin of `reference.blend`.

A tile keeps, block by block (see `blocks.py`), the channels blended so far (r, g, b, depth, features: WIDTH lanes each) and the
transmittance; a pixel that has ended, or lies outside the picture, has its transmittance stored with a minus sign. Features
that are wanted as means over 2 x 2 pixels only (see `draw`) take a quarter of that: a register holds four of them. A batch of
Gaussians is blended in two steps: first the weight of every Gaussian in every block that it reaches, listed by block; then, for
each block, the sums of weight times value, which stay in registers for the whole batch. Gaussians that need few channels, as
strands of hair do, are listed from a block's other end, and left out of the sums of the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rules import TILE
from .binning import BUCKETS, DIGITS, sort_by_depth
from .blocks import Four, all_ended, alpha_at, ellipse, in_lanes, make_scratch, pass_light, start_batch, whitened
from .jit import kernel, part
from .records import RECORD, VALUES
from .simd import WIDTH, any_at_least, load, spread, spread_four, store, sum_fours
from .tiling import BATCH, BLOCKS, GROUP, ONE, ROOM, ZERO, F, lane_of, padded, start_tile


@part
def _load_four(sums: np.ndarray, at: int) -> Four:
    return load(sums, at), load(sums, at + WIDTH), load(sums, at + 2 * WIDTH), load(sums, at + 3 * WIDTH)


@part
def _add_four(four: Four, weight: Any, flat: np.ndarray, at: int) -> Four:
    """Return the sums of four channels with a weight times a Gaussian's four values added."""
    a, b, c, d = four
    a = a + weight * spread(flat[at])
    b = b + weight * spread(flat[at + 1])
    c = c + weight * spread(flat[at + 2])
    d = d + weight * spread(flat[at + 3])
    return a, b, c, d


@part
def _store_four(sums: np.ndarray, at: int, four: Four) -> None:
    a, b, c, d = four
    store(sums, at, a)
    store(sums, at + WIDTH, b)
    store(sums, at + 2 * WIDTH, c)
    store(sums, at + 3 * WIDTH, d)


@part
def _add_means(four: Four, weight: Any, flat: np.ndarray, at: int) -> Four:
    """Return the sums of four groups with sums of a square's weights times a Gaussian's values added."""
    a, b, c, d = four
    a = a + weight * spread_four(flat, at)
    b = b + weight * spread_four(flat, at + GROUP)
    c = c + weight * spread_four(flat, at + 2 * GROUP)
    d = d + weight * spread_four(flat, at + 3 * GROUP)
    return a, b, c, d


@kernel
def _blend_tile(
    low: int,
    high: int,
    scene: tuple[np.ndarray, ...],
    left: float,
    top: float,
    constants: tuple[float, ...],
    few: int,
    channels: int,
    sums: np.ndarray,
    means: np.ndarray,
    through: np.ndarray,
    scratch: tuple[np.ndarray, ...],
) -> int:
    """Blend the instances low..high over the tile whose corner is left, top; return the end of those looked at.

    Arguments, besides those of `draw` and `blocks`:
        channels: How many of the values are blended for every pixel; those that follow are for squares of them.
        sums: [BLOCKS * channels * WIDTH] blended channels.
        means: [BLOCKS * groups * WIDTH] groups of four channels of squares; a lane's place in its four is its channel.
        through: [BLOCKS * WIDTH] transmittance.
    """
    values, shapes, pairs, _, weights, sources, ends, _, backs = scratch
    width = values.shape[1]
    groups = (width - channels) // GROUP
    flat = values.reshape(-1)
    lanes = in_lanes(constants)
    for batch in range(low, high, BATCH):
        if batch > low and all_ended(through):
            return batch
        end = min(batch + BATCH, high)
        listed = start_batch(batch, end, scene, left, top, through, scratch)
        for pair in range(listed):
            k, block = pairs[pair] // BLOCKS, pairs[pair] % BLOCKS
            s, q = whitened(ellipse(shapes, k), block)
            alpha = alpha_at(spread(shapes[k, RECORD.opacity]), s, q, lanes)
            weight = pass_light(through, block, alpha, lanes)
            front, back = ends[block], backs[block]
            narrow = shapes[k, RECORD.groups] <= few
            entry = back if narrow else front
            store(weights, entry * WIDTH, weight)
            sources[entry] = k * width
            used = 1 if any_at_least(weight, lanes.tiny) else 0
            ends[block] = front + (0 if narrow else used)
            backs[block] = back - (used if narrow else 0)
        for block in range(BLOCKS):
            entry_low, entry_high = block * ROOM, ends[block]
            last, back = entry_low + ROOM - 1, backs[block]
            need = width if entry_high > entry_low else few * GROUP if last > back else 0
            to = block * channels * WIDTH
            c = 0
            while c + 2 * GROUP <= channels and c < need:
                left_four, right_four = _load_four(sums, to), _load_four(sums, to + GROUP * WIDTH)
                for entry in range(entry_low, entry_high):
                    weight = load(weights, entry * WIDTH)
                    left_four = _add_four(left_four, weight, flat, sources[entry] + c)
                    right_four = _add_four(right_four, weight, flat, sources[entry] + c + GROUP)
                for entry in range(last, back if c < few * GROUP else last, -1):
                    weight = load(weights, entry * WIDTH)
                    left_four = _add_four(left_four, weight, flat, sources[entry] + c)
                    right_four = _add_four(right_four, weight, flat, sources[entry] + c + GROUP)
                _store_four(sums, to, left_four)
                _store_four(sums, to + GROUP * WIDTH, right_four)
                to += 2 * GROUP * WIDTH
                c += 2 * GROUP
            if c + GROUP <= channels and c < need:
                four = _load_four(sums, to)
                for entry in range(entry_low, entry_high):
                    four = _add_four(four, load(weights, entry * WIDTH), flat, sources[entry] + c)
                for entry in range(last, back if c < few * GROUP else last, -1):
                    four = _add_four(four, load(weights, entry * WIDTH), flat, sources[entry] + c)
                _store_four(sums, to, four)
                to += GROUP * WIDTH
                c += GROUP
            while c < channels and c < need:
                one = load(sums, to)
                for entry in range(entry_low, entry_high):
                    one = one + load(weights, entry * WIDTH) * spread(flat[sources[entry] + c])
                for entry in range(last, back if c < few * GROUP else last, -1):
                    one = one + load(weights, entry * WIDTH) * spread(flat[sources[entry] + c])
                store(sums, to, one)
                to += WIDTH
                c += 1
            to = block * groups * WIDTH
            while c + 4 * GROUP <= width and c < need:
                four = _load_four(means, to)
                for entry in range(entry_low, entry_high):
                    four = _add_means(four, sum_fours(load(weights, entry * WIDTH)), flat, sources[entry] + c)
                for entry in range(last, back if c < few * GROUP else last, -1):
                    four = _add_means(four, sum_fours(load(weights, entry * WIDTH)), flat, sources[entry] + c)
                _store_four(means, to, four)
                to += 4 * WIDTH
                c += 4 * GROUP
            while c < width and c < need:
                one = load(means, to)
                for entry in range(entry_low, entry_high):
                    one = one + sum_fours(load(weights, entry * WIDTH)) * spread_four(flat, sources[entry] + c)
                for entry in range(last, back if c < few * GROUP else last, -1):
                    one = one + sum_fours(load(weights, entry * WIDTH)) * spread_four(flat, sources[entry] + c)
                store(means, to, one)
                to += WIDTH
                c += GROUP
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
    pictures: tuple[np.ndarray, ...],
) -> None:
    """Write a blended tile's pixels to the picture."""
    rgb, alpha, depth, blended, _ = pictures
    count, width = blended.shape[2], blended.shape[1]
    out = blended.reshape(-1)
    for r in range(rows):
        y = y0 + r
        by = min(y, background.shape[0] - 1)
        for c in range(columns):
            x = x0 + c
            bx = min(x, background.shape[1] - 1)
            pixel, at = lane_of(r, c, channels)
            left = abs(through[pixel])
            for k in range(3):
                rgb[y, x, k] = sums[at + k * WIDTH] + left * background[by, bx, k]
            cover = ONE - left
            alpha[y, x] = cover
            depth[y, x] = sums[at + 3 * WIDTH] / cover if cover > ZERO else ZERO
            # Unsigned, so that the compiler need not look for negative indices.
            source, to = np.uint64(at + VALUES * WIDTH), np.uint64((y * width + x) * count)
            for _ in range(count):
                out[to] = sums[source]
                to += np.uint64(1)
                source += np.uint64(WIDTH)


@kernel
def _write_means(x0: int, y0: int, columns: int, rows: int, means: np.ndarray, halves: np.ndarray) -> None:
    """Write a blended tile's means over 2 x 2 pixels to `halves`; a last odd row or column stands alone."""
    count = halves.shape[2]
    groups = (count + GROUP - 1) // GROUP
    for r in range(0, rows, 2):
        for c in range(0, columns, 2):
            pixel, _ = lane_of(r, c, 0)
            at = pixel // WIDTH * groups * WIDTH + pixel % WIDTH
            share = ONE / F(min(2, rows - r) * min(2, columns - c))
            for k in range(count):
                halves[(y0 + r) // 2, (x0 + c) // 2, k] = means[at + k // GROUP * WIDTH + k % GROUP] * share


@kernel
def draw(
    first_tile: int,
    end_tile: int,
    tiles_x: int,
    starts: np.ndarray,
    scene: tuple[np.ndarray, ...],
    background: np.ndarray,
    constants: tuple[float, ...],
    few: int,
    pictures: tuple[np.ndarray, ...],
    ends: np.ndarray,
) -> None:
    """Sort and draw some tiles.

    Arguments by group:
        first_tile, end_tile: Which.
        tiles_x: Tiles in a row of the grid.
        starts: First instance of each tile, of `binning`.
        scene: gaussian of each instance, of `binning`, those of the tiles sorted by depth in place; geometry and whole, of
            `projection.project`; features [N, C] float32.
        background: [1, 1, 3] or [H, W, 3] float32.
        constants: CONSTANTS.
        few: Gaussians that need at most so many groups of channels are summed apart.
        pictures: Outputs, the parts of `PictureArrays`; the last features are wanted in its `halves`, as many as it has.
        ends: Output [tiles] int64: end of the instances of each tile that any pixel was still open to.
    """
    gaussian, _, whole, _ = scene
    rgb, alpha, depth, blended, halves = pictures
    height, width = alpha.shape
    groups = (halves.shape[2] + GROUP - 1) // GROUP
    channels = VALUES + blended.shape[2] if groups else padded(blended.shape[2])
    sums = np.empty(BLOCKS * channels * WIDTH, np.float32)
    means = np.empty(BLOCKS * groups * WIDTH, np.float32)
    through = np.empty(BLOCKS * WIDTH, np.float32)
    scratch = make_scratch(channels + groups * GROUP)
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
            means[:] = ZERO
            start_tile(through, columns, rows)
            corner = F(x0), F(y0)
            ends[tile] = _blend_tile(low, high, scene, *corner, constants, few, channels, sums, means, through, scratch)
            _write_tile(x0, y0, columns, rows, sums, through, channels, background, pictures)
            _write_means(x0, y0, columns, rows, means, halves)
        else:
            ends[tile] = low
            for y in range(y0, y0 + rows):
                alpha[y, x0 : x0 + columns] = ZERO
                depth[y, x0 : x0 + columns] = ZERO
                blended[y, x0 : x0 + columns] = ZERO
                for x in range(x0, x0 + columns):
                    for k in range(3):
                        rgb[y, x, k] = background[min(y, background.shape[0] - 1), min(x, background.shape[1] - 1), k]
            for y in range(y0 // 2, (y0 + rows + 1) // 2):
                halves[y, x0 // 2 : (x0 + columns + 1) // 2] = ZERO
