"""The cap of skin that stands in for an avatar's trained hair: see `scalp`, which makes it, and `evaluator`, which draws it."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..splat.types import Gaussians


class Cap(NamedTuple):
    """How flat each texel is laid, 0..1 [N], and the color it takes there, display sRGB [N, 3]; the engine's arrays."""

    share: Any
    color: Any

    def laid(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians whose offsets were laid flat, with the opacity and the color of the cap and without features."""
        part = self.share[:, None]
        own = gaussians
        opacities = own.opacities + self.share * (1.0 - own.opacities)
        colors = own.colors + part * (self.color - own.colors)
        features = None if own.features is None else own.features * (1.0 - part)
        return Gaussians(own.means, own.quats, own.scales, opacities, colors, features)
