"""Which Gaussians each tile draws, nearest first. Compiled; `drawing.py` calls it between projection and blending.

A pair of a Gaussian and a tile it may touch is an instance. A counting sort by tile, parallel over chunks of Gaussians, lists
every tile's instances in the order of the Gaussians' indices; each tile then sorts its own list by depth, stably, so that ties
stay in the order of the index. Every instance also has a slot, where the instances of one Gaussian lie together: the backward
pass writes gradients there and sums them without two threads touching one number.
"""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .records import RECORD

DIGITS, BUCKETS = 4, 256  # a float32 as radix-sort digits
FEW = 24  # instances below which insertion sort is faster


@kernel
def place(histogram: np.ndarray, touched: np.ndarray, starts: np.ndarray) -> None:
    """Turn counts into positions.

    Args:
        histogram: [chunks, tiles] int32, instances of a chunk of Gaussians in a tile; replaced by the first one's position.
        touched: [chunks] int64, instances of each chunk; replaced by the chunk's first slot.
        starts: Output [tiles + 1] int64, first instance of each tile.
    """
    position = 0
    for tile in range(histogram.shape[1]):
        starts[tile] = position
        for chunk in range(histogram.shape[0]):
            count = histogram[chunk, tile]
            histogram[chunk, tile] = position
            position += count
    starts[histogram.shape[1]] = position
    slot = 0
    for chunk in range(touched.shape[0]):
        count = touched[chunk]
        touched[chunk] = slot
        slot += count


@kernel
def fill(
    low: int, high: int, whole: np.ndarray, tiles_x: int, cursor: np.ndarray, first_slot: int, gaussian: np.ndarray
) -> None:
    """List the Gaussians low..high in their tiles and give them their slots.

    Args:
        low: First Gaussian of a chunk.
        high: Its end.
        whole: [N, RECORD_LENGTH] int32 view of the records.
        tiles_x: Tiles in a row of the grid.
        cursor: [tiles] int32, the chunk's row of `place`'s positions; advanced.
        first_slot: Of the chunk.
        gaussian: Output [M] int32.
    """
    slot = first_slot
    for i in range(low, high):
        whole[i, RECORD.slot] = slot
        if whole[i, RECORD.touched]:
            slot += whole[i, RECORD.touched]
            first, end = whole[i, RECORD.tiles_low], whole[i, RECORD.tiles_high]
            for y in range(first >> 16, end >> 16):
                for tile in range(y * tiles_x + (first & 0xFFFF), y * tiles_x + (end & 0xFFFF)):
                    gaussian[cursor[tile]] = i
                    cursor[tile] += 1


@kernel
def sort_by_depth(indices: np.ndarray, whole: np.ndarray, keys: np.ndarray, spare: np.ndarray, histogram: np.ndarray) -> None:
    """Sort a tile's Gaussians by depth, stably.

    Args:
        indices: [n] int32, sorted in place.
        whole: [N, RECORD_LENGTH] int32 view of the records; depths are positive, so their bits sort like the numbers.
        keys: Scratch [2, >= n] int32.
        spare: Scratch [>= n] int32.
        histogram: Scratch [DIGITS, BUCKETS] int32.
    """
    count = indices.shape[0]
    now, later = keys[0], keys[1]
    for k in range(count):
        now[k] = whole[indices[k], RECORD.depth]
    if count < FEW:
        for k in range(1, count):
            key, index = now[k], indices[k]
            at = k
            while at > 0 and now[at - 1] > key:
                now[at], indices[at] = now[at - 1], indices[at - 1]
                at -= 1
            now[at], indices[at] = key, index
        return
    histogram[:] = 0
    for k in range(count):
        key = now[k]
        for digit in range(DIGITS):
            histogram[digit, (key >> (8 * digit)) & 0xFF] += 1
    source, target = indices, spare
    for digit in range(DIGITS):
        shift = 8 * digit
        counts = histogram[digit]
        if counts[(now[0] >> shift) & 0xFF] == count:
            continue  # all alike
        position = 0
        for bucket in range(BUCKETS):
            here = counts[bucket]
            counts[bucket] = position
            position += here
        for k in range(count):
            key = now[k]
            bucket = (key >> shift) & 0xFF
            to = counts[bucket]
            counts[bucket] = to + 1
            later[to] = key
            target[to] = source[k]
        now, later = later, now
        source, target = target, source
    for k in range(count):  # which of the two lists is the last one depends on the digits
        later[k] = source[k]
    for k in range(count):
        indices[k] = later[k]
