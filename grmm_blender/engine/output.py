"""Whether there is room for the picture before it is drawn.

Blender saves pictures after the engine is done, and does not notice every failed write: on a full disk an animation in the
background would go on and count cut-off files as frames.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from ...grmm_core.errors import FileAccessError

_BYTES_PER_PIXEL = 4  # of an uncompressed 8-bit picture; one that compresses worse than not at all is not expected
_HEADER_BYTES = 1 << 16


def check_space(scene: bpy.types.Scene, width: int, height: int) -> None:
    """Make sure that a picture of so many pixels fits on the disk that the scene's output is on.

    Raises:
        FileAccessError: It does not.
    """
    target = Path(bpy.path.abspath(scene.render.filepath or "//"))
    folder = next((parent for parent in target.parents if parent.is_dir()), None)
    if folder is None:
        return  # Blender makes the folder, or says that it cannot
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # network drives that do not tell
    if free < width * height * _BYTES_PER_PIXEL + _HEADER_BYTES:
        raise FileAccessError(
            f"The disk of {folder} is full ({free / 2**20:.1f} MiB are free); make room or choose another output folder."
        )
