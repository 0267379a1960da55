"""Errors of one picture against the truth. Used by `protocols`; pictures are [H, W, 3] display sRGB over black."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from ..training.losses import psnr, ssim_map

MASK_LEVEL = 0.5
SMALLEST_REGION = 24
"""Pixels; a region that shows fewer in a view does not count there."""

Distance = Callable[[Tensor, Tensor], Tensor]


@dataclass
class Errors:
    """Figures of one picture.

    Attributes:
        psnr, psnr_mask: dB over the whole frame and inside the mask.
        ssim, ssim_mask: Likewise; inside the mask the map of similarities is averaged there.
        rmse, rmse_mask: Root mean squared error of values 0..1.
        perceptual: Distance name to value, whole frame.
        regions: Region to (sum of squared errors over pixels and channels, number of values).
        turned: Mean angle between directions of strands, degrees; NaN where nothing says.
    """

    psnr: float
    psnr_mask: float
    ssim: float
    ssim_mask: float
    rmse: float
    rmse_mask: float
    perceptual: dict[str, float] = field(default_factory=dict)
    regions: dict[str, tuple[float, int]] = field(default_factory=dict)
    turned: float = math.nan


@torch.no_grad()
def errors_of(
    image: Tensor,
    truth: Tensor,
    mask: Tensor,
    regions: Mapping[str, np.ndarray] | None = None,
    distances: Mapping[str, Distance] | None = None,
) -> Errors:
    """Compare a picture with the truth.

    Args:
        image: [H, W, 3].
        truth: [H, W, 3].
        mask: Coverage 0..1, [H, W].
        regions: Region name to the pixels that show it, [H, W] bool.
        distances: Perceptual networks by name.
    """
    image, truth = image.clamp(0.0, 1.0), truth.clamp(0.0, 1.0)
    inside = mask > MASK_LEVEL
    squared = (image - truth).square()  # [H, W, 3]
    similarity = ssim_map(image, truth).mean(0)  # [H, W]
    covered = bool(inside.any())
    result = Errors(
        psnr=psnr(image, truth), psnr_mask=psnr(image, truth, mask),
        ssim=float(similarity.mean()), ssim_mask=float(similarity[inside].mean()) if covered else math.nan,
        rmse=float(squared.mean().sqrt()), rmse_mask=float(squared[inside].mean().sqrt()) if covered else math.nan,
    )  # fmt: skip
    for name, distance in (distances or {}).items():
        result.perceptual[name] = float(distance(image, truth))
    for name, pixels in (regions or {}).items():
        count = int(pixels.sum())
        if count >= SMALLEST_REGION:
            chosen = squared[torch.from_numpy(np.ascontiguousarray(pixels)).to(squared.device)]
            result.regions[name] = (float(chosen.double().sum()), 3 * count)
    return result
