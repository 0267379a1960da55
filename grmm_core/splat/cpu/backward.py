"""Gradients of blending, tile by tile, compiled: replays each tile front to back and sums what every instance receives.

With R the light that arrives from behind Gaussian i (weighted by the picture's gradient), q its values times that gradient,
and T the transmittance before it: dL/dalpha = T q - R / (1 - alpha). R starts as the gradient times the finished picture and
loses w q at every step, so no list of Gaussians per pixel is kept. An instance's sums go to a row of its own (`rows`, one per
slot of `binning`): the moments (see `projection.MOMENTS`), then the gradients of its values.

A batch takes three steps: weights and alpha / (1 - alpha) of every pair of a Gaussian and a block; for each block q and R along
its Gaussians, which gives g = alpha dL/dalpha; for each Gaussian the sums over its blocks, which stay in registers.
"""

from __future__ import annotations

import numpy as np

from ..rules import TILE
from .blocks import (
    BASE,
    BATCH,
    BLOCK_X,
    BLOCK_Y,
    BLOCKS,
    BLOCKS_X,
    GROUP,
    HALF,
    ONE,
    PIXEL_X,
    PIXEL_Y,
    ROOM,
    SHRINK,
    ZERO,
    F,
    falloff,
    find_blocks,
    gather,
    padded,
    start_tile,
)
from .jit import kernel
from .projection import MOMENTS, RECT, SLOT, TOUCHED, VALUES, unproject_one
from .simd import WIDTH, any_at_least, choose, load, negative, smaller, spread, store, store_totals


@kernel
def _slot(record: np.ndarray, tile_x: int, tile_y: int) -> int:
    """Return the slot of a Gaussian in a tile, from the integers of its record."""
    first, end = record[RECT], record[RECT + 1]
    return record[SLOT] + (tile_y - (first >> 16)) * ((end & 0xFFFF) - (first & 0xFFFF)) + tile_x - (first & 0xFFFF)


@kernel
def _replay_tile(
    low: int,
    high: int,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    features: np.ndarray,
    tile_x: int,
    tile_y: int,
    constants: np.ndarray,
    pull: np.ndarray,
    behind: np.ndarray,
    through: np.ndarray,
    values: np.ndarray,
    places: np.ndarray,
    pairs: np.ndarray,
    first: np.ndarray,
    weights: np.ndarray,
    ratios: np.ndarray,
    sources: np.ndarray,
    counts: np.ndarray,
    entries: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Replay the instances low..high over the tile tile_x, tile_y.

    Arrays, besides those of `replay` and `forward._blend_tile`:
        pull: [BLOCKS * channels * WIDTH] gradient of the blended channels.
        behind: [BLOCKS * WIDTH] light from behind, R.
        through: [BLOCKS * WIDTH] transmittance, as `start_tile` leaves it.
        ratios: Scratch like `weights`: alpha / (1 - alpha), negative where alpha is capped; then g.
        entries: Scratch [BLOCKS * BATCH + 1] int64: places in `weights`, by Gaussian; `first` becomes the first of each one.
        rows: Output [slots, MOMENTS + channels], the channels padded as everywhere here.
    """
    channels = values.shape[1]
    flat, out = values.reshape(-1), rows.reshape(-1)
    one, e1, e2, e3 = spread(constants[0]), spread(constants[1]), spread(constants[2]), spread(constants[3])
    e4, e5, farthest, floor = spread(constants[4]), spread(constants[5]), spread(constants[6]), spread(constants[7])
    cap, stop, zero, tiny = spread(constants[8]), spread(constants[9]), spread(constants[10]), spread(constants[11])
    capped = spread(constants[12])
    left, top = F(tile_x * TILE), F(tile_y * TILE)
    for batch in range(low, high, BATCH):
        end = min(batch + BATCH, high)
        gather(batch, end, gaussian, geometry, features, values, places)
        find_blocks(end - batch, places, left, top, pairs, first)
        for block in range(BLOCKS):
            counts[block] = block * ROOM
        listed = 0
        pair = 0
        for k in range(end - batch):
            mx, my = spread(places[k, 0] - left - HALF), spread(places[k, 1] - top - HALF)
            l11, l12, l22 = spread(places[k, 2] * SHRINK), spread(places[k, 3] * SHRINK), spread(places[k, 4] * SHRINK)
            opacity = spread(places[k, 5])
            pair_end = first[k + 1]
            first[k] = listed
            while pair < pair_end:
                block = pairs[pair] % BLOCKS
                dx, dy = load(PIXEL_X, block * WIDTH) - mx, load(PIXEL_Y, block * WIDTH) - my
                s, q = l11 * dx + l12 * dy, l22 * dy
                alpha = smaller(opacity * falloff(s * s + q * q, one, e1, e2, e3, e4, e5, farthest), cap)
                alpha = choose(alpha, floor, alpha, zero)
                before = load(through, block * WIDTH)
                after = before * (one - alpha)
                weight = choose(after, stop, alpha * before, zero)
                store(through, block * WIDTH, choose(after, stop, after, negative(before)))
                ratio = choose(weight, tiny, alpha / (one - alpha), zero)
                entry = counts[block]
                store(weights, entry * WIDTH, weight)
                store(ratios, entry * WIDTH, choose(alpha, cap, capped, ratio))
                sources[entry] = k * channels
                entries[listed] = entry
                used = 1 if any_at_least(weight, tiny) else 0
                counts[block] = entry + used
                listed += used
                pair += 1
        first[end - batch] = listed
        for block in range(BLOCKS):
            at = block * channels * WIDTH
            rest = load(behind, block * WIDTH)
            for entry in range(block * ROOM, counts[block]):
                source = sources[entry]
                dot0, dot1, dot2, dot3 = zero, zero, zero, zero  # four chains, so that additions need not wait for each other
                for c in range(0, channels, GROUP):
                    dot0 = dot0 + load(pull, at + c * WIDTH) * spread(flat[source + c])
                    dot1 = dot1 + load(pull, at + (c + 1) * WIDTH) * spread(flat[source + c + 1])
                    dot2 = dot2 + load(pull, at + (c + 2) * WIDTH) * spread(flat[source + c + 2])
                    dot3 = dot3 + load(pull, at + (c + 3) * WIDTH) * spread(flat[source + c + 3])
                light = load(weights, entry * WIDTH) * ((dot0 + dot1) + (dot2 + dot3))
                rest = rest - light
                ratio = load(ratios, entry * WIDTH)
                store(ratios, entry * WIDTH, choose(ratio, zero, light - ratio * rest, zero))
            store(behind, block * WIDTH, rest)
        for k in range(end - batch):
            to = np.int64(_slot(whole[gaussian[batch + k]], tile_x, tile_y)) * rows.shape[1]
            mx, my = spread(places[k, 0] - left - HALF), spread(places[k, 1] - top - HALF)
            l11, l12, l22 = spread(places[k, 2] * SHRINK), spread(places[k, 3] * SHRINK), spread(places[k, 4] * SHRINK)
            g0, gs, gq, gss, gsq, gqq = zero, zero, zero, zero, zero, zero
            for number in range(first[k], first[k + 1]):
                entry = entries[number]
                block = entry // ROOM
                dx, dy = load(PIXEL_X, block * WIDTH) - mx, load(PIXEL_Y, block * WIDTH) - my
                s, q = l11 * dx + l12 * dy, l22 * dy
                g = load(ratios, entry * WIDTH)
                g0 = g0 + g
                gs = gs + g * s
                gq = gq + g * q
                gss = gss + g * s * s
                gsq = gsq + g * s * q
                gqq = gqq + g * q * q
            store_totals(out, to, g0, gs, gq, gss)
            store_totals(out, to + 4, gsq, gqq, zero, zero)
            to += MOMENTS
            c = 0
            while c + 2 * GROUP <= channels:
                d0, d1, d2, d3, d4, d5, d6, d7 = zero, zero, zero, zero, zero, zero, zero, zero
                for number in range(first[k], first[k + 1]):
                    entry = entries[number]
                    weight = load(weights, entry * WIDTH)
                    at = (entry // ROOM * channels + c) * WIDTH
                    d0 = d0 + weight * load(pull, at)
                    d1 = d1 + weight * load(pull, at + WIDTH)
                    d2 = d2 + weight * load(pull, at + 2 * WIDTH)
                    d3 = d3 + weight * load(pull, at + 3 * WIDTH)
                    d4 = d4 + weight * load(pull, at + 4 * WIDTH)
                    d5 = d5 + weight * load(pull, at + 5 * WIDTH)
                    d6 = d6 + weight * load(pull, at + 6 * WIDTH)
                    d7 = d7 + weight * load(pull, at + 7 * WIDTH)
                store_totals(out, to + c, d0, d1, d2, d3)
                store_totals(out, to + c + GROUP, d4, d5, d6, d7)
                c += 2 * GROUP
            if c < channels:
                d0, d1, d2, d3 = zero, zero, zero, zero
                for number in range(first[k], first[k + 1]):
                    entry = entries[number]
                    weight = load(weights, entry * WIDTH)
                    at = (entry // ROOM * channels + c) * WIDTH
                    d0 = d0 + weight * load(pull, at)
                    d1 = d1 + weight * load(pull, at + WIDTH)
                    d2 = d2 + weight * load(pull, at + 2 * WIDTH)
                    d3 = d3 + weight * load(pull, at + 3 * WIDTH)
                store_totals(out, to + c, d0, d1, d2, d3)


@kernel
def replay(
    first_tile: int,
    end_tile: int,
    tiles_x: int,
    starts: np.ndarray,
    ends: np.ndarray,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    features: np.ndarray,
    constants: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    d_rgb: np.ndarray,
    d_alpha: np.ndarray,
    d_depth: np.ndarray,
    d_blended: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Write the gradients of the instances of some tiles to `rows`.

    Arguments by group:
        first_tile, end_tile, tiles_x, starts, gaussian, geometry, whole, features, constants: As in `forward.draw`.
        ends, rgb, alpha, depth, blended: What it returned.
        d_rgb, d_alpha, d_depth, d_blended: Gradients of the outputs.
        rows: Output [M, MOMENTS + padded(C)].
    """
    channels = padded(features.shape[1])
    pull = np.zeros(BLOCKS * channels * WIDTH, np.float32)
    behind = np.zeros(BLOCKS * WIDTH, np.float32)
    through = np.zeros(BLOCKS * WIDTH, np.float32)
    values = np.zeros((BATCH, channels), np.float32)
    places = np.empty((BATCH, VALUES), np.float32)
    pairs = np.empty((BATCH + 1) * BLOCKS, np.int32)
    first = np.empty(BATCH + 1, np.int64)
    weights = np.empty(BLOCKS * ROOM * WIDTH, np.float32)
    ratios = np.empty(BLOCKS * ROOM * WIDTH, np.float32)
    sources = np.empty(BLOCKS * ROOM, np.int64)
    counts = np.empty(BLOCKS, np.int64)
    entries = np.empty(BLOCKS * BATCH + 1, np.int64)
    picture_height, picture_width = alpha.shape
    for tile in range(first_tile, end_tile):
        low, high, end = starts[tile], starts[tile + 1], ends[tile]
        if end > low:
            x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
            width, height = min(TILE, picture_width - x0), min(TILE, picture_height - y0)
            start_tile(through, width, height)
            for r in range(height):
                y = y0 + r
                for c in range(width):
                    x = x0 + c
                    block, lane = r // BLOCK_Y * BLOCKS_X + c // BLOCK_X, r % BLOCK_Y * BLOCK_X + c % BLOCK_X
                    pixel = pull[block * channels * WIDTH + lane :]
                    cover = alpha[y, x]
                    arriving = -(ONE - cover) * d_alpha[y, x]
                    for k in range(3):
                        g = d_rgb[y, x, k]
                        pixel[k * WIDTH] = g
                        arriving += g * rgb[y, x, k]
                    # depth = D / cover: D's gradient times D is g depth cover, and cover's adds g depth (1 - cover).
                    g = d_depth[y, x] / cover if cover > ZERO else ZERO
                    pixel[3 * WIDTH] = g
                    arriving += g * depth[y, x]
                    for k in range(features.shape[1]):
                        g = d_blended[y, x, k]
                        pixel[(BASE + k) * WIDTH] = g
                        arriving += g * blended[y, x, k]
                    behind[block * WIDTH + lane] = arriving
            _replay_tile(
                low, end, gaussian, geometry, whole, features, tile % tiles_x, tile // tiles_x, constants,
                pull, behind, through, values, places, pairs, first, weights, ratios, sources, counts, entries, rows,
            )  # fmt: skip
        for n in range(max(end, low), high):
            row = rows[_slot(whole[gaussian[n]], tile % tiles_x, tile // tiles_x)]
            for c in range(row.shape[0]):
                row[c] = ZERO


@kernel
def collect(
    low: int,
    high: int,
    rows: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    camera: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    d_means: np.ndarray,
    d_quats: np.ndarray,
    d_scales: np.ndarray,
    d_opacities: np.ndarray,
    d_colors: np.ndarray,
    d_features: np.ndarray,
) -> None:
    """Sum the rows of the Gaussians low..high and carry the sums back through the projection.

    Arguments by group:
        low, high: A chunk.
        rows: Of `replay`.
        means, quats, scales, opacities, camera, geometry, whole: As in `projection.project`.
        d_means, d_quats, d_scales, d_opacities, d_colors, d_features: Outputs, zero on entry, as large as the inputs.
    """
    summed = np.empty(rows.shape[1], np.float32)
    for i in range(low, high):
        touched = whole[i, TOUCHED]
        if not touched:
            continue
        first = whole[i, SLOT]
        for c in range(rows.shape[1]):
            summed[c] = rows[first, c]
        for slot in range(first + 1, first + touched):
            for c in range(rows.shape[1]):
                summed[c] += rows[slot, c]
        d_opacities[i] = unproject_one(
            means[i], quats[i], scales[i], opacities[i], camera, geometry[i], summed, np.float64(summed[MOMENTS + 3]),
            d_means[i], d_quats[i], d_scales[i],
        )  # fmt: skip
        for c in range(3):
            d_colors[i, c] = summed[MOMENTS + c]
        for c in range(d_features.shape[1]):
            d_features[i, c] = summed[MOMENTS + BASE + c]
