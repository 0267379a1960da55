"""Which of several photos to believe about a place of the skin, where they do not agree.

How well a photo's light is known is told for the photo as a whole (`person_lights`), but a light that is found well on cheeks
may be wrong in a socket or beside the nose, where its shade ends. There one photo shows skin as the prior expects it and the
next one has a shadow that nothing explains: what it shows there is believed as much less as it is farther from the prior than
the nearest of the photos. What all of them show otherwise is the person's and is not touched.

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .surface import Surface

APART = 0.02  # display sRGB: a photo that is farther from the prior than the nearest one by so much counts half
WIDTH = 3.0  # texels over which that is looked at: single texels differ by noise
_KNOWN = 0.3  # how well a texel is seen by a photo that is compared


def agreement(surface: Surface, deviations: Tensor, seen: Tensor) -> Tensor:
    """How far each photo is believed, 0..1, [P, N]; 1 for the one that is nearest to the prior, and where none shows anything.

    Args:
        surface: Texels.
        deviations: Colors that each photo alone would have, less the prior's, [P, N, 3].
        seen: How well each photo shows each texel, 0..1, [P, N].
    """
    squares = torch.stack([surface.smooth(one.square().sum(1, keepdim=True), WIDTH)[:, 0] for one in deviations])
    known = seen > _KNOWN
    least = torch.where(known, squares, torch.inf).amin(0)
    excess = (squares - least).clamp(min=0.0)
    return torch.where(known.any(0), 1.0 / (1.0 + excess / APART**2), torch.ones_like(excess))
