"""Picture sheets that show where a training stands: truth beside rendering, and the people under new expressions.

Used by `trainer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..files.access import atomic_write_bytes
from ..geometry.camera import Camera
from ..model.portrait import portrait
from ..pictures.images import encode_png, quantize
from .cast import Cast
from .views import View

VALIDATION_ROWS = 3
ERROR_GAIN = 4.0
NEW_CONTROLS: tuple[tuple[dict[str, float], float], ...] = (
    ({}, 0.0),
    ({"jawOpen": 0.7}, 20.0),
    ({"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.5, "cheekSquintRight": 0.5}, -30.0),
    ({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 0.3, "mouthPucker": 0.8}, 75.0),
)
"""Expressions and camera yaw in degrees of the sheet's lower rows."""
_GREY = (0.5, 0.5, 0.5)


@torch.no_grad()
def write_preview(cast: Cast, views: Sequence[View], path: Path) -> None:
    """Write a sheet: rows of (truth, refined, splatted, error) of views, then people under new expressions.

    Args:
        cast: With the parameters to be shown.
        views: At the size to be drawn.
        path: PNG to write.

    Raises:
        FileAccessError: The file cannot be written.
    """
    rows: list[Tensor] = []
    refine = cast.model.refinement is not None
    for view in views:
        rendering = cast.draw(view, np.array(_GREY, np.float32), refine)
        truth = cast.target(view, _GREY).image
        error = (rendering.image - truth).abs() * ERROR_GAIN
        rows.append(torch.cat([truth, rendering.image, rendering.raw, error], 1))
    size = max((max(view.image.shape[:2]) for view in views), default=0)
    for index in np.linspace(0, len(cast.codes) - 1, 2).astype(int):
        person, pictures = cast.person(int(index)), []
        for controls, yaw in NEW_CONTROLS:
            camera = Camera.orbit(size, size, yaw=yaw, pitch=5.0, distance=1.2, fov=20.0)
            pictures.append(portrait(cast.model, person, controls, camera, _GREY, cast.backend).image)
        rows.append(torch.cat(pictures, 1))
    width = min(row.shape[1] for row in rows)
    sheet = torch.cat([row[:, :width] for row in rows], 0).clamp(0, 1).cpu().numpy()
    atomic_write_bytes(path, encode_png(quantize(sheet)))
