"""The steps on a tile that blending and its gradient share. Compiled.

Gaussians come in batches: `gather` copies a batch together, `find_blocks` lists the pairs of a Gaussian and a block of pixels
that its ellipse reaches. The kernels then go over pairs, without branches on what they compute, which the processor could not
predict. Used by `forward.py`, `backward.py` and `count.py`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..rules import ALPHA_MIN, TRANSMITTANCE_MIN
from .jit import kernel, part
from .records import RECORD, RECORD_LENGTH, SHAPE, SQUEEZE, VALUES
from .simd import WIDTH, any_at_least, append_at_least, choose, copy_four, larger, load, smaller, spread, store
from .tiling import (
    BATCH,
    BLOCK_LEFT,
    BLOCK_TOP,
    BLOCK_X,
    BLOCK_Y,
    BLOCKS,
    HALF,
    ONE,
    PIXEL_X,
    PIXEL_Y,
    ROOM,
    ZERO,
    F,
)

OPEN, CLOSED = F(1e30), F(-1.0)  # reach that is left to Gaussians in a block
SHRINK = F(SQUEEZE)  # makes t in e^(-8 t) the sum of the squares of s and q
Four: TypeAlias = tuple[Any, Any, Any, Any]
"""Lanes of four channels."""


class Constants(NamedTuple):
    """Numbers of the innermost loops, inside kernels each in all lanes.

    Attributes:
        zero, one: 0 and 1.
        tiny: 1e-30, what counts as more than nothing.
        ended: Transmittance of a pixel that has ended: less than nothing, and nothing beside what can be seen.
        alpha_min, transmittance_min: Of `rules`.
        e1, e2, e3, e4, e5, farthest: e^-8t = (1 + e1 t + e2 t^2 + ...)^8 for 0 <= t <= farthest; relative error 2e-6.
    """

    zero: Any
    one: Any
    tiny: Any
    ended: Any
    alpha_min: Any
    transmittance_min: Any
    e1: Any
    e2: Any
    e3: Any
    e4: Any
    e5: Any
    farthest: Any


# The kernels get these as an argument: the compiler would otherwise load every one of them anew in the innermost loop.
CONSTANTS = tuple(
    Constants(
        zero=ZERO,
        one=ONE,
        tiny=F(1e-30),
        ended=F(-1e-30),
        alpha_min=F(ALPHA_MIN),
        transmittance_min=F(TRANSMITTANCE_MIN),
        e1=F(-0.999994755),
        e2=F(0.499899775),
        e3=F(-0.166028395),
        e4=F(0.0398483016),
        e5=F(-0.00588524854),
        farthest=F(0.7),  # e^(-8 farthest) is below ALPHA_MIN, so what is smaller need not be known
    )
)


@part
def in_lanes(constants: tuple[float, ...]) -> Constants:
    """Return CONSTANTS with each one in all lanes."""
    zero, one, tiny, ended, alpha_min, transmittance_min, e1, e2, e3, e4, e5, farthest = constants
    return Constants(
        spread(zero), spread(one), spread(tiny), spread(ended),
        spread(alpha_min), spread(transmittance_min),
        spread(e1), spread(e2), spread(e3), spread(e4), spread(e5), spread(farthest),
    )  # fmt: skip


class Ellipse(NamedTuple):
    """A Gaussian on a tile, in lanes; see `place_on`."""

    x: Any
    y: Any
    l11: Any
    l12: Any
    l22: Any


@part
def place_on(shapes: np.ndarray, k: int, left: float, top: float) -> None:
    """Change row k of `shapes` [K, SHAPE], the beginning of a record, to what it is on the tile with the corner left, top.

    Its centre then counts from the tile's first pixel centre, and its Cholesky factor is squeezed.
    """
    shapes[k, RECORD.x] -= left + HALF
    shapes[k, RECORD.y] -= top + HALF
    shapes[k, RECORD.l11] *= SHRINK
    shapes[k, RECORD.l12] *= SHRINK
    shapes[k, RECORD.l22] *= SHRINK


@part
def ellipse(shapes: np.ndarray, k: int) -> Ellipse:
    """Return Gaussian k of a batch's `shapes`."""
    return Ellipse(
        spread(shapes[k, RECORD.x]),
        spread(shapes[k, RECORD.y]),
        spread(shapes[k, RECORD.l11]),
        spread(shapes[k, RECORD.l12]),
        spread(shapes[k, RECORD.l22]),
    )


@part
def whitened(shape: Ellipse, block: int) -> tuple[Any, Any]:
    """Return s and q of an `Ellipse` at a block's pixels."""
    dx, dy = load(PIXEL_X, block * WIDTH) - shape.x, load(PIXEL_Y, block * WIDTH) - shape.y
    return shape.l11 * dx + shape.l12 * dy, shape.l22 * dy


@part
def alpha_at(opacity: Any, s: Any, q: Any, lanes: Constants) -> Any:
    """Return alpha in each lane, zero where it is below its threshold."""
    t = smaller(s * s + q * q, lanes.farthest)
    tt = t * t
    p = (lanes.one + t * lanes.e1) + tt * ((lanes.e2 + t * lanes.e3) + tt * (lanes.e4 + t * lanes.e5))
    p = p * p
    p = p * p
    alpha = opacity * (p * p)
    return choose(alpha, lanes.alpha_min, alpha, lanes.zero)


@part
def pass_light(through: np.ndarray, block: int, alpha: Any, lanes: Constants) -> Any:
    """Take a Gaussian's alpha from a block's transmittance; return its weight, zero in pixels that have ended before."""
    before = load(through, block * WIDTH)
    after = before * (lanes.one - alpha)
    store(through, block * WIDTH, choose(after, lanes.transmittance_min, after, lanes.ended))
    return choose(after, lanes.transmittance_min, alpha * before, larger(before, lanes.zero))


@part
def make_scratch(channels: int) -> tuple[np.ndarray, ...]:
    """Return a thread's memory for the batches of a tile, as a tuple.

    values [BATCH, channels]: red, green, blue, depth, features, zeros.
    shapes [BATCH, SHAPE]: the beginning of the records, changed by `place_on`.
    pairs int32: pairs of a Gaussian and a block, as Gaussian * BLOCKS + block.
    first [BATCH + 1] int64: first pair of each Gaussian.
    weights [BLOCKS * ROOM * WIDTH]: weights of the batch, by block.
    sources [BLOCKS * ROOM] int64: where in `values` each weight's Gaussian begins.
    ends [BLOCKS] int64: end of each block's weights.
    open [BLOCKS] float32: what the reach in each block is limited to: less than any where all pixels have ended.
    backs [BLOCKS] int64: last free place of each block, before weights that are listed from its other end.
    """
    return (
        np.zeros((BATCH, channels), np.float32),
        np.empty((BATCH, SHAPE), np.float32),
        np.empty((BATCH + 1) * BLOCKS, np.int32),
        np.empty(BATCH + 1, np.int64),
        np.empty(BLOCKS * ROOM * WIDTH, np.float32),
        np.empty(BLOCKS * ROOM, np.int64),
        np.empty(BLOCKS, np.int64),
        np.full(BLOCKS, OPEN, np.float32),
        np.empty(BLOCKS, np.int64),
    )


@kernel
def all_ended(through: np.ndarray) -> bool:
    """Return whether every pixel of a tile has ended; `through` [BLOCKS * WIDTH]."""
    brightest = load(through, 0)
    for b in range(1, BLOCKS):
        other = load(through, b * WIDTH)
        brightest = choose(brightest, other, brightest, other)
    return not any_at_least(brightest, spread(ZERO))


@kernel
def gather(
    low: int,
    high: int,
    left: float,
    top: float,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    features: np.ndarray,
    values: np.ndarray,
    shapes: np.ndarray,
) -> None:
    """Copy the numbers of the instances low..high together; alone in a loop, so that waits for memory overlap.

    Args:
        low: First instance of a batch.
        high: Its end.
        left: Of the tile, pixels.
        top: Of the tile, pixels.
        gaussian: Gaussian of each instance.
        geometry: Of `projection.project`.
        features: [N, C].
        values: Output but for the zeros behind its channels, see `make_scratch`.
        shapes: Output, see `make_scratch`.
    """
    count, width = features.shape[1], values.shape[1]
    whole = count // 4 * 4
    records, extras = geometry.reshape(-1), features.reshape(-1)
    flat, starts = values.reshape(-1), shapes.reshape(-1)
    for n in range(low, high):
        i, k = int(gaussian[n]), n - low
        for c in range(0, SHAPE, 4):
            copy_four(records, i * RECORD_LENGTH + c, starts, k * SHAPE + c)
        copy_four(records, i * RECORD_LENGTH + RECORD.red, flat, k * width)
        # zeros of those that need few channels, too: loops of unlike length would be mispredicted at every Gaussian
        for c in range(0, whole, 4):
            copy_four(extras, i * count + c, flat, k * width + VALUES + c)
        for c in range(whole, count):
            values[k, VALUES + c] = features[i, c]
        place_on(shapes, k, left, top)


@kernel
def find_blocks(count: int, shapes: np.ndarray, limits: np.ndarray, pairs: np.ndarray, first: np.ndarray) -> int:
    """List the blocks of a tile that each Gaussian's ellipse reaches: exactly, all blocks of the tile at a time.

    The least value of s^2 + q^2 over a block's pixel centres' box is at the box's point nearest to the centre in x with the
    best y in the box, or the other way round.

    Args:
        count: Gaussians in the batch.
        shapes: Of `gather`.
        limits: `open` of `make_scratch`.
        pairs: Output, see `make_scratch`.
        first: Output, see `make_scratch`.

    Returns:
        The number of pairs.
    """
    listed = 0
    zero, wide, high = spread(ZERO), spread(F(BLOCK_X - 1)), spread(F(BLOCK_Y - 1))
    for k in range(count):
        first[k] = listed
        shape = ellipse(shapes, k)
        l11, l12, l22 = shapes[k, RECORD.l11], shapes[k, RECORD.l12], shapes[k, RECORD.l22]
        lean_x, lean_y = spread(-l12 / l11), spread(-l11 * l12 / (l12 * l12 + l22 * l22))
        reach = spread(shapes[k, RECORD.reach])
        for group in range(0, BLOCKS, WIDTH):
            low_x, low_y = load(BLOCK_LEFT, group) - shape.x, load(BLOCK_TOP, group) - shape.y
            high_x, high_y = low_x + wide, low_y + high
            near_x, near_y = larger(low_x, smaller(high_x, zero)), larger(low_y, smaller(high_y, zero))
            best_y = larger(low_y, smaller(high_y, lean_y * near_x))
            best_x = larger(low_x, smaller(high_x, lean_x * near_y))
            s, q = shape.l11 * near_x + shape.l12 * best_y, shape.l22 * best_y
            one = s * s + q * q
            s, q = shape.l11 * best_x + shape.l12 * near_y, shape.l22 * near_y
            limit = smaller(reach, load(limits, group))
            listed += append_at_least(pairs, listed, k * BLOCKS + group, limit, smaller(one, s * s + q * q))
    first[count] = listed
    return listed


@kernel
def start_batch(
    low: int,
    high: int,
    scene: tuple[np.ndarray, ...],
    left: float,
    top: float,
    through: np.ndarray,
    scratch: tuple[np.ndarray, ...],
) -> int:
    """Make the scratch ready for the instances low..high over the tile at left, top; return the number of pairs.

    Blocks whose transmittance [BLOCKS * WIDTH] has ended everywhere are left out.
    """
    gaussian, geometry, _, features = scene
    values, shapes, pairs, first, _, _, ends, limits, backs = scratch
    gather(low, high, left, top, gaussian, geometry, features, values, shapes)
    zero = spread(ZERO)
    for block in range(BLOCKS):
        limits[block] = OPEN if any_at_least(load(through, block * WIDTH), zero) else CLOSED
        ends[block], backs[block] = block * ROOM, block * ROOM + ROOM - 1
    return find_blocks(high - low, shapes, limits, pairs, first)
