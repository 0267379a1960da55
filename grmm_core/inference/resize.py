"""Pictures of half and double size, twins of `model.refine.halved` and `doubled`. Needs numpy only."""

from __future__ import annotations

import numpy as np


def halved(picture: np.ndarray) -> np.ndarray:
    """Return averages over 2 x 2 pixels, [H, W, C] to [ceil(H / 2), ceil(W / 2), C]; a last odd row or column stands alone."""
    height, width, _ = picture.shape
    padded = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return (padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]) * np.float32(0.25)


def doubled(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return a picture [h, w, C] enlarged twofold, bilinearly, and cut to [height, width, C]."""
    return _doubled_rows(_doubled_rows(picture).swapaxes(0, 1)).swapaxes(0, 1)[:height, :width]


def _doubled_rows(picture: np.ndarray) -> np.ndarray:
    above, below = np.concatenate([picture[:1], picture[:-1]]), np.concatenate([picture[1:], picture[-1:]])
    near = picture * np.float32(0.75)
    return np.stack([near + above * np.float32(0.25), near + below * np.float32(0.25)], 1).reshape(-1, *picture.shape[1:])
