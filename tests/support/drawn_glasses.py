"""Glasses drawn on a picture of a face, from its landmarks."""

from __future__ import annotations

import numpy as np

from grmm_core.photo.lenses import EYES

LENS, RIM = (0.27, 0.2), 0.06  # half width and height of a lens, in distances of the outer corners; half of a rim, in lenses
BAR = (0.15, 0.02)  # half width and height of the bridge


def with_glasses(
    image: np.ndarray, marks: np.ndarray, frame: np.ndarray | float, tint: np.ndarray | float = 1.0, gleam: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture with glasses, and the pixels of their frames and of their lenses.

    Args:
        image: Display sRGB, [H, W, 3].
        marks: Landmarks, [478, 2].
        frame: Color of the frames.
        tint: That lenses multiply colors by.
        gleam: How much white a reflection adds to the lower half of the lenses.

    Returns:
        [H, W, 3], [H, W] bool, [H, W] bool.
    """
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    unit = np.linalg.norm(marks[263] - marks[33])
    frames = (np.abs(columns - marks[6, 0]) < BAR[0] * unit) & (np.abs(rows - marks[6, 1]) < BAR[1] * unit)
    lenses, lower = np.zeros_like(frames), np.zeros_like(frames)
    for outline in EYES:
        x, y = marks[list(outline)].mean(0)
        away = np.hypot((columns - x) / LENS[0], (rows - y) / LENS[1]) / unit
        frames |= np.abs(away - 1.0) < RIM
        lenses |= away < 1.0 - RIM
        lower |= (away < 0.85) & (rows > y + 0.08 * unit)
    frames &= ~lenses
    worn = np.where(lenses[..., None], image * tint, image)
    worn = np.where(lower[..., None], worn + gleam * (1.0 - worn), worn)
    return np.where(frames[..., None], frame, worn).astype(np.float32), frames, lenses
