"""Blending, tile by tile, compiled: the hot loop of the forward pass. The twin of `reference.blend`.

A tile is divided into blocks of 4 x 2 pixels, which fill the eight lanes of `simd`. It keeps, block by block, the channels blended
so far (r, g, b, depth, features: eight lanes each) and the transmittance; a pixel that has ended, or lies outside the picture, has
its transmittance stored with a minus sign. Gaussians come front to back; each visits the blocks that its bounding box touches.
"""

from __future__ import annotations

import math

import numpy as np

from ..rules import ALPHA_MAX, ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from .binning import BUCKETS, DIGITS, sort_by_depth
from .jit import kernel
from .projection import VALUES
from .simd import WIDTH, any_at_least, choose, load, negative, spread, store

F = np.float32
ONE, ZERO, HALF = F(1.0), F(0.0), F(0.5)
CAP, FLOOR, STOP = F(ALPHA_MAX), F(ALPHA_MIN), F(TRANSMITTANCE_MIN)
LOWEST = F(-5.6)  # e^LOWEST is below ALPHA_MIN, so what is smaller need not be known
TINY = F(1e-30)
BLOCK_X, BLOCK_Y = 4, 2  # pixels
BLOCKS_X, BLOCKS_Y = TILE // BLOCK_X, TILE // BLOCK_Y
BLOCKS = BLOCKS_X * BLOCKS_Y
LANE_X = (np.arange(WIDTH) % BLOCK_X).astype(np.float32)
LANE_Y = (np.arange(WIDTH) // BLOCK_X).astype(np.float32)
CHECK = 16  # Gaussians between two looks at whether all pixels of the tile have ended
BASE = 4  # channels before the features: r, g, b, depth
GROUP = 4  # channels are padded to a multiple of this, so that loops can be unrolled

# e^x = p(x / 8)^8 with p = 1 + E1 x/8 + E2 (x/8)^2 ... on LOWEST..0; relative error 2e-6
E1, E2, E3, E4, E5 = F(0.999994755), F(0.499899775), F(0.166028395), F(0.0398483016), F(0.00588524854)
EIGHTH = F(0.125)


@kernel
def falloff(s, q):  # noqa: ANN001, ANN201 - Lanes have no Python type
    """Return e^(-(s^2 + q^2) / 2) in each lane; never less than e^LOWEST."""
    x = (s * s + q * q) * spread(-HALF * EIGHTH)
    lowest = spread(LOWEST * EIGHTH)
    x = choose(x, lowest, x, lowest)
    p = spread(ONE) + x * (spread(E1) + x * (spread(E2) + x * (spread(E3) + x * (spread(E4) + x * spread(E5)))))
    p = p * p
    p = p * p
    return p * p


@kernel
def block_range(centre: float, half: float, size: int, blocks: int) -> tuple[int, int]:
    """Return the blocks, first and end, of `size` pixels each, whose pixel centres may lie within `half` of `centre` (pixel
    k of the tile has its centre at k).
    """
    edge = F(blocks * size - 1)
    first = int(math.ceil(min(max(centre - half, ZERO), edge + ONE)))
    last = int(math.floor(max(min(centre + half, edge), -ONE)))
    return first // size, (last + size) // size


@kernel
def all_ended(through: np.ndarray) -> bool:
    """Return whether every pixel of a tile has ended; `through` [BLOCKS * 8]."""
    brightest = load(through, 0)
    for b in range(1, BLOCKS):
        other = load(through, b * WIDTH)
        brightest = choose(brightest, other, brightest, other)
    return not any_at_least(brightest, spread(ZERO))


@kernel
def _blend_tile(
    low: int,
    high: int,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    features: np.ndarray,
    left_edge: float,
    top_edge: float,
    sums: np.ndarray,
    through: np.ndarray,
    value: np.ndarray,
) -> int:
    """Blend the instances low..high over one tile; return the end of those that were looked at.

    Args:
        sums: [BLOCKS * channels * 8] blended channels.
        through: [BLOCKS * 8] transmittance.
        value: Scratch [channels].
    """
    channels = value.shape[0]
    floor, stop, cap, one, zero = spread(FLOOR), spread(STOP), spread(CAP), spread(ONE), spread(ZERO)
    tiny = spread(TINY)
    lane_x, lane_y = load(LANE_X, 0), load(LANE_Y, 0)
    for n in range(low, high):
        if (n - low) % CHECK == CHECK - 1 and all_ended(through):
            return n
        i = gaussian[n]
        record = geometry[i]
        mx, my = record[0] - left_edge - HALF, record[1] - top_edge - HALF  # pixel k of the tile is at coordinate k
        l11, l12, l22, opacity = spread(record[2]), spread(record[3]), spread(record[4]), spread(record[5])
        first_x, end_x = block_range(mx, record[6], BLOCK_X, BLOCKS_X)
        first_y, end_y = block_range(my, record[7], BLOCK_Y, BLOCKS_Y)
        for c in range(BASE):
            value[c] = record[VALUES + c]
        for c in range(features.shape[1]):
            value[BASE + c] = features[i, c]
        for by in range(first_y, end_y):
            dy = lane_y + spread(F(by * BLOCK_Y) - my)
            q = l22 * dy
            shear = l12 * dy
            for bx in range(first_x, end_x):
                s = l11 * (lane_x + spread(F(bx * BLOCK_X) - mx)) + shear
                alpha = opacity * falloff(s, q)
                if not any_at_least(alpha, floor):
                    continue
                alpha = choose(alpha, floor, choose(alpha, cap, cap, alpha), zero)
                block = by * BLOCKS_X + bx
                before = load(through, block * WIDTH)
                after = before * (one - alpha)
                weight = choose(after, stop, alpha * before, zero)
                store(through, block * WIDTH, choose(after, stop, after, negative(before)))
                if not any_at_least(weight, tiny):
                    continue
                at = block * channels * WIDTH
                for c in range(channels):
                    store(sums, at + c * WIDTH, load(sums, at + c * WIDTH) + weight * spread(value[c]))
    return high


@kernel
def start_tile(through: np.ndarray, columns: int, rows: int) -> None:
    """Set the transmittance [BLOCKS * 8] of a tile to one, and to ended outside its columns x rows pixels of the picture."""
    for k in range(BLOCKS * WIDTH):
        block, lane = k // WIDTH, k % WIDTH
        x = block % BLOCKS_X * BLOCK_X + lane % BLOCK_X
        y = block // BLOCKS_X * BLOCK_Y + lane // BLOCK_X
        through[k] = ONE if x < columns and y < rows else -ONE


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
    for r in range(rows):
        y = y0 + r
        by = min(y, background.shape[0] - 1)
        for c in range(columns):
            x = x0 + c
            bx = min(x, background.shape[1] - 1)
            block, lane = r // BLOCK_Y * BLOCKS_X + c // BLOCK_X, r % BLOCK_Y * BLOCK_X + c % BLOCK_X
            left = abs(through[block * WIDTH + lane])
            pixel = sums[block * channels * WIDTH + lane :]
            for k in range(3):
                rgb[y, x, k] = pixel[k * WIDTH] + left * background[by, bx, k]
            cover = ONE - left
            alpha[y, x] = cover
            depth[y, x] = pixel[3 * WIDTH] / cover if cover > ZERO else ZERO
            for k in range(blended.shape[2]):
                blended[y, x, k] = pixel[(BASE + k) * WIDTH]


@kernel
def padded(count: int) -> int:
    """Return the number of channels kept per block for `count` features."""
    return (BASE + count + GROUP - 1) // GROUP * GROUP


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
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Sort and draw some tiles.

    Args:
        first_tile, end_tile: Which.
        tiles_x: Tiles in a row of the grid.
        starts, gaussian: Instances, of `binning`; those of the tiles are sorted by depth in place.
        geometry, whole: Of `projection.project`.
        features: [N, C] float32.
        background: [1, 1, 3] or [H, W, 3] float32.
        rgb, alpha, depth, blended: Outputs [H, W, 3], [H, W], [H, W], [H, W, C] float32, zero on entry.
        ends: Output [tiles] int64: end of the instances of each tile that any pixel was still open to.
    """
    height, width = alpha.shape
    channels = padded(features.shape[1])
    sums = np.empty(BLOCKS * channels * WIDTH, np.float32)
    through = np.empty(BLOCKS * WIDTH, np.float32)
    value = np.zeros(channels, np.float32)
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
            ends[tile] = _blend_tile(low, high, gaussian, geometry, features, F(x0), F(y0), sums, through, value)
            _write_tile(x0, y0, columns, rows, sums, through, channels, background, rgb, alpha, depth, blended)
        else:
            ends[tile] = low
            for y in range(y0, y0 + rows):
                for x in range(x0, x0 + columns):
                    for k in range(3):
                        rgb[y, x, k] = background[min(y, background.shape[0] - 1), min(x, background.shape[1] - 1), k]
