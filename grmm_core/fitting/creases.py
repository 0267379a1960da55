"""What of a photo's colors belongs to its expression: folds of a smile, furrows of a brow.

The coarse mesh has no normals for them. They lie where the expression stretches or folds the skin, and stand out from the skin
around. Painted on the person they would stay in the neutral face. So they become a color map of the person that comes and goes
with the expression code, as the trained ones do (`model.decoders.ExpressionMaps`): whole in the photo's expression, nothing at
rest.

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..head import HeadModel
from ..model.decoders import ExpressionMaps
from .surface import SKIN, Surface

MAPS = "decoders.expression.maps"
FEATURES = ("lips", "lids", "brows")
STRAIN = (0.08, 0.25)  # share by which skin is stretched or folded: below the first nothing is a crease, above the second all
SPREAD = 3  # times that the strain is averaged over neighbouring vertices: folds lie beside what moves
WIDTH_TEXELS = 10.0  # length below which colors are creases
PORES = 0.03  # of the detail that stays in every expression: about so much of it
RIM_TEXELS, AWAY = 2.0, (0.6, 0.95)  # from features: smoothed share of plain skin
_FAINT = 0.05  # strength of the expression, in the trained maps' weights, below which a photo counts as neutral
_RIDGE = 0.02  # of the other expressions' weights: keeps creases out of those that are unlike


def strained(head: HeadModel, resting: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """How far an expression stretches or folds the skin around each vertex, as a share of its length, [V].

    Args:
        head: Head model.
        resting: Vertices at rest, [V, 3] metres.
        posed: In the expression, likewise.
    """
    faces = head.faces
    before, after = (_plane_edges(np.asarray(vertices, np.float64)[faces]) for vertices in (resting, posed))
    inverse = np.linalg.inv(before + 1e-9 * np.eye(2))
    stretch = np.linalg.svd(after @ inverse, compute_uv=False)  # [F, 2]
    change = np.abs(np.log(np.clip(stretch, 0.2, 5.0))).max(1)
    count = np.bincount(faces.ravel(), minlength=len(resting)).clip(1)
    at = np.bincount(faces.ravel(), np.repeat(change, 3), len(resting)) / count
    for _ in range(SPREAD):
        at = np.bincount(faces.ravel(), np.repeat(at[faces].mean(1), 3), len(resting)) / count
    return at


def _plane_edges(corners: np.ndarray) -> np.ndarray:
    """Two edges of each triangle [F, 3, 3] in its own plane, as columns, [F, 2, 2]."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1).clip(1e-9)
    along = first / length[:, None]
    x = (second * along).sum(1)
    y = np.linalg.norm(second - x[:, None] * along, axis=1)
    return np.stack([np.stack([length, x], -1), np.stack([np.zeros_like(y), y], -1)], 1)


def crease_colors(surface: Surface, colors: Tensor, strain: Tensor, features: Tensor) -> Tensor:
    """The part of the skin's colors [N, 3] that belongs to the photos' expression.

    Args:
        surface: Texels.
        colors: As the photos show them.
        strain: `strained` at the texels, [N].
        features: Lips, lids and brows, [N] bool: their detail is the person's.
    """
    plain = ((surface.group == SKIN) & ~features).to(colors)[:, None]
    around = surface.smooth(colors * plain, WIDTH_TEXELS) / surface.smooth(plain, WIDTH_TEXELS).clamp(min=1e-3)
    detail = colors - around
    lasting = PORES * torch.tanh(detail / PORES)
    share = ((strain - STRAIN[0]) / (STRAIN[1] - STRAIN[0])).clamp(0, 1)
    away = ((surface.smooth(plain, RIM_TEXELS)[:, 0] - AWAY[0]) / (AWAY[1] - AWAY[0])).clamp(0, 1)  # from lips, lids and brows
    return (share * away * plain[:, 0])[:, None] * (detail - lasting)


def crease_maps(
    maps: ExpressionMaps, creases: Tensor, z_id: Tensor, resting: Tensor, shown: Sequence[Tensor], others: Tensor
) -> Tensor | None:  # fmt: skip
    """Change of the trained expression maps that brings creases with the photos' expression.

    Args:
        maps: The trained ones.
        creases: `crease_colors`, [N, 3].
        z_id: Of the person, [Z].
        resting: z_exp of the face at rest, [Y].
        shown: Of each photo, [Y].
        others: Of expressions that should have none of it, [K, Y], added to `resting`.

    Returns:
        Added to `maps.maps`, and to be made up for at rest by `weights(resting) @ change`; None where the photos are neutral.
    """
    gains = 1.0 + maps.gains(z_id)
    weights = maps.weights(torch.stack(list(shown)).mean(0) - resting) * gains  # [M]
    if float(weights.norm()) < _FAINT:
        return None
    rest = maps.weights(others) * gains  # [K, M]
    # u with u . weights = 1 that gives little to expressions which differ
    alike = (rest @ weights / weights.square().sum()).clamp(0, 1)
    square = rest.T @ rest * _RIDGE + torch.outer(weights, weights) + 1e-4 * torch.eye(len(weights)).to(weights)
    direction = torch.linalg.solve(square, weights + _RIDGE * rest.T @ alike)
    direction = direction / (direction @ weights)
    return torch.outer(direction, creases.reshape(-1))
