"""Gradients of blending, tile by tile, compiled: replays each tile front to back and sums what every instance receives.

With R the light that arrives from behind Gaussian i (weighted by the picture's gradient), q its values times that gradient, and T
the transmittance before it: dL/dalpha = T q - R / (1 - alpha). R starts as the gradient times the finished picture and loses w q
at every step, so no list of Gaussians per pixel is kept. An instance's sums go to a row of its own (`rows`, one per slot of
`binning.bin_tiles`): six moments (see `projection.MOMENTS`), then the gradients of its values.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ..rules import TILE
from .forward import BASE, CAP, CHECK, FLOOR, HALF, ONE, STOP, STRIDE, ZERO, F, exp8
from .jit import kernel
from .projection import CHUNK, MOMENTS, _unproject_one


@kernel()
def _replay_tile(
    low: int,
    high: int,
    gaussian: np.ndarray,
    slot: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    left_edge: float,
    top_edge: float,
    pull: np.ndarray,
    behind: np.ndarray,
    live: np.ndarray,
    value: np.ndarray,
    weight: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Replay the instances low..high over one tile.

    Args:
        pull: [pixels, channels] gradient of the blended channels.
        behind: [rows, STRIDE] light from behind, R.
        live: [rows, STRIDE] transmittance, 1 at the start and 0 outside the picture.
        value, weight: Scratch [channels], [4, STRIDE].
        rows: Output [slots, MOMENTS + channels].
    """
    channels = pull.shape[1]
    for n in range(low, high):
        i = gaussian[n]
        out = rows[slot[n]]
        record = geometry[i]
        mx, my = record[0] - left_edge - HALF, record[1] - top_edge - HALF
        l11, l12, l22, opacity, reach, half = record[2], record[3], record[4], record[5], record[6], record[7]
        value[0], value[1], value[2], value[3] = colors[i, 0], colors[i, 1], colors[i, 2], depths[i]
        for c in range(features.shape[1]):
            value[BASE + c] = features[i, c]
        for c in range(MOMENTS + channels):
            out[c] = ZERO
        d_value = out[MOMENTS:]
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
            behind_row = behind[row, start:]
            weights, before_row, alphas, dots = weight[0], weight[1], weight[2], weight[3]
            for k in range(count):
                s = s0 + l11 * F(k)
                alpha = min(opacity * exp8(-(HALF * s * s + qq)), CAP)
                if alpha < FLOOR:
                    alpha = ZERO
                before = open_row[k]
                after = before * (ONE - alpha)
                blended = after >= STOP
                before_row[k] = before
                alphas[k] = alpha
                weights[k] = alpha * before if blended else ZERO
                open_row[k] = after if blended else ZERO
            for k in range(count):
                w = weights[k]
                dot = ZERO
                if w != ZERO:
                    pixel = pull[row * TILE + start + k]
                    for c in range(channels):
                        dot += pixel[c] * value[c]
                        d_value[c] += w * pixel[c]
                dots[k] = dot
            g0, g1, g2 = ZERO, ZERO, ZERO
            for k in range(count):
                s = s0 + l11 * F(k)
                alpha, w, dot = alphas[k], weights[k], dots[k]
                rest = behind_row[k] - w * dot
                behind_row[k] = rest
                g = alpha * (before_row[k] * dot - rest / (ONE - alpha))
                if w == ZERO or alpha >= CAP:
                    g = ZERO
                g0 += g
                g1 += g * s
                g2 += g * s * s
            out[0] += g0
            out[1] += g1
            out[2] += g0 * q
            out[3] += g2
            out[4] += g1 * q
            out[5] += g0 * q * q


@kernel()
def _replay_share(
    worker: int,
    workers: int,
    tiles_x: int,
    starts: np.ndarray,
    ends: np.ndarray,
    gaussian: np.ndarray,
    slot: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
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
    channels = BASE + features.shape[1]
    pull = np.zeros((TILE * TILE, channels), np.float32)
    behind = np.zeros((TILE, STRIDE), np.float32)
    live = np.zeros((TILE, STRIDE), np.float32)
    value = np.zeros(channels, np.float32)
    weight = np.zeros((4, STRIDE), np.float32)
    picture_height, picture_width = alpha.shape
    for tile in range(worker, starts.shape[0] - 1, workers):
        low, high, end = starts[tile], starts[tile + 1], ends[tile]
        if end > low:
            x0, y0 = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
            width, height = min(TILE, picture_width - x0), min(TILE, picture_height - y0)
            live[:] = ZERO
            live[:height, :width] = ONE
            for r in range(height):
                y = y0 + r
                by = min(y, background.shape[0] - 1)
                for c in range(width):
                    x = x0 + c
                    bx = min(x, background.shape[1] - 1)
                    pixel = pull[r * TILE + c]
                    through = ONE - alpha[y, x]
                    arriving = -through * d_alpha[y, x]
                    for k in range(3):
                        g = d_rgb[y, x, k]
                        pixel[k] = g
                        arriving += g * rgb[y, x, k]
                    if alpha[y, x] > ZERO:
                        g = d_depth[y, x] / alpha[y, x]
                        pixel[3] = g
                        # sum of w z gives g z alpha; alpha in the denominator gives g z (1 - alpha)
                        arriving += g * depth[y, x]
                    else:
                        pixel[3] = ZERO
                    for k in range(features.shape[1]):
                        g = d_blended[y, x, k]
                        pixel[BASE + k] = g
                        arriving += g * blended[y, x, k]
                    behind[r, c] = arriving
            _replay_tile(
                low, end, gaussian, slot, geometry, depths, colors, features, F(x0), F(y0), pull, behind, live, value, weight, rows
            )
        for n in range(max(end, low), high):
            row = rows[slot[n]]
            for c in range(row.shape[0]):
                row[c] = ZERO


@kernel(parallel=True)
def replay_tiles(
    workers: int,
    tiles_x: int,
    starts: np.ndarray,
    ends: np.ndarray,
    gaussian: np.ndarray,
    slot: np.ndarray,
    geometry: np.ndarray,
    depths: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    background: np.ndarray,
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
    """Fill `rows` [M, MOMENTS + channels], the gradients of all instances.

    Args:
        workers, tiles_x, starts, gaussian, geometry, depths, colors, features, background: As in `forward.draw_tiles`.
        ends, rgb, alpha, depth, blended: What it returned.
        slot: Row of each instance.
        d_rgb, d_alpha, d_depth, d_blended: Gradients of the outputs.
        rows: Output.
    """
    for worker in prange(workers):
        _replay_share(
            worker, workers, tiles_x, starts, ends, gaussian, slot, geometry, depths, colors, features, background,
            rgb, alpha, depth, blended, d_rgb, d_alpha, d_depth, d_blended, rows,
        )  # fmt: skip


@kernel()
def _collect_range(
    low: int,
    high: int,
    order: np.ndarray,
    slots: np.ndarray,
    rows: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    camera: np.ndarray,
    geometry: np.ndarray,
    d_means: np.ndarray,
    d_quats: np.ndarray,
    d_scales: np.ndarray,
    d_opacities: np.ndarray,
    d_colors: np.ndarray,
    d_features: np.ndarray,
) -> None:
    total = np.empty(rows.shape[1], np.float32)
    for k in range(low, high):
        i = order[k]
        total[:] = ZERO
        for slot in range(slots[k], slots[k + 1]):
            for c in range(rows.shape[1]):
                total[c] += rows[slot, c]
        d_opacities[i] = _unproject_one(
            means[i], quats[i], scales[i], opacities[i], camera, geometry[i], total, np.float64(total[MOMENTS + 3]),
            d_means[i], d_quats[i], d_scales[i],
        )  # fmt: skip
        for c in range(3):
            d_colors[i, c] = total[MOMENTS + c]
        for c in range(d_features.shape[1]):
            d_features[i, c] = total[MOMENTS + BASE + c]


@kernel(parallel=True)
def collect(
    order: np.ndarray,
    slots: np.ndarray,
    rows: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    camera: np.ndarray,
    geometry: np.ndarray,
    d_means: np.ndarray,
    d_quats: np.ndarray,
    d_scales: np.ndarray,
    d_opacities: np.ndarray,
    d_colors: np.ndarray,
    d_features: np.ndarray,
) -> None:
    """Sum every Gaussian's rows and carry the sums back through the projection.

    Args:
        order, slots: Of `binning`.
        rows: Of `replay_tiles`.
        means, quats, scales, opacities, camera, geometry: As in `projection.project_forward`.
        d_means, d_quats, d_scales, d_opacities, d_colors, d_features: Outputs, zero on entry, as large as the inputs.
    """
    count = order.shape[0]
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        low = chunk * CHUNK
        high = min(low + CHUNK, count)
        _collect_range(
            low, high, order, slots, rows, means, quats, scales, opacities, camera, geometry,
            d_means, d_quats, d_scales, d_opacities, d_colors, d_features,
        )  # fmt: skip
