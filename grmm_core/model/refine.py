"""Psi_ref: the screen-space refinement network, eq. 14.

A small U-Net reads the splatted colors and features, premultiplied over black, and the min-max normalised depth, and gives a
residual that is added where the avatar covers the pixel: I = I_rgb + alpha * residual. So alpha stays right over any
background, and an untrained network (zero last layer) changes nothing. Any picture size works.

Used by `grmm` and by sessions, which refine several heads in one picture.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..splat.types import RasterOutput
from .config import COLOR_CHANNELS, GRMMConfig
from .steps import depth_range, normalise_depth, refinement_grid, refinement_margin

SLOPE = 0.2
_THIN_COVER = 1e-6  # keeps the division by an enlarged alpha defined; where that is 0, so is alpha itself


def halved(picture: Tensor) -> Tensor:
    """Return averages over 2 x 2 pixels, [H, W, C] to [ceil(H / 2), ceil(W / 2), C]; a last odd row or column stands alone."""
    small = nn.functional.avg_pool2d(picture.permute(2, 0, 1)[None], 2, ceil_mode=True, count_include_pad=False)
    return small[0].permute(1, 2, 0)


def doubled(picture: Tensor, height: int, width: int) -> Tensor:
    """Return a picture [h, w, C] enlarged twofold, bilinearly, and cut to [height, width, C]."""
    large = nn.functional.interpolate(picture.permute(2, 0, 1)[None], scale_factor=2.0, mode="bilinear", align_corners=False)
    return large[0, :, :height, :width].permute(1, 2, 0)


class RefinementNetwork(nn.Module):
    """U-Net at the picture's resolution, or at half of it with pixels folded into channels.

    Args:
        config: Sizes.
    """

    def __init__(self, config: GRMMConfig) -> None:
        super().__init__()
        fold = config.refine_unshuffle
        widths = config.refine_channels
        steps = range(len(widths) - 1)
        self.fold = fold
        self.multiple = refinement_grid(config)
        self.margin = refinement_margin(config)
        self.activation = nn.LeakyReLU(SLOPE)
        # Most of the time goes at the finest level: there the many channels of the folded pixels are first mixed without
        # looking at neighbours, as one matrix product, and skips are added rather than concatenated.
        self.entry = nn.Linear((COLOR_CHANNELS + config.features + 1) * fold * fold, widths[0])
        self.first = nn.Conv2d(widths[0], widths[0], 3, padding=1)
        self.down = nn.ModuleList(nn.Conv2d(widths[i], widths[i + 1], 3, stride=2, padding=1) for i in steps)
        self.middle = nn.Conv2d(widths[-1], widths[-1], 3, padding=1)
        self.narrow = nn.ModuleList(nn.Conv2d(widths[i + 1], widths[i], 1) for i in reversed(steps))
        self.up = nn.ModuleList(nn.Conv2d(widths[i], widths[i], 3, padding=1) for i in reversed(steps))
        self.exit = nn.Conv2d(widths[0], COLOR_CHANNELS * fold * fold, 3, padding=1)
        nn.init.zeros_(self.exit.weight)
        if self.exit.bias is not None:
            nn.init.zeros_(self.exit.bias)

    def forward(self, rgb: Tensor, features: Tensor | None, depth: Tensor, alpha: Tensor) -> Tensor:
        """Refine one picture.

        Args:
            rgb: Splatted colors premultiplied over black, [H, W, 3].
            features: Splatted features, [H, W, F], or None when the model has none.
            depth: Normalised depth, [H, W].
            alpha: What the residual is multiplied by, [H, W].

        Returns:
            Refined colors premultiplied over black, [H, W, 3].
        """
        height, width = alpha.shape
        parts = [rgb, depth[..., None]] if features is None else [rgb, features, depth[..., None]]
        x = torch.cat(parts, -1)  # [H, W, C]
        if width % self.multiple or height % self.multiple:
            x = nn.functional.pad(x, (0, 0, 0, -width % self.multiple, 0, -height % self.multiple))
        rows, columns, channels = x.shape[0] // self.fold, x.shape[1] // self.fold, x.shape[2]
        x = x.view(rows, self.fold, columns, self.fold, channels).transpose(1, 2)
        x = self.entry(x.reshape(rows * columns, -1)).view(rows, columns, -1)
        x = x.permute(2, 0, 1)[None]  # [1, C, H / fold, W / fold], channels last in memory
        levels = [self.activation(self.first(self.activation(x)))]
        for stage in self.down:
            levels.append(self.activation(stage(levels[-1])))
        x = self.activation(self.middle(levels.pop()))
        for narrow, stage in zip(self.narrow, self.up, strict=True):
            x = nn.functional.interpolate(narrow(x), scale_factor=2.0, mode="nearest") + levels.pop()
            x = self.activation(stage(x))
        residual = nn.functional.pixel_shuffle(self.exit(x), self.fold)[0, :, :height, :width]
        return rgb + alpha[..., None] * residual.permute(1, 2, 0)

    def refined(
        self, raster: RasterOutput[Tensor], limits: Tensor | None = None, coarse: bool = False, cover: Tensor | None = None
    ) -> Tensor:
        """Refine a picture that was rasterised over black; see `GRMM.refine`."""
        if limits is None:
            limits = depth_range(raster.depth, raster.alpha)
        depth = normalise_depth(raster.depth, raster.alpha, limits)
        cover = raster.alpha if cover is None else cover
        if not coarse:
            result: Tensor = self(raster.rgb, raster.features, depth, cover)
            return result
        parts = [raster.rgb, depth[..., None], raster.alpha[..., None]]
        if raster.features is not None:
            parts.append(raster.features)
        small = halved(torch.cat(parts, -1))
        rgb, small_depth, alpha, features = small[..., :3], small[..., 3], small[..., 4], small[..., 5:]
        refined = self(rgb, features if raster.features is not None else None, small_depth, alpha)
        # The network's change is a residual times alpha. Enlarging both keeps the residual whole across the silhouette.
        enlarged = doubled(torch.cat([refined - rgb, alpha[..., None]], -1), *raster.alpha.shape)
        residual = enlarged[..., :3] / enlarged[..., 3:].clamp(min=_THIN_COVER)
        return raster.rgb + cover[..., None] * residual
