"""Skin has nearly one tint: what of a photo's tints is wide and stronger than people's is colored light.

A photo's light is found by what varies with the normals and by what is wide, and where two lamps differ in color some of their
tints stay in the skin: an orange middle of the face beside grey cheeks, yellow lids, blue noses. Skin that no photo shows has
the prior's tint beside it. Here the tint of all skin, the logarithm of its linear color less the mean of the channels, is
compared with that of the mean person: what a face has beyond that is kept as far as people have it, and likewise what that skin
which no photo shows has beyond the skin that one shows. The photos' lights take what goes (`settling.locally_lit`).

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..light.relight import to_display, to_linear
from .surface import SKIN, Surface

PEOPLE = 0.05  # of the logarithm: root mean square of a person's tints beside the mean person's, faces in plain light
WIDTH_TEXELS, REACH_TEXELS = 4.0, 16.0  # what is narrower is no light; how far what was seen goes on
_FEW = 0.05  # of what is around a texel: by so much plain skin, or seen skin, means are half believed
_SEEN, _DARKEST, _FEW_TEXELS = 0.5, 1e-3, 100


def even_tint(surface: Surface, colors: Tensor, mean_person: Tensor, known: Tensor) -> Tensor:
    """Colors whose wide tints are as strong as people's, display sRGB [N, 3].

    Brows and lips, which have tints of their own, go with the skin around them.

    Args:
        surface: Texels.
        colors: Of a person, [N, 3].
        mean_person: Of the weights' mean person, [N, 3].
        known: How well each is known from photos, 0..1, [N].
    """
    skin = surface.group == SKIN
    plain = (skin & ~surface.lips & ~surface.brows).to(colors) * (1.0 - surface.lip_rim)
    seen = plain * known * (1.0 - surface.below)
    if int((seen > _SEEN).sum()) < _FEW_TEXELS:
        return colors
    columns = [to_linear(part.clamp(0.0, 1.0)) for part in (colors, mean_person)]
    own, mean, amid = _mean_around(surface, torch.cat(columns, 1), plain, WIDTH_TEXELS).split(3, 1)
    wide = amid * (_tint(own) - _tint(mean))
    wide = wide - torch.quantile(wide[seen > _SEEN], 0.5, dim=0)
    gone_on, near = _mean_around(surface, wide, seen, REACH_TEXELS).split(3, 1)
    told, guessed = _of_people(wide, seen), near * gone_on
    guessed = told * guessed + _of_people(wide - guessed, plain * (1.0 - known)) * (wide - guessed)
    kept = torch.lerp(guessed, told * wide, surface.smooth(seen[:, None], WIDTH_TEXELS).clamp(0, 1))
    changed = colors + to_display(columns[0] * torch.exp(kept - wide)) - to_display(columns[0])
    return torch.where(skin[:, None], changed, colors)


def _of_people(tints: Tensor, weights: Tensor) -> float:
    """Which share of tints [N, 3] is a person's, by how strong they are where weights [N] are."""
    strength = float((weights[:, None] * tints.square()).sum() / (3.0 * weights.sum()).clamp(min=1e-6))
    return min(1.0, PEOPLE**2 / max(strength, 1e-9))


def _tint(linear: Tensor) -> Tensor:
    logarithm = linear.clamp(min=_DARKEST).log()
    return logarithm - logarithm.mean(1, keepdim=True)


def _mean_around(surface: Surface, values: Tensor, weights: Tensor, texels: float) -> Tensor:
    """Means of values [N, C] by weights [N] over some texels, and how much there is to tell them, 0..1: [N, C + 1]."""
    total = surface.smooth(torch.cat([values * weights[:, None], weights[:, None]], 1), texels)
    weight = total[:, -1:].clamp(min=1e-4)
    return torch.cat([total[:, :-1] / weight, weight / (weight + _FEW)], 1)
