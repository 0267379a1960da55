"""Families of furrows: what drives them, where on the skin they lie, how deep they are. Needs numpy only.

Standard wrinkle maps of film and games are driven so: each region by the shapes that press its skin together. All places are
template positions (head space, metres), x = 0 the middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .noise import bump, smoothstep


class Family(NamedTuple):
    """Furrows that come and go together.

    Attributes:
        name: Key of `DRIVERS`.
        side: "Left", "Right", or "" for both.
        channel: Of the relief of `lines.paint_lines`.
    """

    name: str
    side: str
    channel: int


CHANNELS = 3
LINE_DEPTH = 0.0028  # metres of relief at a map value of 1
YOUNG_DEPTH, AGED_DEPTH = 0.36, 0.92  # share of the depth that everybody has, and that age adds
MAX_AMOUNT = 1.25
EYE_CORNER = (0.0425, 0.034)  # x, y of the outer corner of the eye
MOUTH_HEIGHT = -0.0325
NOSE_WING, FOLD_END = (0.0185, 0.004), (0.0365, -0.040)  # x, y of the ends of the nasolabial fold

# family: ((shape without its side, weight), ...); a family follows the strongest of its drivers on each side
DRIVERS: dict[str, tuple[tuple[str, float], ...]] = {
    "forehead_middle": (("browInnerUp", 1.0),),
    "forehead_side": (("browOuterUp", 1.0), ("browInnerUp", 0.25), ("eyeWide", 0.2)),
    "glabella": (("browDown", 1.0), ("noseSneer", 0.3)),
    "crow": (("eyeSquint", 0.85), ("cheekSquint", 0.9), ("mouthSmile", 0.6), ("eyeBlink", 0.25)),
    "under_eye": (("eyeSquint", 0.9), ("cheekSquint", 0.9), ("mouthSmile", 0.45), ("eyeBlink", 0.15)),
    "bunny": (("noseSneer", 1.0), ("mouthUpperUp", 0.25)),
    "fold": (
        ("mouthSmile", 1.0),
        ("noseSneer", 0.8),
        ("mouthUpperUp", 0.75),
        ("cheekSquint", 0.45),
        ("mouthStretch", 0.45),
        ("mouthDimple", 0.35),
    ),
    "cheek": (("mouthSmile", 0.8), ("mouthDimple", 0.7), ("mouthStretch", 0.55)),
    "dimple": (("mouthDimple", 1.0), ("mouthSmile", 0.15), ("mouthPress", 0.3)),
    "marionette": (("mouthFrown", 1.0), ("mouthStretch", 0.35), ("mouthShrugLower", 0.3)),
    "chin": (("mouthShrugLower", 1.0), ("mouthFrown", 0.35), ("mouthPress", 0.25), ("mouthPucker", 0.2)),
    "lips": (("mouthPucker", 1.0), ("mouthFunnel", 0.55), ("mouthPress", 0.25), ("mouthRollUpper", 0.3)),
    "neck": (("mouthStretch", 1.0), ("mouthLowerDown", 0.3), ("mouthFrown", 0.35)),
}


_CHANNELS = {
    "forehead_middle": 0, "neck": 0, "chin": 0, "lips": 1, "forehead_side": 0, "glabella": 1, "crow": 1, "under_eye": 2,
    "bunny": 2, "fold": 0, "cheek": 1, "marionette": 2, "dimple": 1,
}  # fmt: skip
_MIDDLE = ("forehead_middle", "neck", "chin", "lips")
FAMILIES = tuple(
    Family(name, side, channel)
    for channel in range(CHANNELS)
    for name, own in _CHANNELS.items()
    for side in ((("",) if name in _MIDDLE else ("Left", "Right")) if own == channel else ())
)


def drive(weights: Mapping[str, float], family: str, side: str = "") -> float:
    """How far a family of lines is driven, 0..1.

    Args:
        weights: ARKit names to their coefficients.
        family: Key of `DRIVERS`.
        side: "Left", "Right"; shapes without sides count for both.
    """
    values = [weight * strength(weights, name, side) for name, weight in DRIVERS[family]]
    return float(np.clip(max(values) + 0.25 * (sum(values) - max(values)), 0.0, 1.0))


def strength(weights: Mapping[str, float], name: str, side: str) -> float:
    """How strong a shape is on a side, 0..1; `name` is without its side."""
    value = weights[name] if name in weights else weights.get(name + side, 0.0)
    return float(np.clip(value, 0.0, 1.0))


def line_depth(age: float) -> float:
    """Share of `LINE_DEPTH` that a person's furrows have: some for everybody, more with age 0..1."""
    return float(min(YOUNG_DEPTH + AGED_DEPTH * age**0.8, MAX_AMOUNT))


def family_places(rest: np.ndarray, skin: np.ndarray, lips: np.ndarray) -> np.ndarray:
    """Weights of `FAMILIES` at template positions [n, 3], [F, n]; `skin` and `lips` are weights of the points, [n]."""
    x, y, z = rest.T
    places: dict[tuple[str, str], np.ndarray] = {}
    front = smoothstep(0.01, 0.04, z) * skin
    brow = smoothstep(0.056, 0.066, y) * front
    places["forehead_middle", ""] = brow * np.exp(-((x / 0.030) ** 2))
    places["neck", ""] = smoothstep(-0.062, -0.082, y) * skin * smoothstep(-0.03, 0.01, z)
    places["chin", ""] = bump(rest, (0, -0.056, 0.10), (0.022, 0.015, 0.06), False) * front
    around = np.hypot(x / 0.030, (y - MOUTH_HEIGHT) / 0.019)
    places["lips", ""] = smoothstep(1.15, 0.8, around) * front
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        own = smoothstep(-0.007, 0.007, sign * x)
        outer = smoothstep(0.004, 0.026, sign * x)
        crow = smoothstep(0.036, 0.046, sign * x) * smoothstep(-0.008, 0.010, y) * smoothstep(0.066, 0.052, y)
        nose = smoothstep(0.023, 0.014, np.abs(x)) * smoothstep(0.010, 0.020, y) * smoothstep(0.052, 0.044, y)
        below = bump(rest, (0.031, 0.020, 0.09), (0.018, 0.012, 0.04)) * smoothstep(0.010, 0.017, np.abs(x))
        cheek = smoothstep(0.016, 0.020, sign * x) * smoothstep(0.014, 0.002, y) * smoothstep(-0.058, -0.046, y)
        low = smoothstep(0.018, 0.024, sign * x) * smoothstep(-0.028, -0.036, y) * smoothstep(-0.08, -0.064, y)
        corner = bump(rest * [sign, 1, 1], (0.037, -0.030, 0.085), (0.012, 0.014, 0.05), False)
        places["forehead_side", side] = brow * outer
        places["glabella", side] = own * bump(rest, (0.0, 0.060, 0.11), (0.020, 0.017, 0.04), False) * front
        places["crow", side] = crow * skin
        places["under_eye", side] = own * np.clip(1.4 * below, 0, 1) * front
        places["bunny", side] = own * nose * front
        places["fold", side] = cheek * front
        places["cheek", side] = smoothstep(0.036, 0.042, sign * x) * cheek * front
        places["marionette", side] = low * front
        places["dimple", side] = corner * front
    return np.stack([places[family.name, family.side] for family in FAMILIES])


def amounts_of(weights: Mapping[str, float]) -> np.ndarray:
    """How far each of `FAMILIES` is driven by ARKit names' coefficients, 0..1, [F]."""
    return np.array([drive(weights, family.name, family.side) for family in FAMILIES]) ** 0.8


def driven(places: np.ndarray, amounts: np.ndarray) -> np.ndarray:
    """How far each channel's furrows are driven at each point, 0..1, [n, 3].

    Args:
        places: Of `family_places`, [F, n].
        amounts: Of `amounts_of`, [F].
    """
    result = np.zeros((CHANNELS, places.shape[1]), places.dtype)
    for family, amount, place in zip(FAMILIES, amounts.astype(places.dtype), places, strict=True):
        if amount > 0.0:  # an expression drives a few of them, and reading the others is most of the time
            result[family.channel] += amount * place
    return np.minimum(result, 1.0, out=result).T
