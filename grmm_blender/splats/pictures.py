"""Pictures inside splat files (SOG's WebP planes) decoded by Blender, whose Python has no Pillow. Called by `rigged`."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.errors import FileFormatError

_BYTE = 255.0


def picture_decoder() -> Callable[[bytes], np.ndarray] | None:
    """Return a decoder for `formats.sog`, or None where Pillow is installed and does it."""
    return None if importlib.util.find_spec("PIL") is not None else decode_picture


def decode_picture(data: bytes) -> np.ndarray:
    """Return the bytes of a WebP or PNG picture, [height, width, 4] uint8, top row first.

    Raises:
        FileFormatError: Blender cannot read it.
    """
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder:
        path = Path(folder) / ("picture.png" if data.startswith(b"\x89PNG") else "picture.webp")
        path.write_bytes(data)
        try:
            image = bpy.data.images.load(str(path))
        except RuntimeError as error:
            raise FileFormatError("A picture inside the splat file cannot be decoded; export the file again.") from error
        try:
            # Stored numbers and no colors: as they are, and not multiplied by the fourth of them.
            image.colorspace_settings.name = "Non-Color"
            image.alpha_mode = "CHANNEL_PACKED"
            width, height = image.size
            if not width or not height or image.channels != 4:
                raise FileFormatError("A picture inside the splat file cannot be decoded; export the file again.")
            values = np.empty(width * height * 4, np.float32)
            image.pixels.foreach_get(values)
        finally:
            bpy.data.images.remove(image)
    return np.rint(values.reshape(height, width, 4)[::-1] * _BYTE).astype(np.uint8)
