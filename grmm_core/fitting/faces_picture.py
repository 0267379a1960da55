"""The faces of a photo as a picture: numbered boxes, the wanted face's landmarks, the person's outline.

For the user who checks the choice before minutes are spent. Called by `grmm fit --find-faces`. Needs torch and Pillow.
"""

from __future__ import annotations

import numpy as np

from ..errors import ConfigError
from ..photo.person import person_mask
from ..pictures.images import quantize
from .track import AnalysedPhoto

PICTURE_SIDE = 640  # pixels of the longer side
WANTED_COLOR, OTHER_COLOR, LANDMARK_COLOR = (60, 255, 90), (255, 200, 60), (90, 220, 255)
_OUTSIDE = 0.35  # brightness of what is not the person


def draw_faces(analysed: AnalysedPhoto, face: int = 0, mask: np.ndarray | None = None) -> np.ndarray:
    """Draw what was analysed.

    Args:
        analysed: The photo.
        face: The wanted face.
        mask: The person's outline, 0..1, of any resolution of the photo; None finds it.

    Returns:
        uint8, [H, W, 3], the longer side `PICTURE_SIDE`.

    Raises:
        ConfigError: There is no such face.
    """
    from PIL import Image, ImageDraw

    if not 0 <= face < len(analysed.faces):
        raise ConfigError(
            f"{analysed.photo.path.name} has no face {face + 1}; choose a number from 1 to {len(analysed.faces)}."
        )
    pixels = analysed.photo.pixels
    height, width = pixels.shape[:2]
    scale = PICTURE_SIDE / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if mask is None:
        mask = person_mask(pixels, analysed.faces[face].box)
    shade = np.asarray(Image.fromarray(quantize(mask)).resize(size, Image.Resampling.BILINEAR), np.float32) / 255.0
    picture = np.asarray(Image.fromarray(quantize(pixels)).resize(size, Image.Resampling.LANCZOS), np.float32)
    picture = picture * (_OUTSIDE + (1.0 - _OUTSIDE) * shade[..., None])
    drawn = Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8))
    draw = ImageDraw.Draw(drawn)
    for x, y in analysed.faces[face].landmarks[:, :2] * scale:
        draw.point([(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)], fill=LANDMARK_COLOR)
    for index, one in enumerate(analysed.faces):
        left, top, right, bottom = (float(value) * scale for value in one.box)
        color = WANTED_COLOR if index == face else OTHER_COLOR
        draw.rectangle([left, top, right, bottom], outline=color, width=2)
        draw.text((left + 4, top + 2), str(index + 1), fill=color)
    return np.asarray(drawn)
