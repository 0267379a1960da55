"""Pictures in memory as photos; one with two people, put together from the two portraits of `tests/data/photos`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from grmm_core.fitting.track import AnalysedPhoto, analyse_photo
from grmm_core.pictures.images import encode_png, quantize


def analyse_picture(pixels: np.ndarray) -> AnalysedPhoto:
    """The faces of display sRGB 0..1, [H, W, 3]. Raises `NoFaceError`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        path.write_bytes(encode_png(quantize(pixels)))
        return analyse_photo(path)


def two_people(photo_file: Callable[[str], Path]) -> np.ndarray:
    """The smaller face left, the larger one right, uint8, [320, 640, 3]."""
    corners = {"astronaut": (64, 0), "admiral": (96, 100)}
    boxes = {name: (left, top, left + 320, top + 320) for name, (left, top) in corners.items()}
    return np.concatenate([Image.open(photo_file(name)).convert("RGB").crop(box) for name, box in boxes.items()], axis=1)
