"""Contact sheets: tiles with captions in a grid. Pictures are display sRGB 0..1, [H, W, 3], top row first."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np

CAPTION = 18  # pixels above each tile
_TEXT_SIZE = 12.0
_PAPER, _INK = 1.0, 0.15
_MARGIN = 5  # pixels left of a caption


def grid(tiles: list[tuple[str, np.ndarray]], columns: int, captions: bool = True) -> np.ndarray:
    """Put tiles of one size into rows.

    Args:
        tiles: Caption and picture [h, w, 3].
        columns: Tiles in a row.
        captions: Write the captions.

    Returns:
        [H, W, 3] float32.
    """
    height, width = tiles[0][1].shape[:2]
    head = CAPTION if captions else 0
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    sheet = np.full((rows * (height + head), columns * width, 3), _PAPER, np.float32)
    texts = []
    for index, (caption, picture) in enumerate(tiles):
        x, y = (index % columns) * width, (index // columns) * (height + head)
        sheet[y + head : y + head + height, x : x + width] = picture
        texts.append((caption, x, y))
    if captions:
        ink = _write_texts((sheet.shape[0], sheet.shape[1]), texts, width)
        sheet += ink * (_INK - sheet)
    return sheet


def _write_texts(shape: tuple[int, int], texts: list[tuple[str, int, int]], width: int) -> np.ndarray:
    """Return the coverage of texts with Blender's own font, [H, W, 1]; each is cut at the width of its tile."""
    import blf
    import imbuf

    font = 0
    buffer = imbuf.new((shape[1], shape[0]))
    blf.size(font, _TEXT_SIZE)
    blf.color(font, 1.0, 1.0, 1.0, 1.0)
    with blf.bind_imbuf(font, buffer):
        for text, x, y in texts:
            while len(text) > 1 and blf.dimensions(font, text)[0] > width - 2 * _MARGIN:
                text = text[:-2] + "…"
            blf.position(font, x + _MARGIN, shape[0] - y - CAPTION + 5, 0)
            blf.draw_buffer(font, text)
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder:
        path = Path(folder) / "text.png"
        imbuf.write(buffer, filepath=str(path))
        buffer.free()
        image = bpy.data.images.load(str(path))
        try:
            image.colorspace_settings.name = "Non-Color"
            values = np.empty(shape[0] * shape[1] * image.channels, np.float32)
            image.pixels.foreach_get(values)
        finally:
            bpy.data.images.remove(image)
    return values.reshape(*shape, -1)[::-1, :, 3:4]
