"""The sidebar panel of face bones, Look At, blinking and breathing."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..rig.avatar import Avatar, active_object, avatar_of
from ..rig.custom_properties import property_path
from . import idle, look_at
from .features import FEATURES


class GRMM_PT_motion(bpy.types.Panel):
    """What moves the active avatar beside its sliders."""

    bl_label = "Rig and Motion"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "GRMM"
    bl_order = 10
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With an avatar only."""
        return avatar_of(active_object(context)) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw each feature: a button, or its settings."""
        avatar = avatar_of(active_object(context))
        if avatar is None:
            return
        for key, feature in FEATURES.items():
            if not feature.is_present(avatar):
                self.layout.operator("grmm.add_motion", text=feature.label, icon=feature.icon).feature = key
                continue
            box = self.layout.box()
            row = box.row(align=True)
            row.label(text=feature.label, icon=feature.icon)
            row.operator("grmm.bake_motion", text="", icon="KEYFRAME").feature = key
            row.operator("grmm.remove_motion", text="", icon="X").feature = key
            column = box.column(align=True)
            column.use_property_split = True
            column.use_property_decorate = False
            _draw_settings(column, avatar, key)


def _draw_settings(column: bpy.types.UILayout, avatar: Avatar, key: str) -> None:
    """Draw what can be set of a feature that is there."""
    obj = avatar.object
    if key == look_at.LAYER:
        column.prop(obj.grmm_motion, "look_at", text="Target")
        for control in (look_at.INFLUENCE, look_at.NECK):
            column.prop(obj, property_path(control.name), text=control.label, slider=True)
    elif key in (idle.BLINK, idle.BREATH):
        column.prop(obj.grmm_motion, f"{key}_rate", text="Per Minute")
        column.prop(obj.grmm_motion, f"{key}_strength", text="Strength", slider=True)
        column.prop(obj.grmm_motion, "seed")


CLASSES = (GRMM_PT_motion,)
