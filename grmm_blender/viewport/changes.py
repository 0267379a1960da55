"""Counts changes, so that a viewport can tell whether what it has is still right. Whoever hears of a change counts it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Changes:
    """Numbers that only rise.

    Attributes:
        scene: Changes of any scene.
        settings: Changes of the splat viewport's settings.
    """

    scene: int = 0
    settings: int = 0


CHANGES = Changes()
