"""What is known of one control: a row of the table in `table`. Also names in words, and which side of the face they are of."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Source = Literal["property", "bone"]
Unit = Literal["weight", "standard deviations", "radians", "share"]

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SIDES = re.compile(r"Left|Right|left_|right_")
_OTHER_SIDE = {"Left": "Right", "Right": "Left", "left_": "right_", "right_": "left_"}
_SIDEWAYS = frozenset({"jawLeft", "jawRight", "mouthLeft", "mouthRight"})


@dataclass(frozen=True)
class Limits:
    """Range of a value: `low` to `high` can be set, `soft_low` to `soft_high` is what a slider spans."""

    low: float
    high: float
    soft_low: float
    soft_high: float


@dataclass(frozen=True)
class Section:
    """Controls that belong together: a panel, and something to reset.

    Attributes:
        key: Identifier.
        label: Title of the panel.
        description: What is in it, in a few words.
    """

    key: str
    label: str
    description: str


@dataclass(frozen=True)
class Control:
    """One thing that an animator sets: a slider, an array of coefficients, or the rotation of a joint.

    Attributes:
        name: Of the custom property on the head object, or of the bone; and what `--set` takes.
        label: Name in words.
        description: One sentence without its point, for tooltips and help.
        section: Key of its `Section`.
        limits: Range of each value.
        unit: What 1 means.
        region: Part of the section, and channel group of its keys.
        rest: Value of each element that changes nothing.
        size: 0 for a single number, else the most values that an array may have, or 3 for a rotation.
        field: Attribute of `Controls` that holds it; the table fills this in for arrays and sliders.
        index: Its place in that attribute; None where it is the whole of it.
        source: Where Blender keeps it: a custom property of the head object, or the rotation of a bone of the armature.
        in_poses: It is part of what the face does, and so of pose assets; other controls say who it is and how it is drawn.
        axes: Names of the angles that panels show of a rotation.
        both: Label of the row in which the controls of both sides stand beside each other; empty for `label`.
    """

    name: str
    label: str
    description: str
    section: str
    limits: Limits
    unit: Unit
    region: str = ""
    rest: float = 0.0
    size: int = 0
    field: str = ""
    index: int | None = None
    source: Source = "property"
    in_poses: bool = False
    axes: tuple[str, ...] = ()
    both: str = ""

    @property
    def partner(self) -> str:
        """Name of the control of the other side; its own for one in the middle."""
        return mirrored(self.name)

    @property
    def group(self) -> str:
        """Channel group of its keys."""
        return self.region or self.label


def in_words(name: str) -> str:
    """Return a control's name in words: "mouthSmileLeft" becomes "Mouth Smile Left"."""
    return " ".join(word[:1].upper() + word[1:] for word in _WORD.findall(name)) or name


def mirrored(name: str) -> str:
    """Return the control of the other side; a control in the middle is its own partner.

    Covers expressions ("eyeBlinkLeft"), sideways movements ("jawLeft" and "jawRight"), components ("unitEyeLeftSlit") and
    joints ("left_eye").
    """
    return _SIDES.sub(lambda match: _OTHER_SIDE[match.group()], name)


def is_sideways(name: str) -> bool:
    """Whether an expression is a movement to a side, not of a side: mirrored it turns round, and no side is its source."""
    return name in _SIDEWAYS


def without_side(name: str) -> str:
    """Return what the controls of both sides have in common: "mouthSmile", and "jaw" of "jawLeft"."""
    return _SIDES.sub("", name)


def side_of(name: str) -> Literal["left", "right", ""]:
    """Which side of the face a control is of, the subject's; empty for the middle and for sideways movements."""
    found = None if is_sideways(name) else _SIDES.search(name)
    if found is None:
        return ""
    return "left" if found.group().lower().startswith("left") else "right"
