"""Gradients of blending, tile by tile, compiled: replays each tile front to back and sums what every instance receives.

With R the light that arrives from behind Gaussian i (weighted by the picture's gradient), q its values times that gradient,
and T the transmittance before it: dL/dalpha = T q - R / (1 - alpha). R starts as the gradient times the finished picture and
loses w q at every step, so no list of Gaussians per pixel is kept. An instance's sums go to a row of its own (`rows`, one per
slot of `binning`): the moments (see `projection.MOMENTS`), then the gradients of its values.
"""

from __future__ import annotations

import numpy as np

from ..rules import TILE
from .forward import (
    BASE,
    BLOCK_X,
    BLOCK_Y,
    BLOCKS,
    BLOCKS_X,
    BLOCKS_Y,
    GROUP,
    HALF,
    LANE_X,
    LANE_Y,
    ONE,
    SHRINK,
    ZERO,
    F,
    block_range,
    falloff,
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
    value: np.ndarray,
    d_value: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Replay the instances low..high over the tile tile_x, tile_y.

    Arrays, besides those of `replay`:
        pull: [BLOCKS * channels * WIDTH] gradient of the blended channels.
        behind: [BLOCKS * WIDTH] light from behind, R.
        through: [BLOCKS * WIDTH] transmittance, as `start_tile` leaves it.
        value, d_value: Scratch [channels], [channels * WIDTH].
        rows: Output [slots, MOMENTS + channels], the channels padded as everywhere here.
    """
    channels = value.shape[0]
    flat = rows.reshape(-1)
    one, e1, e2, e3 = spread(constants[0]), spread(constants[1]), spread(constants[2]), spread(constants[3])
    e4, e5, farthest, floor = spread(constants[4]), spread(constants[5]), spread(constants[6]), spread(constants[7])
    cap, stop, zero, tiny = spread(constants[8]), spread(constants[9]), spread(constants[10]), spread(constants[11])
    lane_x, lane_y = load(LANE_X, 0), load(LANE_Y, 0)
    four, block_height = spread(F(BLOCK_X)), spread(F(BLOCK_Y))
    for n in range(low, high):
        i = gaussian[n]
        record = geometry[i]
        mx, my = record[0] - F(tile_x * TILE) - HALF, record[1] - F(tile_y * TILE) - HALF
        l11, l12, l22 = spread(record[2] * SHRINK), spread(record[3] * SHRINK), spread(record[4] * SHRINK)
        opacity = spread(record[5])
        first_x, end_x = block_range(mx, record[6], BLOCK_X, BLOCKS_X)
        first_y, end_y = block_range(my, record[7], BLOCK_Y, BLOCKS_Y)
        for c in range(BASE):
            value[c] = record[VALUES + c]
        for c in range(features.shape[1]):
            value[BASE + c] = features[i, c]
        for c in range(channels):
            store(d_value, c * WIDTH, zero)
        g0, gs, gq, gss, gsq, gqq = zero, zero, zero, zero, zero, zero
        dx = lane_x + spread(F(first_x * BLOCK_X) - mx)
        dy = lane_y + spread(F(first_y * BLOCK_Y) - my)
        s_row, q = l11 * dx + l12 * dy, l22 * dy
        right, down_s, down_q = four * l11, block_height * l12, block_height * l22
        for row in range(first_y * BLOCKS_X, end_y * BLOCKS_X, BLOCKS_X):
            qq = q * q
            s = s_row - right
            for block in range(row + first_x, row + end_x):
                s = s + right
                alpha = smaller(opacity * falloff(s * s + qq, one, e1, e2, e3, e4, e5, farthest), cap)
                alpha = choose(alpha, floor, alpha, zero)
                before = load(through, block * WIDTH)
                after = before * (one - alpha)
                weight = choose(after, stop, alpha * before, zero)
                store(through, block * WIDTH, choose(after, stop, after, negative(before)))
                if not any_at_least(weight, tiny):
                    continue
                at = block * channels * WIDTH
                dot0, dot1, dot2, dot3 = zero, zero, zero, zero  # four chains, so that additions need not wait for each other
                for c in range(0, channels, GROUP):
                    p0, p1 = load(pull, at + c * WIDTH), load(pull, at + (c + 1) * WIDTH)
                    p2, p3 = load(pull, at + (c + 2) * WIDTH), load(pull, at + (c + 3) * WIDTH)
                    dot0 = dot0 + p0 * spread(value[c])
                    dot1 = dot1 + p1 * spread(value[c + 1])
                    dot2 = dot2 + p2 * spread(value[c + 2])
                    dot3 = dot3 + p3 * spread(value[c + 3])
                    store(d_value, c * WIDTH, load(d_value, c * WIDTH) + weight * p0)
                    store(d_value, (c + 1) * WIDTH, load(d_value, (c + 1) * WIDTH) + weight * p1)
                    store(d_value, (c + 2) * WIDTH, load(d_value, (c + 2) * WIDTH) + weight * p2)
                    store(d_value, (c + 3) * WIDTH, load(d_value, (c + 3) * WIDTH) + weight * p3)
                dot = (dot0 + dot1) + (dot2 + dot3)
                rest = load(behind, block * WIDTH) - weight * dot
                store(behind, block * WIDTH, rest)
                g = alpha * (before * dot - rest / (one - alpha))
                g = choose(weight, tiny, choose(alpha, cap, zero, g), zero)
                g0 = g0 + g
                gs = gs + g * s
                gq = gq + g * q
                gss = gss + g * s * s
                gsq = gsq + g * s * q
                gqq = gqq + g * q * q
            s_row = s_row + down_s
            q = q + down_q
        to = np.int64(_slot(whole[i], tile_x, tile_y)) * rows.shape[1]
        store_totals(flat, to, g0, gs, gq, gss)
        store_totals(flat, to + 4, gsq, gqq, zero, zero)
        to += MOMENTS
        for c in range(0, channels, GROUP):
            d0, d1 = load(d_value, c * WIDTH), load(d_value, (c + 1) * WIDTH)
            d2, d3 = load(d_value, (c + 2) * WIDTH), load(d_value, (c + 3) * WIDTH)
            store_totals(flat, to + c, d0, d1, d2, d3)


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
    value = np.zeros(channels, np.float32)
    d_value = np.zeros(channels * WIDTH, np.float32)
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
                pull, behind, through, value, d_value, rows,
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
