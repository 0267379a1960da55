"""What an expression brings to a captured person's skin: furrows (`grmm_core.wrinkles`) and blood. Needs numpy only.

`LineField.amounts` says for a shot how far each channel of the furrows' relief is driven at each vertex and how the color
changes. The material adds their product to the skin's relief and darkens the grooves. In the neutral face every amount is 0
and every color factor 1. Used by `scene`; all places are template positions (head space, metres), x = 0 the middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.wrinkles.families import FAMILIES, amounts_of, driven, family_places, line_depth, strength
from grmm_core.wrinkles.noise import bump, smoothstep

from .subjects import Subject, skin_albedo


@dataclass
class LineField:
    """What lies where on a person's skin, for the vertices of the render mesh.

    Attributes:
        families: Channel and weight at each vertex, by (family, side), [n] each.
        colors: Weight at each vertex of each color change, by (name, side), [n] each.
        flush, pale: Factors of the color with more and with less blood, [3].
        depth: `line_depth` of the person.
    """

    families: np.ndarray
    colors: dict[tuple[str, str], np.ndarray]
    flush: np.ndarray
    pale: np.ndarray
    depth: float

    @staticmethod
    def build(subject: Subject, rest: np.ndarray, skin: np.ndarray, lips: np.ndarray) -> LineField:
        """Lay the families out over template positions [n, 3]; `skin` and `lips` are weights of the vertices, [n]."""
        x, y, z = rest.T
        families = family_places(rest, skin, lips)
        chin = families[[family.name for family in FAMILIES].index("chin")]
        colors: dict[tuple[str, str], np.ndarray] = {}
        front = smoothstep(0.01, 0.04, z) * skin
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            own = smoothstep(-0.007, 0.007, sign * x)
            colors["cheek", side] = own * bump(rest, (0.042, 0.004, 0.085), (0.022, 0.020, 0.04)) * skin
            colors["nose", side] = own * bump(rest, (0.006, 0.020, 0.115), (0.014, 0.022, 0.03)) * skin
            colors["glabella", side] = own * bump(rest, (0.004, 0.062, 0.11), (0.014, 0.015, 0.04)) * skin
            colors["forehead", side] = own * smoothstep(0.060, 0.072, y) * smoothstep(0.108, 0.09, y) * front
        colors["mouth", ""] = lips
        colors["chin", ""] = chin * (1 - lips)
        normal = skin_albedo(subject.melanin, subject.blood)
        return LineField(
            families,
            colors,
            skin_albedo(subject.melanin, subject.blood + 0.42) / normal,
            skin_albedo(subject.melanin, max(subject.blood - 0.34, 0.08)) / normal,
            line_depth(subject.wrinkles),
        )

    def amounts(self, expression: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Line amounts [n, 3] of the map's channels and color factors [n, 3] of a shot's coefficients [E >= 52]."""
        weights = {name: float(value) for name, value in zip(ARKIT_NAMES, expression, strict=False)}
        count = len(next(iter(self.colors.values())))
        lines, blood = driven(self.families, amounts_of(weights)), np.zeros(count)
        for (name, side), where in self.colors.items():
            amount = blood_change(weights, name, side)
            if amount:
                blood += amount * where
        blood = np.clip(blood, -1, 1)[:, None]
        color = 1 + np.maximum(blood, 0) * (self.flush - 1) + np.maximum(-blood, 0) * (self.pale - 1)
        return lines * self.depth, color


def blood_change(weights: Mapping[str, float], place: str, side: str) -> float:
    """Flush (positive) or paling (negative) of a place of `LineField.colors`, -1..1."""

    def of(name: str) -> float:
        return strength(weights, name, side)

    if place == "cheek":
        return 0.55 * max(of("mouthSmile"), 0.9 * of("cheekPuff"), 0.8 * of("cheekSquint")) - 0.25 * of("mouthStretch")
    if place == "nose":
        return 0.6 * of("noseSneer")
    if place == "glabella":
        return 0.6 * of("browDown")
    if place == "forehead":
        return 0.25 * max(of("browInnerUp"), of("browOuterUp"))
    if place == "mouth":
        press = max(of("mouthRollLower"), of("mouthRollUpper"), 0.8 * max(of("mouthPressLeft"), of("mouthPressRight")))
        stretch = 0.35 * max(of("mouthSmileLeft"), of("mouthSmileRight"), of("mouthStretchLeft"), of("mouthStretchRight"))
        return 0.45 * max(of("mouthPucker"), 0.5 * of("mouthFunnel")) - max(press, stretch)
    return -0.4 * of("mouthShrugLower")
