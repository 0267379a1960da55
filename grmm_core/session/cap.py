"""The cap of skin that stands in for an avatar's trained hair: see `scalp`, which makes it, and `evaluator`, which draws it."""

from __future__ import annotations

from typing import Any, NamedTuple


class Cap(NamedTuple):
    """What becomes of each texel; the engine's arrays.

    Attributes:
        share: How flat it is laid, 0..1 [N].
        color: What it takes on there, display sRGB [N, 3].
        shade: What strands that lie over it leave of its own color elsewhere, 0..1, times what bares painted hair, [N, 1 or 3].
    """

    share: Any
    color: Any
    shade: Any

    def laid(self, colors: Any, opacities: Any, features: Any) -> Laid:
        """What becomes of colors [N, 3], opacities [N] and features [N, F] of Gaussians whose offsets were laid flat."""
        part = self.share[:, None]
        left = 1.0 - part
        opacities = opacities + self.share * (1.0 - opacities)
        return Laid(colors * self.shade * left + part * self.color, opacities, features * left, left)


class Laid(NamedTuple):
    """Colors, opacities and features under a cap, and what it leaves of what is added to the colors, [N, 1]."""

    colors: Any
    opacities: Any
    features: Any
    left: Any
