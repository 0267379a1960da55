"""Shade in folds that are narrower than the mesh: as far as light makes it, it is taken out of the colors.

`local_light` tells color from light where either is wide, at the mesh's vertices, which lie 5 mm apart. The shade in a wrinkle
is narrower, and more the lamps' than the skin's: in even light it would look like a scar. What stands out from the skin around
more than it does in the prior is color d ~ N(0, c^2), in logarithms, and shade of the variance s^2 that is found around it. So
the likeliest color is d c^2 / (c^2 + s^2): a mole or a few freckles on plain skin stay whole, and of skin that is all furrows
a soft part does. What is taken out is missing in the photo's view, and becomes part of its light (`local_light.more_fine`).

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..light.relight import to_display, to_linear
from .surface import Surface

MARKS = 0.15  # c, of the logarithm of a texel's color; pictures show about half of it, since Gaussians overlap
LEAST = 0.55  # of what stands out that is color in any case: wrinkles are seen in even light, too
WIDTH_TEXELS, AROUND_TEXELS = 10.0, 8.0  # length below which colors stand out; over which s is found
FINEST_TEXELS, PRIOR_TEXELS = 0.5, 1.5  # below it colors cancel out between Gaussians that overlap; of the prior, noise
DEEPEST = 0.35  # of the logarithm, over the share of shade: no color stands out more, so that deep folds are not red
MOST_TINT = 0.3  # of the logarithm, by which a channel stands out more than all do: about as much as red spots
RIM_TEXELS, AWAY = 2.0, (0.6, 0.95)  # from other parts than plain skin: smoothed share of it
_NORMAL = 1.25  # standard deviation over mean absolute deviation, which single marks hardly change
_DARKEST = 2e-3  # linear color below which nothing is told


@dataclass(frozen=True)
class FoldShade:
    """How much of what stands out from a person's skin is shade.

    Attributes:
        surface: Texels.
        prior: Logarithm of the colors that are expected, [N, 3].
        plain: 1 on the plain skin of the face, [N, 1].
        share: 0..1, [N, 1].
    """

    surface: Surface
    prior: Tensor
    plain: Tensor
    share: Tensor

    @staticmethod
    def of(surface: Surface, colors: Tensor, prior: Tensor, plain: Tensor) -> FoldShade:
        """Find it.

        Args:
            surface: Texels.
            colors: As the photos show them, without their light, display sRGB, [N, 3].
            prior: As the weights have them, with shade of nostrils and lids, likewise.
            plain: Texels of the face's plain skin, [N] bool.
        """
        known, weight = _logarithm(surface.smooth(prior, PRIOR_TEXELS)), plain.to(colors)[:, None]
        found = FoldShade(surface, known, weight, torch.zeros_like(weight))
        spread = _NORMAL * found._mean(found._detail(colors).mean(1, keepdim=True).abs(), AROUND_TEXELS)
        color = (MARKS**2 / (MARKS**2 + spread**2)).clamp(min=LEAST)
        away = ((surface.smooth(weight, RIM_TEXELS) - AWAY[0]) / (AWAY[1] - AWAY[0])).clamp(0, 1)
        return FoldShade(surface, known, weight, weight * away * (1.0 - color))

    def without(self, colors: Tensor) -> Tensor:
        """Colors of the person [N, 3], display sRGB, as even light shows them."""
        lit, detail = to_linear(colors.clamp(0.0, 1.0)), self._detail(colors)
        most = DEEPEST / self.share.clamp(min=1e-3)
        light, color = detail.mean(1, keepdim=True), 1.0 - self.share
        tint = MOST_TINT * torch.tanh((detail - light) / MOST_TINT)
        kept = (color * (light + color * tint)).clamp(-most, most)  # shade is red: that goes with more of it
        soft = to_display(lit * torch.exp(kept - detail))
        return soft + (1.0 - self.share) * (colors - to_display(lit))  # the rest is what no screen shows

    def _detail(self, colors: Tensor) -> Tensor:
        """What stands out from the skin around, in logarithms, [N, 3]."""
        off = _logarithm(colors) - self.prior
        return self.plain * (self._mean(off, FINEST_TEXELS) - self._mean(off, WIDTH_TEXELS))

    def _mean(self, values: Tensor, texels: float) -> Tensor:
        """Values [N, C] smoothed over plain skin alone."""
        whole = self.surface.smooth(torch.cat([values * self.plain, self.plain], 1), texels)
        return whole[:, :-1] / whole[:, -1:].clamp(min=1e-3)


def _logarithm(colors: Tensor) -> Tensor:
    return to_linear(colors.clamp(0.0, 1.0)).clamp(min=_DARKEST).log()
