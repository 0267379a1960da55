"""The controls of an avatar as animators see them: names, regions, ranges, descriptions, mirror pairs.

Used by `build` (custom properties), panels and operators. Needs neither bpy nor the model.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from ...grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES, MIXTURE_NAMES, MIXTURES

SHAPE = "shape"
EXPRESSION = "expression"
Z_ID = "z_id"
Z_EXP = "z_exp"
STRENGTH = "residual_strength"
ARRAY_NAMES = (SHAPE, EXPRESSION, Z_ID, Z_EXP)
CODES = (Z_ID, Z_EXP)
"""The residual codes, of which states can be saved (see `codes`)."""

FLAME_PREFIX = "flame:"
"""Before the path of a user's FLAME file, in an avatar's source and in the name of its head model."""
CONTROL_JOINTS = ("neck", "jaw", "left_eye", "right_eye")


@dataclass(frozen=True)
class Range:
    """Hard and soft limits of a property."""

    low: float
    high: float
    soft_low: float
    soft_high: float


ALIGNED_RANGE = Range(-1.0, 2.0, 0.0, 1.0)
ARRAY_RANGES = {
    SHAPE: Range(-8.0, 8.0, -3.0, 3.0),
    EXPRESSION: Range(-6.0, 6.0, -1.0, 1.0),  # with an aligned 2 on top still inside a shape key's -10..10
    Z_ID: Range(-20.0, 20.0, -3.0, 3.0),
    Z_EXP: Range(-20.0, 20.0, -3.0, 3.0),
}
STRENGTH_RANGE = Range(0.0, 1.0, 0.0, 1.0)
ARRAY_DESCRIPTIONS = {
    SHAPE: "Shape coefficients of the head model, added to the avatar's own, in standard deviations",
    EXPRESSION: "Expression coefficients of the head model, added to those of the named expressions",
    Z_ID: "Residual identity code, added to the avatar's own",
    Z_EXP: "Residual expression code, added to what the named expressions give",
}
STRENGTH_DESCRIPTION = "Strength of the learned detail: 0 is the head model alone, 1 the trained model"

_REGION_PREFIXES = {
    "Brows": ("brow",),
    "Eyes": ("eye",),
    "Cheeks and nose": ("cheek", "nose"),
    "Jaw": ("jaw",),
    "Mouth": ("mouth",),
    "Tongue": ("tongue",),
}
REGIONS: dict[str, tuple[str, ...]] = {
    region: tuple(name for name in ARKIT_NAMES if name.startswith(prefixes)) for region, prefixes in _REGION_PREFIXES.items()
} | {"Mixtures": MIXTURE_NAMES}
"""Region to the aligned expressions in it; each of the 60 is in exactly one."""

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def label(name: str) -> str:
    """Return a control's name in words: "mouthSmileLeft" becomes "Mouth Smile Left"."""
    return " ".join(word[:1].upper() + word[1:] for word in _WORD.findall(name)) or name


def mirrored(name: str) -> str:
    """Return the control of the other side; a control in the middle is its own partner.

    Covers expressions ("eyeBlinkLeft"), sideways movements ("jawLeft" and "jawRight"), components ("unitEyeLeftSlit") and
    joints ("left_eye").
    """
    swap = {"Left": "Right", "Right": "Left", "left_": "right_", "right_": "left_"}
    return re.sub(r"Left|Right|left_|right_", lambda match: swap[match.group()], name)


def describe_aligned(name: str) -> str:
    """Return the tooltip of an aligned expression."""
    recipe = MIXTURES.get(name)
    if recipe is None:
        return f"{label(name)}: ARKit shape, moves the head and its learned detail; 0 is rest, 1 the full expression"
    parts = ", ".join(f"{part} {weight:g}" for part, weight in recipe.items())
    return f"{label(name)}: mixture with a learned detail of its own ({parts})"


def property_path(name: str, index: int | None = None) -> str:
    """Return the data path of a control on the head object."""
    return f'["{name}"]' if index is None else f'["{name}"][{index}]'


__all__ = [
    "ALIGNED_NAMES",
    "ALIGNED_RANGE",
    "ARRAY_DESCRIPTIONS",
    "ARRAY_NAMES",
    "ARRAY_RANGES",
    "CODES",
    "CONTROL_JOINTS",
    "FLAME_PREFIX",
    "REGIONS",
    "STRENGTH",
    "STRENGTH_DESCRIPTION",
    "STRENGTH_RANGE",
    "Range",
    "describe_aligned",
    "label",
    "mirrored",
    "property_path",
]
