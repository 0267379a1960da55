"""A tile's blocks of pixels, and the steps that blending and its gradient share. Compiled.

A tile is divided into blocks of 4 x 2 or 4 x 4 pixels, which fill the lanes of `simd`. Gaussians come in batches: `gather`
copies a batch together, `find_blocks` lists the pairs of a Gaussian and a block that its ellipse reaches. The kernels then go
over pairs, without branches on what they compute, which the processor could not predict. Used by `forward.py`, `backward.py`
and `count.py`.
"""

from __future__ import annotations

import numpy as np

from ..rules import ALPHA_MAX, ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from .jit import kernel
from .projection import REACH, SQUEEZE, VALUES
from .simd import WIDTH, any_at_least, append_at_least, choose, larger, load, smaller, spread

F = np.float32
ONE, ZERO, HALF = F(1.0), F(0.0), F(0.5)
BLOCK_X, BLOCK_Y = 4, WIDTH // 4  # pixels
BLOCKS_X, BLOCKS_Y = TILE // BLOCK_X, TILE // BLOCK_Y
BLOCKS = BLOCKS_X * BLOCKS_Y
BATCH = 32  # Gaussians handled together
ROOM = BATCH + 1  # places of a block in a batch's lists: the one after the last is written too, and dropped
SHRINK = F(SQUEEZE)  # makes t in e^(-8 t) the sum of the squares of s and q
BASE = 4  # channels before the features: r, g, b, depth
GROUP = 4  # channels are padded to a multiple of this, so that loops can be unrolled

_LANE, _BLOCK = np.arange(WIDTH), np.arange(BLOCKS)
BLOCK_LEFT = (_BLOCK % BLOCKS_X * BLOCK_X).astype(np.float32)
BLOCK_TOP = (_BLOCK // BLOCKS_X * BLOCK_Y).astype(np.float32)
PIXEL_X = np.add.outer(BLOCK_LEFT, (_LANE % BLOCK_X).astype(np.float32)).reshape(-1)  # of every lane of every block
PIXEL_Y = np.add.outer(BLOCK_TOP, (_LANE // BLOCK_X).astype(np.float32)).reshape(-1)

# e^-8t = p(t)^8 with p = 1 - E1 t + E2 t^2 - ... for 0 <= t <= FARTHEST; relative error 2e-6
E1, E2, E3, E4, E5 = -0.999994755, 0.499899775, -0.166028395, 0.0398483016, -0.00588524854
FARTHEST = 0.7  # e^(-8 FARTHEST) is below ALPHA_MIN, so what is smaller need not be known

# The kernels get these as an argument: the compiler would otherwise load every one of them anew in the innermost loop.
CONSTANTS = np.array([1.0, E1, E2, E3, E4, E5, FARTHEST, ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_MIN, 0.0, 1e-30, -1.0], np.float32)


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
def padded(count: int) -> int:
    """Return the number of channels kept per block for `count` features."""
    return (BASE + count + GROUP - 1) // GROUP * GROUP


@kernel
def all_ended(through: np.ndarray) -> bool:
    """Return whether every pixel of a tile has ended; `through` [BLOCKS * WIDTH]."""
    brightest = load(through, 0)
    for b in range(1, BLOCKS):
        other = load(through, b * WIDTH)
        brightest = choose(brightest, other, brightest, other)
    return not any_at_least(brightest, spread(ZERO))


@kernel
def start_tile(through: np.ndarray, columns: int, rows: int) -> None:
    """Set the transmittance [BLOCKS * WIDTH] of a tile to one, and to ended outside its columns x rows pixels."""
    for k in range(BLOCKS * WIDTH):
        block, lane = k // WIDTH, k % WIDTH
        x = block % BLOCKS_X * BLOCK_X + lane % BLOCK_X
        y = block // BLOCKS_X * BLOCK_Y + lane // BLOCK_X
        through[k] = ONE if x < columns and y < rows else -ONE


@kernel
def gather(
    low: int,
    high: int,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    features: np.ndarray,
    values: np.ndarray,
    places: np.ndarray,
) -> None:
    """Copy the numbers of the instances low..high together; alone in a loop, so that waits for memory overlap.

    Args:
        low: First instance of a batch.
        high: Its end.
        gaussian: Gaussian of each instance.
        geometry: Of `projection.project`.
        features: [N, C].
        values: Output [BATCH, channels]: r, g, b, depth, features.
        places: Output [BATCH, VALUES]: the rest of the record.
    """
    for n in range(low, high):
        i = gaussian[n]
        k = n - low
        for c in range(VALUES):
            places[k, c] = geometry[i, c]
        for c in range(BASE):
            values[k, c] = geometry[i, VALUES + c]
        for c in range(features.shape[1]):
            values[k, BASE + c] = features[i, c]


@kernel
def find_blocks(count: int, places: np.ndarray, left: float, top: float, pairs: np.ndarray, first: np.ndarray) -> int:
    """List the blocks of a tile that each Gaussian's ellipse reaches: exactly, all blocks of the tile at a time.

    The least value of s^2 + q^2 over a block's pixel centres' box is at the box's point nearest to the centre in x with the
    best y in the box, or the other way round.

    Args:
        count: Gaussians in the batch.
        places: Of `gather`.
        left: Of the tile, pixels.
        top: Of the tile, pixels.
        pairs: Output: Gaussian * BLOCKS + block.
        first: Output [BATCH + 1]: first pair of each Gaussian.

    Returns:
        The number of pairs.
    """
    pairs_found = 0
    zero, wide, high = spread(ZERO), spread(F(BLOCK_X - 1)), spread(F(BLOCK_Y - 1))
    for k in range(count):
        first[k] = pairs_found
        mx, my = spread(places[k, 0] - left - HALF), spread(places[k, 1] - top - HALF)
        l11, l12, l22 = places[k, 2] * SHRINK, places[k, 3] * SHRINK, places[k, 4] * SHRINK
        lean_x, lean_y = spread(-l12 / l11), spread(-l11 * l12 / (l12 * l12 + l22 * l22))
        s1, s2, q2 = spread(l11), spread(l12), spread(l22)
        reach = spread(places[k, REACH])
        for group in range(0, BLOCKS, WIDTH):
            low_x, low_y = load(BLOCK_LEFT, group) - mx, load(BLOCK_TOP, group) - my
            high_x, high_y = low_x + wide, low_y + high
            near_x, near_y = larger(low_x, smaller(high_x, zero)), larger(low_y, smaller(high_y, zero))
            best_y = larger(low_y, smaller(high_y, lean_y * near_x))
            best_x = larger(low_x, smaller(high_x, lean_x * near_y))
            s, q = s1 * near_x + s2 * best_y, q2 * best_y
            one = s * s + q * q
            s, q = s1 * best_x + s2 * near_y, q2 * near_y
            pairs_found += append_at_least(pairs, pairs_found, k * BLOCKS + group, reach, smaller(one, s * s + q * q))
    first[count] = pairs_found
    return pairs_found
