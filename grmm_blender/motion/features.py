"""The features of this package by the names that operators take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy

from ..rig.avatar import Avatar
from . import face_bones, idle, look_at

_Change = Callable[[bpy.types.Context, Avatar], None]


@dataclass(frozen=True)
class Feature:
    """One thing that a head can have.

    Attributes:
        label: Its name.
        description: What it is, in one sentence without its point.
        icon: Of the panel.
        is_present: Whether a head has it.
        add: Gives it to a head in a context; raises `GrmmError`.
        remove: Takes it away, and leaves the head as it was before; raises `GrmmError`.
    """

    label: str
    description: str
    icon: str
    is_present: Callable[[Avatar], bool]
    add: _Change
    remove: _Change


def _remove_idle(feature: str) -> _Change:
    return lambda context, avatar: idle.remove(context, avatar, feature)


def _has_idle(feature: str) -> Callable[[Avatar], bool]:
    return lambda avatar: idle.strip_of(avatar, feature) is not None


FEATURES: dict[str, Feature] = {
    "control": Feature(
        "Face Bones", "Bones on brows, lids, lips and jaw that add to the sliders", "ARMATURE_DATA",
        face_bones.is_present, face_bones.add, face_bones.remove,
    ),
    "look": Feature(
        "Look At", "Eyes and neck follow an object: the other selected one, or a new empty", "HIDE_OFF",
        look_at.is_present, look_at.add, look_at.remove,
    ),
    "blink": Feature(
        "Blinking", "Blinks on an NLA track of their own, over what is keyed", "NLA",
        _has_idle(idle.BLINK), idle.add_blink, _remove_idle(idle.BLINK),
    ),
    "breath": Feature(
        "Breathing", "Breathing on an NLA track of its own, over what is keyed", "FORCE_WIND",
        _has_idle(idle.BREATH), idle.add_breath, _remove_idle(idle.BREATH),
    ),
}  # fmt: skip
"""By the name of their layer of expressions."""
