"""Detail of seen skin carried on to skin that no photo shows, so that they meet in texture as they do in tone.

Filled-in skin is smooth. Beside seen wrinkles, spots and pores it would be a patch of somebody else's. So it gets noise whose
strength in each band of sizes is that of the seen skin (after Heeger and Bergen 1995, on the surface instead of a picture): on
an old face much, on a young one hardly any. Called by `inpainting`. Imports torch.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from .surface import Surface

BANDS = (1.0, 2.0, 4.0)  # texels: lengths between which a band of detail lies; the first is finer than the first length
PLAIN = 0.8  # share of the seen skin, the evenest, that tells how strong its detail is: the rest are folds and marks
_PLAIN_VARIANCE = 0.437  # of a normal variable within so much of its middle


def grain(surface: Surface, colors: Tensor, sample: Tensor) -> Tensor:
    """Detail all over the surface [N, 3] of the strength, in each band, and of the color of a sample's; alike in every run.

    Args:
        surface: Texels.
        colors: Or changes of colors, [N, 3].
        sample: Plain skin that was seen, [N] bool.
    """
    white = torch.randn(len(colors), 1, generator=torch.Generator().manual_seed(0)).to(colors)
    total = torch.zeros_like(colors)
    for seen, noise in zip(_bands(surface, colors), _bands(surface, white), strict=True):
        detail = seen[sample] - seen[sample].median(0).values
        odd = detail.mean(1).abs()
        detail = detail[odd <= torch.quantile(odd, PLAIN)]
        values, directions = torch.linalg.eigh(detail.T @ detail / (len(detail) * _PLAIN_VARIANCE))
        main = directions[:, -1] * directions[:, -1].sum().sign()  # light and dark alone: of other colors it would be dots
        total += noise / noise[sample].std().clamp(min=1e-6) * main * values[-1].clamp(min=0.0).sqrt()
    return total


def _bands(surface: Surface, values: Tensor) -> list[Tensor]:
    """Values [N, C] by the size of their detail, finest first; what is wider than the last band is left out."""
    levels = [values, *(surface.smooth(values, texels) for texels in BANDS)]
    return [fine - coarse for fine, coarse in itertools.pairwise(levels)]
