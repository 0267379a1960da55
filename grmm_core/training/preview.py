"""Picture sheets that show where a training stands: truth beside rendering, and the people under new expressions.

Used by `trainer`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..controls.frame import Controls, resolve
from ..files.access import atomic_write_bytes
from ..geometry.camera import Camera
from ..pictures.images import encode_png, quantize

if TYPE_CHECKING:
    from .trainer import Trainer

VALIDATION_ROWS = 3
ERROR_GAIN = 4.0
NEW_CONTROLS: tuple[tuple[dict[str, float], float], ...] = (
    ({}, 0.0),
    ({"jawOpen": 0.7}, 20.0),
    ({"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.5, "cheekSquintRight": 0.5}, -30.0),
    ({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 0.3, "mouthPucker": 0.8}, 75.0),
)
"""Expressions and camera yaw in degrees of the sheet's lower rows."""
_BACKGROUND = 0.5


@torch.no_grad()
def write_preview(trainer: Trainer, path: Path) -> None:
    """Write a sheet: rows of (truth, refined, splatted, error) for held-out views, then people under new expressions."""
    rows: list[Tensor] = []
    source = trainer.source
    views = source.validation if len(source.validation) else source.training
    picks = views[np.linspace(0, len(views) - 1, VALIDATION_ROWS + 2).astype(int)[1:-1]]
    refine = trainer.model.refinement is not None
    with trainer.averaged():
        size = 0
        for index in picks:
            view = trainer._sized(source.load(int(index)))
            grey = np.full(3, _BACKGROUND, np.float32)
            rendering, _ = trainer.draw(view, grey, refine)
            truth = trainer._target(view, grey).image
            error = (rendering.image - truth).abs() * ERROR_GAIN
            rows.append(torch.cat([truth, rendering.image, rendering.raw, error], 1))
            size = max(view.image.shape[:2])
        for person in np.linspace(0, len(source.people) - 1, 2).astype(int):
            rows.append(torch.cat([_portrait(trainer, int(person), c, yaw, size) for c, yaw in NEW_CONTROLS], 1))
    width = min(row.shape[1] for row in rows)
    sheet = torch.cat([row[:, :width] for row in rows], 0).clamp(0, 1).cpu().numpy()
    atomic_write_bytes(path, encode_png(quantize(sheet)))


def _portrait(trainer: Trainer, person: int, controls: dict[str, float], yaw: float, size: int) -> Tensor:
    model = trainer.model
    resolved = resolve(Controls().set_named(controls), model.head_model)
    expression, pose, aligned = (trainer._tensor(a) for a in (resolved.expression, resolved.pose, resolved.aligned))
    shape = trainer.shapes[person]
    camera = Camera.orbit(size, size, yaw=yaw, pitch=5.0, distance=1.2, fov=20.0)
    picture = model.render(
        camera, shape=shape, expression=expression, pose=pose, z_id=model.z_identity(trainer.codes[person], shape),
        z_exp=model.z_expression(aligned, expression=expression), background=(_BACKGROUND,) * 3, backend=trainer.backend,
    )  # fmt: skip
    return picture.image
