"""Separate the person from the background of a photo.

MediaPipe's selfie segmentation gives a soft mask at 256 pixels; a guided filter (He, Sun and Tang, "Guided Image Filtering",
2010) then moves its edge onto the picture's own edges, so that hair and shoulders are followed at full resolution.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .networks import load_networks

MASK_SIZE = 256
GUIDE_RADIUS = 1.0 / 64.0  # of the region's side
STEPS = 4  # pixels of a window's radius for each that its lines are fitted at
GUIDE_EPSILON = 1e-3  # squared intensity below which the picture counts as flat
REGION_SCALE = 2.6  # side of the region around the face relative to the face's box: hair and shoulders


def person_mask(image: np.ndarray, box: np.ndarray | None = None) -> np.ndarray:
    """Return how much of each pixel is person.

    Args:
        image: [H, W, 3] float 0..1, display sRGB.
        box: Left, top, right, bottom of the face in pixels; the mask is computed around it at its own scale and the rest of
            the picture from the whole. None uses the whole picture.

    Returns:
        [H, W] float32 0..1.
    """
    pixels = torch.tensor(np.ascontiguousarray(image), dtype=torch.float32).permute(2, 0, 1)[None]
    mask = _segment(pixels)
    if box is not None:
        left, top, right, bottom = _region(box, pixels.shape[3], pixels.shape[2])
        mask[:, :, top:bottom, left:right] = _segment(pixels[:, :, top:bottom, left:right])
    return mask[0, 0].numpy()


def _region(box: np.ndarray, width: int, height: int) -> tuple[int, int, int, int]:
    half = float(max(box[2] - box[0], box[3] - box[1])) * REGION_SCALE / 2.0
    x, y = (float(box[0] + box[2]) / 2.0, float(box[1] + box[3]) / 2.0)
    return max(0, int(x - half)), max(0, int(y - half)), min(width, int(x + half) + 1), min(height, int(y + half) + 1)


def _segment(pixels: Tensor) -> Tensor:
    """Mask of one picture [1, 3, H, W] -> [1, 1, H, W]."""
    size = pixels.shape[2:]
    small = functional.interpolate(pixels, (MASK_SIZE, MASK_SIZE), mode="bilinear", antialias=True)
    (coarse,) = load_networks()["selfie_segmentation"](small.permute(0, 2, 3, 1))
    mask = functional.interpolate(coarse.permute(0, 3, 1, 2), size, mode="bilinear")
    radius = max(1, round(max(size) * GUIDE_RADIUS))
    return guided_filter(pixels.mean(1, keepdim=True), mask, radius, GUIDE_EPSILON).clamp(0.0, 1.0)


def guided_filter(guide: Tensor, value: Tensor, radius: int, epsilon: float) -> Tensor:
    """Edge-preserving smoothing of `value` by a grey guide, both [B, 1, H, W] (grey-scale form of the paper's eq. 4-6).

    The lines are fitted at a fraction of the size and drawn at the whole one (He and Sun, "Fast Guided Filter", 2015).
    """
    step = max(1, radius // STEPS)
    small_guide, small_value = (functional.avg_pool2d(x, step, ceil_mode=True, count_include_pad=False) for x in (guide, value))
    small = max(1, round(radius / step))
    ones = box_sum(torch.ones_like(small_guide, dtype=torch.float64), small)

    def mean(x: Tensor) -> Tensor:
        return (box_sum(x.double(), small) / ones).to(x.dtype)

    def enlarged(x: Tensor) -> Tensor:
        return functional.interpolate(x, guide.shape[2:], mode="bilinear")

    mean_guide, mean_value = mean(small_guide), mean(small_value)
    covariance = mean(small_guide * small_value) - mean_guide * mean_value
    slope = covariance / (mean(small_guide * small_guide) - mean_guide**2 + epsilon)
    return enlarged(mean(slope)) * guide + enlarged(mean(mean_value - slope * mean_guide))


def box_sum(x: Tensor, radius: int) -> Tensor:
    """Sum over windows of 2 radius + 1 pixels, clipped at the border: running sums, so that the radius costs nothing."""
    for axis in (2, 3):
        total = x.cumsum(axis)
        size = total.shape[axis]
        reach = min(radius, size)
        last = total.narrow(axis, size - 1, 1)
        ahead = torch.cat([total.narrow(axis, reach, size - reach), last.expand_as(total.narrow(axis, 0, reach))], axis)
        start = torch.zeros_like(total.narrow(axis, 0, min(reach + 1, size)))
        x = ahead - torch.cat([start, total.narrow(axis, 0, max(size - reach - 1, 0))], axis)
    return x
