"""A picture with two people, put together from the two portraits of `tests/data/photos`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image


def two_people(photo_file: Callable[[str], Path]) -> np.ndarray:
    """The smaller face left, the larger one right, uint8, [320, 640, 3]."""
    corners = {"astronaut": (64, 0), "admiral": (96, 100)}
    boxes = {name: (left, top, left + 320, top + 320) for name, (left, top) in corners.items()}
    return np.concatenate([Image.open(photo_file(name)).convert("RGB").crop(box) for name, box in boxes.items()], axis=1)
