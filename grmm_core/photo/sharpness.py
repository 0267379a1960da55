"""How sharp a face is in a photo: a face that is wholly out of focus gives an avatar of fog.

Called by `fitting.track` before anything is fitted. Needs torch.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

SIDE = 128  # pixels to which a face is brought
FINE, COARSE = 1.0, 4.0  # pixels of it: standard deviation from which, to twice of which, each band of detail goes
BLURRED = 0.15  # of the coarse band's contrast: less in the fine one, and eyes and mouth have no outlines


def sharpness(face: Tensor) -> float:
    """Contrast of a face's fine detail (1 to 2 pixels of 128) over that of its coarse forms (4 to 8).

    Both bands change alike with exposure and contrast, and noise adds to the fine one. Photos, paintings, JPEG of quality 10
    and faces of 64 pixels enlarged have 0.43 to 0.87; blurred by a standard deviation of 2.7 % of their height they
    have 0.19, by 6 % 0.11.

    Args:
        face: Grey, 0..1, [1, 1, H, W]; cut out with little around it.
    """
    size = (SIDE, SIDE)
    small = functional.interpolate(face, size, mode="bilinear", antialias=True, align_corners=False)
    fine, coarse = ((_smoothed(small, sigma) - _smoothed(small, 2.0 * sigma)).std() for sigma in (FINE, COARSE))
    return float(fine / coarse.clamp_min(1e-6))


def _smoothed(picture: Tensor, sigma: float) -> Tensor:
    """A picture [1, 1, H, W] under a Gaussian of so many pixels."""
    reach = int(3.0 * sigma) + 1
    weights = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, dtype=picture.dtype) / sigma) ** 2)
    weights = weights / weights.sum()
    padded = functional.pad(picture, (reach,) * 4, mode="replicate")
    return functional.conv2d(functional.conv2d(padded, weights.view(1, 1, 1, -1)), weights.view(1, 1, -1, 1))
