"""Lips, teeth, tongue: few pixels of a photo, which every word shows from near.

Tracking is out by a pixel or two, a smile stretches lips, gloss lies on them, teeth stand in their shade. Painted texel by
texel that is patches of white, red and grey as soon as the mouth moves. At rest lips and teeth are the prior's in the tone that
the photo shows of them, with a little of what else it shows; the rest belongs to the photo's expression (`Tuner.changes`).

Called by `inpainting`. Imports torch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .surface import Surface

LIPS_DETAIL, DETAIL = 0.05, 0.03  # of a color, that lips keep beside their tone, and teeth and what is behind them
TEETH_LIGHT, TEETH_TINT = (0.75, 1.1), 0.05  # of a tooth's tone over the prior's: lightness, and how far tints differ
EDGE_TEXELS = 1.0  # over which lips go over into skin: the prior's end in steps of a texel
_TOLD = 0.5  # knowledge from which on a texel tells the tone
_FEW_TEXELS = 40
_REDDER = 0.05  # logarithm of red over green, by which lips are redder than skin at least


def plain_mouth(surface: Surface, prior: Tensor, change: Tensor, known: Tensor, outer: Tensor, parts: Tensor) -> Tensor:
    """Changes of color [N, 3]: `outer` on skin, `parts` elsewhere, but for what mouths have at rest.

    Args:
        surface: Texels.
        prior: Colors of stage 1, [N, 3].
        change: To what the photos show, [N, 3].
        known: How far that is known, 0..1, [N].
        outer: Changes of skin, lips as if they were skin, [N, 3].
        parts: Changes of lips and of what is inside, [N, 3]: what stays where a photo tells no tone.
    """
    found = torch.where(surface.skin[:, None], outer, parts)
    tone = _tone(prior, change, surface.lips & (known > _TOLD))
    if tone is None:
        found = torch.where(surface.lips[:, None], parts, found)
    else:
        lips = _near(prior * (tone - 1.0), change, known * surface.lips, LIPS_DETAIL)
        found = torch.where(surface.skin[:, None], outer.lerp(lips, _lip_share(surface, prior)[:, None]), found)
    tone = _tone(prior, change, surface.teeth & (known > _TOLD))
    if tone is not None:
        light = tone.mean()
        tone = (tone / light).clamp(1.0 - TEETH_TINT, 1.0 + TEETH_TINT) * light.clamp(*TEETH_LIGHT)
        found = torch.where(surface.teeth[:, None], _near(prior * (tone - 1.0), change, known, DETAIL), found)
    inside = _near(torch.zeros_like(change), change, known, DETAIL)  # what a photo shows there is mostly teeth
    return torch.where(surface.inside[:, None], inside, _soft_edges(surface, prior, found))


def _soft_edges(surface: Surface, prior: Tensor, change: Tensor) -> Tensor:
    """Changes of color [N, 3] with which lips have no hard border."""
    if not bool(surface.lips.any()):
        return change
    share = surface.smooth(_lip_share(surface, prior)[:, None], EDGE_TEXELS)
    edge = (4.0 * share * (1.0 - share)).clamp(0, 1) * surface.skin[:, None]
    return torch.lerp(change, surface.smooth(prior + change, EDGE_TEXELS) - prior, edge)


def _tone(prior: Tensor, change: Tensor, told: Tensor) -> Tensor | None:
    """Factor of the prior's colors that the told texels show in the middle, [3]; None where they are few."""
    if int(told.sum()) < _FEW_TEXELS:
        return None
    return torch.quantile((prior + change)[told] / prior[told].clamp(min=1e-2), 0.5, dim=0)


def _lip_share(surface: Surface, prior: Tensor) -> Tensor:
    """How far texels are lips by the prior's redness, 0..1, [N]: the mesh's lips end beside those that are seen."""
    red, green = prior[:, :2].clamp(min=1e-2).T
    redness = (red / green).log()
    skin, lips = (redness[part].median() for part in ((surface.lip_rim > 0.0) & (surface.lip_rim < 1.0), surface.lips))
    share = (redness - skin) / (lips - skin).clamp(min=_REDDER)
    return share.clamp(0, 1) * torch.maximum(surface.lips.to(prior), surface.lip_rim)


def _near(plain: Tensor, change: Tensor, known: Tensor, most: float) -> Tensor:
    """Changes [N, 3] near plain ones, with a little of what is known of others."""
    return plain + known[:, None] * most * torch.tanh((change - plain) / most)
