"""Gradients of blending, tile by tile, compiled: replays each tile front to back and sums what every instance receives.

With R the light that arrives from behind Gaussian i (weighted by the picture's gradient), q its values times that gradient,
and T the transmittance before it: dL/dalpha = T q - R / (1 - alpha). R starts as the gradient times the finished picture and
loses w q at every step, so no list of Gaussians per pixel is kept. An instance's sums go to a row of its own (`rows`, one per
slot of `binning`): the moments (see `records.Row`), then the gradients of its values.

A batch takes three steps: weights and alpha / (1 - alpha) of every pair of a Gaussian and a block; for each block q and R along
its Gaussians, which gives g = alpha dL/dalpha; for each Gaussian the sums over its blocks, which stay in registers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rules import TILE
from .blocks import Four, alpha_at, ellipse, in_lanes, make_scratch, pass_light, start_batch, whitened
from .jit import kernel, part
from .projection_gradient import unproject
from .records import RECORD, ROW, VALUES
from .simd import WIDTH, any_at_least, choose, load, spread, store, store_totals
from .tiling import BATCH, BLOCKS, GROUP, ONE, ROOM, ZERO, F, lane_of, padded, start_tile


@part
def _add_four(four: Four, weight: Any, pull: np.ndarray, at: int) -> Four:
    """Return the sums of four channels with a weight times a block's four gradients added."""
    a, b, c, d = four
    a = a + weight * load(pull, at)
    b = b + weight * load(pull, at + WIDTH)
    c = c + weight * load(pull, at + 2 * WIDTH)
    d = d + weight * load(pull, at + 3 * WIDTH)
    return a, b, c, d


@kernel
def _slot(i: int, whole: np.ndarray, tile_x: int, tile_y: int) -> int:
    """Return the slot of Gaussian i in a tile, from the integers of its record."""
    first, end = whole[i, RECORD.tiles_low], whole[i, RECORD.tiles_high]
    return whole[i, RECORD.slot] + (tile_y - (first >> 16)) * ((end & 0xFFFF) - (first & 0xFFFF)) + tile_x - (first & 0xFFFF)


@kernel
def _replay_tile(
    low: int,
    high: int,
    scene: tuple[np.ndarray, ...],
    tile_x: int,
    tile_y: int,
    constants: tuple[float, ...],
    pull: np.ndarray,
    behind: np.ndarray,
    through: np.ndarray,
    scratch: tuple[np.ndarray, ...],
    ratios: np.ndarray,
    entries: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Replay the instances low..high over the tile tile_x, tile_y.

    Arrays, besides those of `replay`:
        pull: [BLOCKS * channels * WIDTH] gradient of the blended channels.
        behind: [BLOCKS * WIDTH] light from behind, R.
        through: [BLOCKS * WIDTH] transmittance, as `start_tile` leaves it.
        ratios: Scratch like `weights`: alpha / (1 - alpha), negative where the pixel ends; then g.
        entries: Scratch [BLOCKS * BATCH + 1] int64: places in `weights`, by Gaussian; `first` becomes the first of each one.
        rows: Output [slots, ROW.red + channels], the channels padded as everywhere here.
    """
    gaussian, _, whole, _ = scene
    values, shapes, pairs, first, weights, sources, ends, _, _ = scratch
    channels = values.shape[1]
    flat, out = values.reshape(-1), rows.reshape(-1)
    lanes = in_lanes(constants)
    zero = lanes.zero
    left, top = F(tile_x * TILE), F(tile_y * TILE)
    for batch in range(low, high, BATCH):
        end = min(batch + BATCH, high)
        start_batch(batch, end, scene, left, top, through, scratch)
        listed = 0
        pair = 0
        for k in range(end - batch):
            shape, opacity = ellipse(shapes, k), spread(shapes[k, RECORD.opacity])
            pair_end = first[k + 1]
            first[k] = listed
            while pair < pair_end:
                block = pairs[pair] % BLOCKS
                s, q = whitened(shape, block)
                alpha = alpha_at(opacity, s, q, lanes)
                weight = pass_light(through, block, alpha, lanes)
                ratio = choose(weight, lanes.tiny, alpha / (lanes.one - alpha), zero)
                entry = ends[block]
                store(weights, entry * WIDTH, weight)
                store(ratios, entry * WIDTH, choose(load(through, block * WIDTH), zero, ratio, lanes.ended))
                sources[entry] = k * channels
                entries[listed] = entry
                used = 1 if any_at_least(weight, lanes.tiny) else 0
                ends[block] = entry + used
                listed += used
                pair += 1
        first[end - batch] = listed
        for block in range(BLOCKS):
            at = block * channels * WIDTH
            rest = load(behind, block * WIDTH)
            for entry in range(block * ROOM, ends[block]):
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
            to = np.int64(_slot(gaussian[batch + k], whole, tile_x, tile_y)) * rows.shape[1]
            shape = ellipse(shapes, k)
            g0, gs, gq, gss, gsq, gqq = zero, zero, zero, zero, zero, zero
            for number in range(first[k], first[k + 1]):
                entry = entries[number]
                s, q = whitened(shape, entry // ROOM)
                g = load(ratios, entry * WIDTH)
                g0 = g0 + g
                gs = gs + g * s
                gq = gq + g * q
                gss = gss + g * s * s
                gsq = gsq + g * s * q
                gqq = gqq + g * q * q
            store_totals(out, to, g0, gs, gq, gss)  # in the order of `records.Row`
            store_totals(out, to + GROUP, gsq, gqq, zero, zero)
            to += ROW.red
            c = 0
            while c + 2 * GROUP <= channels:
                left_four, right_four = (zero, zero, zero, zero), (zero, zero, zero, zero)
                for number in range(first[k], first[k + 1]):
                    entry = entries[number]
                    weight = load(weights, entry * WIDTH)
                    at = (entry // ROOM * channels + c) * WIDTH
                    left_four = _add_four(left_four, weight, pull, at)
                    right_four = _add_four(right_four, weight, pull, at + GROUP * WIDTH)
                store_totals(out, to + c, *left_four)
                store_totals(out, to + c + GROUP, *right_four)
                c += 2 * GROUP
            if c < channels:
                four = (zero, zero, zero, zero)
                for number in range(first[k], first[k + 1]):
                    entry = entries[number]
                    four = _add_four(four, load(weights, entry * WIDTH), pull, (entry // ROOM * channels + c) * WIDTH)
                store_totals(out, to + c, *four)


@kernel
def replay(
    first_tile: int,
    end_tile: int,
    tiles_x: int,
    starts: np.ndarray,
    ends: np.ndarray,
    scene: tuple[np.ndarray, ...],
    constants: tuple[float, ...],
    pictures: tuple[np.ndarray, ...],
    d_pictures: tuple[np.ndarray, ...],
    rows: np.ndarray,
) -> None:
    """Write the gradients of the instances of some tiles to `rows`.

    Arguments by group:
        first_tile, end_tile, tiles_x, starts, scene, constants: As in `forward.draw`.
        ends, pictures: What it returned.
        d_pictures: Gradients of the pictures.
        rows: Output [M, ROW.red + padded(C)].
    """
    gaussian, _, whole, features = scene
    channels = padded(features.shape[1])
    pull = np.zeros(BLOCKS * channels * WIDTH, np.float32)
    behind = np.zeros(BLOCKS * WIDTH, np.float32)
    through = np.zeros(BLOCKS * WIDTH, np.float32)
    scratch = make_scratch(channels)
    ratios = np.empty(BLOCKS * ROOM * WIDTH, np.float32)
    entries = np.empty(BLOCKS * BATCH + 1, np.int64)
    rgb, alpha, depth, blended = pictures
    d_rgb, d_alpha, d_depth, d_blended = d_pictures
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
                    pixel, at = lane_of(r, c, channels)
                    cover = alpha[y, x]
                    arriving = -(ONE - cover) * d_alpha[y, x]
                    for k in range(3):
                        g = d_rgb[y, x, k]
                        pull[at + k * WIDTH] = g
                        arriving += g * rgb[y, x, k]
                    # depth = D / cover: D's gradient times D is g depth cover, and cover's adds g depth (1 - cover).
                    g = d_depth[y, x] / cover if cover > ZERO else ZERO
                    pull[at + 3 * WIDTH] = g
                    arriving += g * depth[y, x]
                    for k in range(features.shape[1]):
                        g = d_blended[y, x, k]
                        pull[at + (VALUES + k) * WIDTH] = g
                        arriving += g * blended[y, x, k]
                    behind[pixel] = arriving
            _replay_tile(
                low, end, scene, tile % tiles_x, tile // tiles_x, constants,
                pull, behind, through, scratch, ratios, entries, rows,
            )  # fmt: skip
        for n in range(max(end, low), high):
            rows[_slot(gaussian[n], whole, tile % tiles_x, tile // tiles_x)] = ZERO


@kernel
def collect(
    low: int,
    high: int,
    rows: np.ndarray,
    gaussians: tuple[np.ndarray, ...],
    camera: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    gradients: tuple[np.ndarray, ...],
) -> None:
    """Sum the rows of the Gaussians low..high and carry the sums back through the projection.

    Arguments by group:
        low, high: A chunk.
        rows: Of `replay`.
        gaussians, camera, geometry, whole: As in `projection.project`.
        gradients: Outputs, like `gaussians`, zero on entry.
    """
    d_colors, d_features = gradients[4:]
    summed = np.empty(rows.shape[1], np.float32)
    for i in range(low, high):
        touched = whole[i, RECORD.touched]
        if not touched:
            continue
        first = whole[i, RECORD.slot]
        for c in range(rows.shape[1]):
            summed[c] = rows[first, c]
        for slot in range(first + 1, first + touched):
            for c in range(rows.shape[1]):
                summed[c] += rows[slot, c]
        unproject(i, gaussians, camera, geometry, summed, gradients)
        for c in range(3):
            d_colors[i, c] = summed[ROW.red + c]
        for c in range(d_features.shape[1]):
            d_features[i, c] = summed[ROW.red + VALUES + c]
