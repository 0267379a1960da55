"""Blending, tile by tile, compiled: the hot loop of the forward pass. The twin of `reference.blend`.

A tile is divided into blocks of 4 x 2 or 4 x 4 pixels, which fill the lanes of `simd`. It keeps, block by block, the channels
blended so far (r, g, b, depth, features: WIDTH lanes each) and the transmittance; a pixel that has ended, or lies outside the
picture, has its transmittance stored with a minus sign. Gaussians come front to back; each visits the blocks that its bounding
box touches.
"""

from __future__ import annotations

import math

import numpy as np

from ..rules import ALPHA_MAX, ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from .binning import BUCKETS, DIGITS, sort_by_depth
from .jit import kernel
from .projection import SQUEEZE, VALUES
from .simd import WIDTH, any_at_least, choose, load, negative, smaller, spread, store

F = np.float32
ONE, ZERO, HALF = F(1.0), F(0.0), F(0.5)
BLOCK_X, BLOCK_Y = 4, WIDTH // 4  # pixels
BLOCKS_X, BLOCKS_Y = TILE // BLOCK_X, TILE // BLOCK_Y
BLOCKS = BLOCKS_X * BLOCKS_Y
LANE_X = (np.arange(WIDTH) % BLOCK_X).astype(np.float32)
LANE_Y = (np.arange(WIDTH) // BLOCK_X).astype(np.float32)
BATCH = 16  # Gaussians blended together; between batches it is seen whether all pixels of the tile have ended
SHRINK = F(SQUEEZE)  # makes t in e^(-8 t) the sum of the squares of s and q
BASE = 4  # channels before the features: r, g, b, depth
GROUP = 4  # channels are padded to a multiple of this, so that loops can be unrolled

# e^-8t = p(t)^8 with p = 1 - E1 t + E2 t^2 - ... for 0 <= t <= FARTHEST; relative error 2e-6
E1, E2, E3, E4, E5 = -0.999994755, 0.499899775, -0.166028395, 0.0398483016, -0.00588524854
FARTHEST = 0.7  # e^(-8 FARTHEST) is below ALPHA_MIN, so what is smaller need not be known

# The kernels get these as an argument: the compiler would otherwise load every one of them anew in the innermost loop.
CONSTANTS = np.array([1.0, E1, E2, E3, E4, E5, FARTHEST, ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_MIN, 0.0, 1e-30], np.float32)


@kernel
def falloff(t, one, e1, e2, e3, e4, e5, farthest):  # noqa: ANN001, ANN201 - Lanes have no Python type
    """Return e^(-8 t) in each lane, not less than e^(-8 farthest); the others are the constants above."""
    t = smaller(t, farthest)
    tt = t * t
    p = (one + t * e1) + tt * ((e2 + t * e3) + tt * (e4 + t * e5))
    p = p * p
    p = p * p
    return p * p


@kernel
def block_range(centre: float, half: float, size: int, blocks: int) -> tuple[int, int]:
    """Return the blocks, first and end, of `size` pixels each, that have pixels within `half` of `centre` (pixel k is at k)."""
    edge = F(blocks * size - 1)
    first = math.ceil(min(max(centre - half, ZERO), edge + ONE))
    last = math.floor(max(min(centre + half, edge), -ONE))
    return first // size, (last + size) // size


@kernel
def all_ended(through: np.ndarray) -> bool:
    """Return whether every pixel of a tile has ended; `through` [BLOCKS * WIDTH]."""
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
    constants: np.ndarray,
    sums: np.ndarray,
    through: np.ndarray,
    values: np.ndarray,
    weights: np.ndarray,
    places: np.ndarray,
) -> int:
    """Blend the instances low..high over the tile whose corner is left_edge, top_edge; return the end of those looked at.

    In batches, in two steps, neither of which branches on computed covers, which the processor could not predict: first the
    weight of every Gaussian in every block that it touches, then the sums of weight times value.

    Arrays, besides those of `draw`:
        sums: [BLOCKS * channels * WIDTH] blended channels.
        through: [BLOCKS * WIDTH] transmittance.
        values: Scratch [BATCH, channels].
        weights: Scratch [BATCH * BLOCKS * WIDTH].
        places: Scratch [BATCH * BLOCKS] int64: of each entry of `weights`, the position of the sums << 32 | that of the values.
    """
    channels = values.shape[1]
    flat = values.reshape(-1)
    one, e1, e2, e3 = spread(constants[0]), spread(constants[1]), spread(constants[2]), spread(constants[3])
    e4, e5, farthest, floor = spread(constants[4]), spread(constants[5]), spread(constants[6]), spread(constants[7])
    cap, stop, zero, tiny = spread(constants[8]), spread(constants[9]), spread(constants[10]), spread(constants[11])
    lane_x, lane_y = load(LANE_X, 0), load(LANE_Y, 0)
    four, block_height = spread(F(BLOCK_X)), spread(F(BLOCK_Y))
    step = np.int64(channels * WIDTH) << 32
    for batch in range(low, high, BATCH):
        if batch > low and all_ended(through):
            return batch
        entries = 0
        for n in range(batch, min(batch + BATCH, high)):
            i = gaussian[n]
            record = geometry[i]
            mx, my = record[0] - left_edge - HALF, record[1] - top_edge - HALF  # pixel k of the tile is at k
            l11, l12, l22 = spread(record[2] * SHRINK), spread(record[3] * SHRINK), spread(record[4] * SHRINK)
            opacity = spread(record[5])
            first_x, end_x = block_range(mx, record[6], BLOCK_X, BLOCKS_X)
            first_y, end_y = block_range(my, record[7], BLOCK_Y, BLOCKS_Y)
            at = (n - batch) * channels
            for c in range(BASE):
                flat[at + c] = record[VALUES + c]
            for c in range(features.shape[1]):
                flat[at + BASE + c] = features[i, c]
            place = np.int64((first_y * BLOCKS_X + first_x) * channels * WIDTH) << 32 | at
            dx = lane_x + spread(F(first_x * BLOCK_X) - mx)
            dy = lane_y + spread(F(first_y * BLOCK_Y) - my)
            s_row, q = l11 * dx + l12 * dy, l22 * dy
            right, down_s, down_q = four * l11, block_height * l12, block_height * l22
            for row in range(first_y * BLOCKS_X, end_y * BLOCKS_X, BLOCKS_X):
                qq = q * q
                s = s_row
                here = place
                for block in range(row + first_x, row + end_x):
                    alpha = smaller(opacity * falloff(s * s + qq, one, e1, e2, e3, e4, e5, farthest), cap)
                    s = s + right
                    alpha = choose(alpha, floor, alpha, zero)
                    before = load(through, block * WIDTH)
                    after = before * (one - alpha)
                    weight = choose(after, stop, alpha * before, zero)
                    store(through, block * WIDTH, choose(after, stop, after, negative(before)))
                    store(weights, entries * WIDTH, weight)
                    places[np.uint64(entries)] = here
                    entries += 1 if any_at_least(weight, tiny) else 0
                    here += step
                s_row = s_row + down_s
                q = q + down_q
                place += BLOCKS_X * step
        for entry in range(entries):
            weight = load(weights, entry * WIDTH)
            place = places[entry]
            to, at = place >> 32, place & 0xFFFFFFFF
            for c in range(0, channels, GROUP):
                here = to + c * WIDTH
                store(sums, here, load(sums, here) + weight * spread(flat[at + c]))
                store(sums, here + WIDTH, load(sums, here + WIDTH) + weight * spread(flat[at + c + 1]))
                store(sums, here + 2 * WIDTH, load(sums, here + 2 * WIDTH) + weight * spread(flat[at + c + 2]))
                store(sums, here + 3 * WIDTH, load(sums, here + 3 * WIDTH) + weight * spread(flat[at + c + 3]))
    return high


@kernel
def start_tile(through: np.ndarray, columns: int, rows: int) -> None:
    """Set the transmittance [BLOCKS * WIDTH] of a tile to one, and to ended outside its columns x rows pixels."""
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
        rgb, alpha, depth, blended: Outputs [H, W, 3], [H, W], [H, W], [H, W, C] float32, zero on entry.
        ends: Output [tiles] int64: end of the instances of each tile that any pixel was still open to.
    """
    height, width = alpha.shape
    channels = padded(features.shape[1])
    sums = np.empty(BLOCKS * channels * WIDTH, np.float32)
    through = np.empty(BLOCKS * WIDTH, np.float32)
    values = np.zeros((BATCH, channels), np.float32)
    weights = np.empty(BATCH * BLOCKS * WIDTH, np.float32)
    places = np.empty(BATCH * BLOCKS, np.int64)
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
                low, high, gaussian, geometry, features, F(x0), F(y0), constants, sums, through, values, weights, places
            )
            _write_tile(x0, y0, columns, rows, sums, through, channels, background, rgb, alpha, depth, blended)
        else:
            ends[tile] = low
            for y in range(y0, y0 + rows):
                for x in range(x0, x0 + columns):
                    for k in range(3):
                        rgb[y, x, k] = background[min(y, background.shape[0] - 1), min(x, background.shape[1] - 1), k]
