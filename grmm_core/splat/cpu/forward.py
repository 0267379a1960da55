"""Blending, tile by tile, compiled: the hot loop of the forward pass. The twin of `reference.blend`.

A tile keeps, for each of its pixels, the channels blended so far (colour, depth, features side by side), the transmittance that
is still open to light (`live`, 0 once the pixel has ended) and the final transmittance (`left`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ..rules import ALPHA_MAX, ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from .jit import kernel

F = np.float32
ONE, ZERO, HALF, EIGHTH = F(1.0), F(0.0), F(0.5), F(0.125)
CAP, FLOOR, STOP = F(ALPHA_MAX), F(ALPHA_MIN), F(TRANSMITTANCE_MIN)
PAD = 8  # spare pixels at the end of a row, so that loops of eight may run over its end
STRIDE = TILE + PAD
CHECK = 16  # Gaussians between two looks at whether all pixels of the tile have ended
LOWEST = F(-5.6)  # e^LOWEST is below ALPHA_MIN, so what is smaller need not be known
BASE = 4  # channels before the features: r, g, b, depth


@kernel()
def exp8(x: float) -> float:
    """Return e^x for LOWEST <= x <= 0 as p(x / 8)^8 with p of fifth degree; relative error 2e-6. Below LOWEST: that of LOWEST."""
    t = max(x, LOWEST) * EIGHTH
    p = ONE + t * (F(0.999994755) + t * (F(0.499899775) + t * (F(0.166028395) + t * (F(0.0398483016) + t * F(0.00588524854)))))
    p = p * p
    p = p * p
    return p * p


@kernel()
def _blend_tile(
    low: int,
    high: int,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    left_edge: float,
    top_edge: float,
    total: np.ndarray,
    live: np.ndarray,
    left: np.ndarray,
    value: np.ndarray,
    weight: np.ndarray,
) -> int:
    """Blend the instances low..high over one tile; return the end of those that were looked at."""
    channels = total.shape[1]
    for n in range(low, high):
        if (n - low) % CHECK == CHECK - 1:
            brightest = ZERO
            flat = live.reshape(-1)
            for i in range(flat.shape[0]):
                brightest = max(brightest, flat[i])
            if brightest == ZERO:
                return n
        i = gaussian[n]
        record = geometry[i]
        mx, my = record[0] - left_edge - HALF, record[1] - top_edge - HALF  # pixel k of the tile is at coordinate k
        l11, l12, l22, opacity, reach, half = record[2], record[3], record[4], record[5], record[6], record[7]
        value[0], value[1], value[2], value[3] = colors[i, 0], colors[i, 1], colors[i, 2], depths[i]
        for c in range(features.shape[1]):
            value[BASE + c] = features[i, c]
        first = int(math.ceil(max(my - half, ZERO)))
        last = int(math.floor(min(my + half, F(TILE - 1))))
        for row in range(first, last + 1):
            dy = F(row) - my
            q = l22 * dy
            room = reach - q * q
            if room < ZERO:
                continue
            radius = math.sqrt(room) / l11 + F(0.01)
            middle = mx - l12 * dy / l11
            start = int(math.ceil(max(middle - radius, ZERO)))
            stop = int(math.floor(min(middle + radius, F(TILE - 1)))) + 1
            count = stop - start
            if count <= 0:
                continue
            qq = HALF * q * q
            s0 = l11 * (F(start) - mx) + l12 * dy
            open_row = live[row, start:]
            left_row = left[row, start:]
            for k in range(count):
                s = s0 + l11 * F(k)
                alpha = min(opacity * exp8(-(HALF * s * s + qq)), CAP)
                if alpha < FLOOR:
                    alpha = ZERO
                before = open_row[k]
                after = before * (ONE - alpha)
                blended = after >= STOP
                weight[k] = alpha * before if blended else ZERO
                open_row[k] = after if blended else ZERO
                left_row[k] = after if blended else left_row[k]
            for k in range(count):
                w = weight[k]
                if w != ZERO:
                    pixel = total[row * TILE + start + k]
                    for c in range(channels):
                        pixel[c] += w * value[c]
    return high


@kernel()
def _draw_tile(
    tile: int,
    tiles_x: int,
    starts: np.ndarray,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    ends: np.ndarray,
    scratch: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Blend one tile and write its pixels."""
    total, live, left, value, weight = scratch
    height, width = alpha.shape
    x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
    columns, rows = min(TILE, width - x0), min(TILE, height - y0)
    total[:] = ZERO
    live[:] = ZERO
    live[:rows, :columns] = ONE
    left[:] = ONE
    low, high = starts[tile], starts[tile + 1]
    ends[tile] = _blend_tile(
        low, high, gaussian, geometry, depths, colors, features, F(x0), F(y0), total, live, left, value, weight
    )
    for r in range(rows):
        y = y0 + r
        by = min(y, background.shape[0] - 1)
        for c in range(columns):
            x = x0 + c
            bx = min(x, background.shape[1] - 1)
            through = left[r, c]
            pixel = total[r * TILE + c]
            for k in range(3):
                rgb[y, x, k] = pixel[k] + through * background[by, bx, k]
            cover = ONE - through
            alpha[y, x] = cover
            depth[y, x] = pixel[3] / cover if cover > ZERO else ZERO
            for k in range(features.shape[1]):
                blended[y, x, k] = pixel[BASE + k]


@kernel()
def _scratch(channels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a worker's arrays: sums [pixels, channels], live and left [rows, STRIDE], a Gaussian's values, a row's weights."""
    return (
        np.zeros((TILE * TILE, channels), np.float32),
        np.zeros((TILE, STRIDE), np.float32),
        np.zeros((TILE, STRIDE), np.float32),
        np.zeros(channels, np.float32),
        np.zeros(STRIDE, np.float32),
    )


@kernel()
def _draw_share(
    worker: int,
    workers: int,
    tiles_x: int,
    starts: np.ndarray,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    ends: np.ndarray,
) -> None:
    scratch = _scratch(BASE + features.shape[1])
    for tile in range(worker, starts.shape[0] - 1, workers):
        _draw_tile(
            tile, tiles_x, starts, gaussian, geometry, depths, colors, features, background, rgb, alpha, depth, blended, ends, scratch
        )


@kernel(parallel=True)
def draw_tiles(
    workers: int,
    tiles_x: int,
    starts: np.ndarray,
    gaussian: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
    rgb: np.ndarray,
    alpha: np.ndarray,
    depth: np.ndarray,
    blended: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Draw all tiles.

    Args:
        workers: Parallel shares of the tiles.
        tiles_x: Tiles in a row of the grid.
        starts, gaussian: Instances, of `bin_tiles`.
        geometry, depths: Of `project_forward`.
        colors, features: [N, 3] and [N, C] float32.
        background: [1, 1, 3] or [H, W, 3] float32.
        rgb, alpha, depth, blended: Outputs [H, W, 3], [H, W], [H, W], [H, W, C] float32.
        ends: Output [tiles] int64: end of the instances of each tile that any pixel was still open to.
    """
    for worker in prange(workers):
        _draw_share(
            worker, workers, tiles_x, starts, gaussian, geometry, depths, colors, features, background, rgb, alpha, depth, blended, ends
        )
