"""Contact sheets of a capture. Needs numpy and Pillow."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from grmm_core.data.dataset import CaptureDataset
from grmm_core.errors import ConfigError
from grmm_core.files.access import atomic_write_bytes

BACKGROUND = 0.88


def write_sheet(folder: Path, target: Path, columns: int = 8, limit: int = 64, tile: int = 256) -> int:
    """Write a PNG with pictures spread evenly over people and shots; returns how many.

    Raises:
        ConfigError: The capture has no complete shot yet.
    """
    from PIL import Image

    data = CaptureDataset(folder)
    everything = list(data.views())
    if not everything:
        raise ConfigError(f"{folder} has no complete shot yet; let the capture run first.")
    chosen = [everything[int(i)] for i in np.linspace(0, len(everything) - 1, min(limit, len(everything)))]
    rows = (len(chosen) + columns - 1) // columns
    sheet = Image.new("RGB", (columns * tile, rows * tile), (224, 224, 224))
    for i, (shot, view) in enumerate(chosen):
        rgb = np.round(data.picture(shot, view).over(BACKGROUND) * 255).astype(np.uint8)
        sheet.paste(
            Image.fromarray(rgb).resize((tile, tile), Image.Resampling.LANCZOS), (i % columns * tile, i // columns * tile)
        )
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG")
    atomic_write_bytes(target, buffer.getvalue())
    return len(chosen)
