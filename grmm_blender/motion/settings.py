"""Settings of what moves a head beside its sliders: `Object.grmm_motion` of head objects."""

from __future__ import annotations

import bpy

from ..declare import number, whole
from ..rig.avatar import Avatar, is_avatar
from . import idle, look_at


def _target_changed(self: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    look_at.follow(Avatar(self.id_data), self.look_at)


def _may_be_target(self: bpy.types.PropertyGroup, obj: bpy.types.Object) -> bool:
    return look_at.may_be_target(Avatar(self.id_data), obj)


def _idle_changed(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Make the actions anew that come from these settings."""
    if is_avatar(self.id_data):
        for feature in (idle.BLINK, idle.BREATH):
            if idle.strip_of(Avatar(self.id_data), feature) is not None:
                idle.generate(context.scene, Avatar(self.id_data), feature)


class GRMM_PG_motion(bpy.types.PropertyGroup):
    """What moves a head beside its sliders."""

    look_at: bpy.props.PointerProperty(
        name="Look At",
        description="Object that eyes and neck follow; another avatar is looked in the face",
        type=bpy.types.Object,
        poll=_may_be_target,
        update=_target_changed,
    )
    blink_rate: number(
        "Blinks per Minute", "Blinks a minute, on average", default=15.0, min=1.0, max=60.0, update=_idle_changed
    )
    breath_rate: number("Breaths per Minute", "Breaths on average", default=14.0, min=2.0, max=60.0, update=_idle_changed)
    blink_strength: number(
        "Blink Strength", "How far the lids close; the strip's influence takes keys", default=1.0, min=0.0, max=1.0,
        subtype="FACTOR", update=_idle_changed,
    )  # fmt: skip
    breath_strength: number(
        "Breath Strength", "How deep the breaths are; the strip's influence takes keys", default=1.0, min=0.0, soft_max=2.0,
        max=5.0, subtype="FACTOR", update=_idle_changed,
    )  # fmt: skip
    seed: whole("Seed", "Equal numbers blink and breathe alike", default=1, min=0, update=_idle_changed)


CLASSES = (GRMM_PG_motion,)


def register() -> None:
    """Attach the settings."""
    bpy.types.Object.grmm_motion = bpy.props.PointerProperty(type=GRMM_PG_motion, name="GRMM Motion")


def unregister() -> None:
    """Take them back; the values stay in the files."""
    del bpy.types.Object.grmm_motion
