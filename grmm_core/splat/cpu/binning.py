"""Which Gaussians each tile draws, nearest first: a radix sort by depth, then a stable counting sort by tile. Compiled.

`function.py` calls it between projection and blending.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .jit import kernel

DIGIT = 11  # bits per radix pass; three passes cover a float32


@kernel()
def depth_order(depths: np.ndarray, rects: np.ndarray) -> np.ndarray:
    """Return the indices of the seen Gaussians from near to far, ties by index.

    Args:
        depths: [N] float32, positive where seen, so that their bits sort like the numbers.
        rects: [N, 4] int32 of `project_forward`.
    """
    keys = depths.view(np.uint32)
    count = 0
    for i in range(rects.shape[0]):
        count += rects[i, 2] > rects[i, 0]
    order = np.empty(count, np.int32)
    other = np.empty(count, np.int32)
    buckets = 1 << DIGIT
    mask = np.uint32(buckets - 1)
    histogram = np.zeros((3, buckets), np.int64)
    k = 0
    for i in range(rects.shape[0]):
        if rects[i, 2] > rects[i, 0]:
            order[k] = i
            k += 1
            key = keys[i]
            histogram[0, key & mask] += 1
            histogram[1, (key >> np.uint32(DIGIT)) & mask] += 1
            histogram[2, key >> np.uint32(2 * DIGIT)] += 1
    for digit in range(3):
        total = 0
        for bucket in range(buckets):
            here = histogram[digit, bucket]
            histogram[digit, bucket] = total
            total += here
        shift = np.uint32(digit * DIGIT)
        for k in range(count):
            i = order[k]
            bucket = (keys[i] >> shift) & mask
            other[histogram[digit, bucket]] = i
            histogram[digit, bucket] += 1
        order, other = other, order
    return order


@kernel()
def bin_tiles(order: np.ndarray, rects: np.ndarray, tiles_x: int, tiles_y: int) -> Any:
    """Give every tile its Gaussians, nearest first.

    A pair of a Gaussian and a tile is an instance. Instances are stored tile by tile; each also has a slot in an order where the
    instances of one Gaussian lie together, so that the backward pass can sum them without two threads writing one number.

    Args:
        order: [V] Gaussians from near to far.
        rects: [N, 4] tiles that each touches.
        tiles_x, tiles_y: Size of the grid.

    Returns:
        starts [tiles + 1] int64, gaussian [M] int32 and slot [M] int32 of each instance, and slots [V + 1] int64: the first slot
        of each Gaussian in `order`.
    """
    tiles = tiles_x * tiles_y
    starts = np.zeros(tiles + 1, np.int64)
    slots = np.empty(order.shape[0] + 1, np.int64)
    total = 0
    for k in range(order.shape[0]):
        slots[k] = total
        i = order[k]
        x0, y0, x1, y1 = rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3]
        total += (x1 - x0) * (y1 - y0)
        for y in range(y0, y1):
            for x in range(x0, x1):
                starts[y * tiles_x + x + 1] += 1
    slots[order.shape[0]] = total
    for tile in range(tiles):
        starts[tile + 1] += starts[tile]
    cursor = starts[:tiles].copy()
    gaussian = np.empty(total, np.int32)
    slot = np.empty(total, np.int32)
    for k in range(order.shape[0]):
        i = order[k]
        x0, y0, x1, y1 = rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3]
        here = slots[k]
        for y in range(y0, y1):
            for x in range(x0, x1):
                tile = y * tiles_x + x
                at = cursor[tile]
                cursor[tile] = at + 1
                gaussian[at] = i
                slot[at] = here
                here += 1
    return starts, gaussian, slot, slots
