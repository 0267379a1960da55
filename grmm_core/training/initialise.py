"""Mean colors from the pictures, before the first step.

Starting from the average color of every texel instead of grey was worth several decibels in short trainings. Each texel is
projected into training pictures; it counts where it faces the camera and the picture's depth agrees, and texels that hardly
any picture sees so (under hair, in the mouth) fall back to what lies in front of them, then to the average of all.

Used by `trainer`.
"""

from __future__ import annotations

import numpy as np
import torch

from ..model.grmm import GRMM
from .views import View, ViewSource

_FACING = 0.25  # smallest cosine between normal and view
_SURFACE_TOLERANCE = 0.004  # metres: the texel itself is what the picture shows
_COVER_TOLERANCE = 0.08  # metres: hair in front of it
_COVER_WEIGHT = 1e-3
_GREY_WEIGHT = 1e-6


@torch.no_grad()
def initialise_colors(model: GRMM, source: ViewSource, views: int, seed: int) -> None:
    """Set the mean color map (or the appearance decoder's last bias) from training pictures.

    Args:
        model: Before training.
        source: Data.
        views: How many training views to use.
        seed: Of their choice.
    """
    rng = np.random.default_rng((seed, 3))
    chosen = rng.permutation(len(source.training))[:views]
    total = np.zeros((model.gaussian_count, 3))
    weight = np.zeros((model.gaussian_count, 1))
    flat = np.zeros(3)
    for position in chosen:
        view = source.load(int(source.training[position]))
        colors, weights = _project(model, view, source.shapes[view.subject])
        total += colors * weights
        weight += weights
        covered = view.image[view.mask > 250]
        flat += covered.mean(0) / 255.0 / len(chosen) if len(covered) else 0.0
    mean = (total + _GREY_WEIGHT * flat) / (weight + _GREY_WEIGHT)
    means = torch.as_tensor(mean, dtype=model.dtype, device=model.device)
    appearance = model.decoders.appearance_mean
    if appearance is not None:
        appearance[:, :3] = means
    else:
        model.decoders.appearance.last_bias[:3] = means.mean(0)


def _project(model: GRMM, view: View, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colors [N, 3] of the texels in a picture and their weights [N, 1]."""
    arrays = (shape, view.expression, view.pose)
    frames = model.anchor(model.vertices(*(torch.as_tensor(a, dtype=model.dtype, device=model.device) for a in arrays)))
    normals = frames.normals.cpu().numpy().astype(np.float64)
    positions = frames.positions.cpu().numpy().astype(np.float64)
    camera = view.camera
    towards = camera.position - positions
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = (normals * towards).sum(1)
    seen = positions @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = camera.fx * seen[:, 0] / seen[:, 2] + camera.cx
        y = camera.fy * seen[:, 1] / seen[:, 2] + camera.cy
    inside = (seen[:, 2] > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height) & (cosine > _FACING)
    column, row = np.where(inside, x, 0).astype(np.int64), np.where(inside, y, 0).astype(np.int64)
    inside &= view.mask[row, column] > 250
    weights = np.where(inside, cosine, 0.0)
    if view.depth is not None:
        behind = seen[:, 2] - view.depth[row, column]  # how far the texel lies behind what the picture shows
        surface = np.abs(behind) < _SURFACE_TOLERANCE
        cover = (behind > -_SURFACE_TOLERANCE) & (behind < _COVER_TOLERANCE)
        weights = weights * np.where(surface, 1.0, np.where(cover, _COVER_WEIGHT, 0.0))
    return view.image[row, column] / 255.0, weights[:, None]
