"""Compiled loops of refinement at half the resolution, apart from `loops`: pictures without it need not compile them."""

from __future__ import annotations

import numpy as np

from ..compute.kernels import compiled
from .loops import CHANNELS, OPTIONS, PICTURE, PLANES

_HALVE = f"void({CHANNELS}, {PICTURE}, {PICTURE}, {CHANNELS}, {PLANES}, int64, int64)"
_ENLARGE = f"void({PLANES}, {PICTURE}, {CHANNELS}, {PICTURE}, float32, {PLANES}, int64, int64)"


@compiled(nogil=True, signature_or_function=_HALVE, **OPTIONS)
def halve(
    rgb: np.ndarray, depth: np.ndarray, alpha: np.ndarray, features: np.ndarray, out: np.ndarray, first: int, last: int
) -> None:
    """Averages over 2 x 2 pixels, twin of `model.refine.halved`; a last odd row or column stands alone.

    Args:
        rgb: [H, W, 3].
        depth: [H, W].
        alpha: [H, W].
        features: [H, W, F].
        out: Written, all of them in this order, [ceil(H / 2), ceil(W / 2), 5 + F].
        first: Row of `out`.
        last: The row after the last.
    """
    height, width, quarter = alpha.shape[0], alpha.shape[1], np.float32(0.25)
    for y in range(first, last):
        top, low = 2 * y, min(2 * y + 1, height - 1)
        for x in range(out.shape[1]):
            left, right = 2 * x, min(2 * x + 1, width - 1)
            for c in range(3):
                out[y, x, c] = (rgb[top, left, c] + rgb[low, left, c] + rgb[top, right, c] + rgb[low, right, c]) * quarter
            out[y, x, 3] = (depth[top, left] + depth[low, left] + depth[top, right] + depth[low, right]) * quarter
            out[y, x, 4] = (alpha[top, left] + alpha[low, left] + alpha[top, right] + alpha[low, right]) * quarter
            for c in range(features.shape[2]):
                upper = features[top, left, c] + features[top, right, c]
                out[y, x, 5 + c] = (upper + features[low, left, c] + features[low, right, c]) * quarter


@compiled(nogil=True, signature_or_function=_ENLARGE, **OPTIONS)
def enlarge(
    change: np.ndarray, cover: np.ndarray, rgb: np.ndarray, alpha: np.ndarray, least: np.float32, out: np.ndarray,
    first: int, last: int,
) -> None:  # fmt: skip
    """Add a small picture's change to a picture of double size, bilinearly, as a residual times alpha.

    Args:
        change: Residual times alpha, [h, w, 3].
        cover: Alpha of the small picture, [h, w].
        rgb: [H, W, 3].
        alpha: [H, W].
        least: What is divided by at least.
        out: Written, [H, W, 3].
        first: Row of `out`.
        last: The row after the last.
    """
    rows, columns, near, far = cover.shape[0], cover.shape[1], np.float32(0.75), np.float32(0.25)
    line = np.empty((4, columns + 2), np.float32)  # between two rows of the small picture, by channel, its ends twice
    for row in range(first, last):
        y = row // 2
        other = min(max(y + 2 * (row % 2) - 1, 0), rows - 1)
        for x in range(columns):
            for k in range(3):
                line[k, x + 1] = near * change[y, x, k] + far * change[other, x, k]
            line[3, x + 1] = near * cover[y, x] + far * cover[other, x]
        line[:, 0], line[:, columns + 1] = line[:, 1], line[:, columns]
        for side in range(2):
            for x in range((out.shape[1] + 1 - side) // 2):
                column, aside = 2 * x + side, x + 2 * side
                share = alpha[row, column] / max(near * line[3, x + 1] + far * line[3, aside], least)
                for k in range(3):
                    moved = near * line[k, x + 1] + far * line[k, aside]
                    out[row, column, k] = rgb[row, column, k] + share * moved
