"""Lids: skin that hardly any photo shows, and every blink does.

In a photo they are a few pixels high, folded, in the shade of the brow, with lashes over them and the eye beside: painted on
the person they come out as grey patches when the eyes close. Plain skin there is that of the person around the eyes, as the
prior's lids are beside the prior's skin; the rest of what a photo shows of them belongs to its expression.

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..controls.names import ARKIT_NAMES
from ..head import HeadModel
from ..model.grmm import GRMM
from .inpainting import BARE_SKIN, corners_of
from .photo_targets import FitView
from .surface import SKIN, Surface

FOLDED_TRAVEL = (0.001, 0.003)  # metres that closing the eyes moves skin: below the first it was seen, above the second folded
LID_TRAVEL = (0.001, 0.004)  # likewise from the face at rest: below the first skin is no lid, above the second it is
LASH_LINE = (0.0018, 0.0032)  # metres from the lashes up to which a lid's edge keeps its dark line, and from where it does not
LIGHTNESS = (0.88, 1.02)  # of a lid over that of plain skin as the prior has it
_BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
_FEW_TEXELS = 100


def lid_exposure(model: GRMM, view: FitView) -> Tensor:
    """How much each texel's skin lies folded in a photo's lids and comes out when the eyes close, 0..1, [N]."""
    return _moved_by_blinks(model, view.shape.cpu().numpy(), view.expression.cpu().numpy(), FOLDED_TRAVEL).to(view.image)


def lid_share(model: GRMM, view: FitView) -> Tensor:
    """How much each texel's skin belongs to a lid beyond its lash line, 0..1, [N]; the photo tells the shape only.

    0 where Gaussians have hair: there the fill knows folded skin by its shade.
    """
    if not model.config.hairless:
        return torch.zeros(model.gaussian_count).to(view.image)
    expression = np.zeros_like(view.expression.cpu().numpy())
    return _moved_by_blinks(model, view.shape.cpu().numpy(), expression, LID_TRAVEL).to(view.image)


def lash_line(model: GRMM) -> tuple[Tensor, Tensor]:
    """How far each texel lies on the dark line of the lashes, 0..1, [N], and whether on an upper lid's, likewise.

    Skin beside the lashes that is no plain lid (`lid_share`); 0 where Gaussians have hair, and on heads without lashes.
    """
    nothing, head = torch.zeros(model.gaussian_count).to(model.anchor.barycentric), model.head_model
    marked = torch.as_tensor(head.marked("lashes"))
    if not model.config.hairless or not bool(marked.any()):
        return nothing, nothing > 0.0
    corners, barycentric = torch.as_tensor(corners_of(model)), model.anchor.barycentric.cpu()
    mean = torch.as_tensor(np.array(head.v_template, np.float32))
    positions = (mean[corners] * barycentric[..., None]).sum(1)
    lashes = mean[marked]
    low, high = lashes.amin(0) - LASH_LINE[1], lashes.amax(0) + LASH_LINE[1]
    skin = (_lids(head)[corners][..., 0] > 0.0).all(1)
    rows = torch.nonzero(((positions > low) & (positions < high)).all(1) & skin)[:, 0]
    far, nearest = torch.cdist(positions[rows], lashes).min(1)
    share = torch.zeros(len(positions))
    share[rows] = ((LASH_LINE[1] - far) / (LASH_LINE[1] - LASH_LINE[0])).clamp(0, 1)
    upper = torch.zeros(len(positions), dtype=torch.bool)
    upper[rows] = lashes[nearest, 1] > lashes[:, 1].mean()
    return share.to(nothing), upper.to(nothing.device)


def _moved_by_blinks(model: GRMM, shape: np.ndarray, expression: np.ndarray, limits: tuple[float, float]) -> Tensor:
    head = model.head_model
    closed = expression.copy()
    for name in _BLINKS:
        closed = np.maximum(closed, head.arkit_to_expression[ARKIT_NAMES.index(name)][: len(closed)])
    pose = np.zeros((5, 3), np.float32)
    moved = head.vertices(shape, closed, pose) - head.vertices(shape, expression, pose)
    travel = torch.as_tensor(np.linalg.norm(moved, axis=1).astype(np.float32))[:, None] * _lids(head)
    corners, barycentric = torch.as_tensor(corners_of(model)), model.anchor.barycentric.cpu()
    at_texels = (travel[corners][..., 0] * barycentric).sum(1)
    moves = ((at_texels - limits[0]) / (limits[1] - limits[0])).clamp(0, 1)
    if not model.config.hairless:
        return moves
    mean = torch.as_tensor(np.array(head.v_template, np.float32))
    rows = torch.nonzero(moves > 0.0)[:, 0]
    far = torch.full_like(moves, LASH_LINE[1])
    positions = (mean[corners[rows]] * barycentric[rows][..., None]).sum(1)
    far[rows] = torch.cdist(positions, mean[torch.as_tensor(head.marked("lashes"))]).amin(1).to(far)
    return moves * ((far - LASH_LINE[0]) / (LASH_LINE[1] - LASH_LINE[0])).clamp(0, 1)


def _lids(head: HeadModel) -> Tensor:
    """1 at vertices of face and lids, [V, 1]: eyeballs and lashes are not skin."""
    chosen = torch.zeros(head.vertex_count, 1)
    for name in ("face", "lids"):
        if name in head.regions:
            chosen[torch.as_tensor(np.array(head.regions[name]))] = 1.0
    for name in ("left_eyeball", "right_eyeball", "lashes"):
        if name in head.regions:
            chosen[torch.as_tensor(np.array(head.regions[name]))] = 0.0
    return chosen


def plain_lids(surface: Surface, colors: Tensor, prior: Tensor, share: Tensor, known: Tensor) -> Tensor:
    """Colors [N, 3] with lids of the person's plain skin.

    Args:
        surface: Texels.
        colors: Of the person, [N, 3].
        prior: That the weights decode for this person, likewise.
        share: `lid_share`, [N].
        known: How far each texel's color is known, 0..1, [N].
    """
    told = known * (surface.group == SKIN) * ~surface.lips * (1.0 - share)
    sample = colors[told > 0.5]
    if len(sample) < _FEW_TEXELS:
        return colors
    bare = sample.mean(1) > torch.quantile(sample, 0.5, dim=0).mean() - BARE_SKIN  # without brows and shadows
    change = (sample / prior[told > 0.5].clamp(min=1e-3))[bare]
    expected = prior * torch.quantile(change, 0.5, dim=0)
    lightness, usual = colors.mean(1, keepdim=True), expected.mean(1, keepdim=True).clamp(min=1e-3)
    plain = expected * (lightness / usual).clamp(*LIGHTNESS)
    return torch.lerp(colors, plain, share[:, None])
