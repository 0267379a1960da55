"""The cap of skin that stands in for an avatar's trained hair: see `scalp`, which makes it, and `evaluator`, which draws it."""

from __future__ import annotations

from typing import Any, NamedTuple


class Cap(NamedTuple):
    """How flat each texel is laid, 0..1 [N], and the color it takes there, display sRGB [N, 3]; the engine's arrays."""

    share: Any
    color: Any

    def laid(self, colors: Any, opacities: Any, features: Any) -> Laid:
        """What becomes of colors [N, 3], opacities [N] and features [N, F] of Gaussians whose offsets were laid flat."""
        part = self.share[:, None]
        left = 1.0 - part
        opacities = opacities + self.share * (1.0 - opacities)
        return Laid(colors + part * (self.color - colors), opacities, features * left, left)


class Laid(NamedTuple):
    """Colors, opacities and features under a cap, and what it leaves of what is added to the colors, [N, 1]."""

    colors: Any
    opacities: Any
    features: Any
    left: Any
