"""What the selected avatar looks like in a scene: its hair, and the light on it."""

from __future__ import annotations

import bpy

from ...grmm_core.hair import SETTINGS
from ..hair import message_of
from ..hair.curve_sliders import shared_with
from ..hair.grooms import NO_HAIR, PARTS, RANDOM_HAIR
from ..properties import PHOTO_LIGHT, SCENE_LIGHT
from ..rig.avatar import avatar_of
from ..scene.lights import unread_world
from ..scene.photo_light import photo_lighting
from ..width import draw_text, is_narrow
from .twins import CATEGORY

_NO_PHOTO_LIGHT = "This avatar knows no photo's light; it stays in the studio's."
_PICTURE = 5.0  # heights of a button
_FACTORS = ("light_intensity", "skin_gloss", "skin_detail", "skin_scattering", "shadow_softness")


class _LookPanel(bpy.types.Panel):
    """A panel of the sidebar for an avatar that the model draws."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads it

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show with an avatar selected that the model draws."""
        avatar = avatar_of(context.object)
        return avatar is not None and avatar.has_network


class GRMM_PT_light(_LookPanel):
    """Studio or scene, and how the avatar takes the scene's light."""

    bl_label = "Light"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, avatar = self.layout, avatar_of(context.object)
        if avatar is None:
            return
        settings = avatar.object.grmm
        layout.use_property_split = not is_narrow(context)
        layout.row().prop(settings, "lighting", expand=True)
        column = layout.column()
        column.active = settings.lighting == SCENE_LIGHT
        for name in _FACTORS:
            column.prop(settings, name, slider=True)
        unread = unread_world(context.scene) if settings.lighting == SCENE_LIGHT else ""
        if unread:
            draw_text(layout, unread, context, icon="INFO")
            layout.operator("grmm.bake_world", icon="WORLD")
        if settings.lighting == PHOTO_LIGHT and photo_lighting(avatar.source) is None:
            draw_text(layout, _NO_PHOTO_LIGHT, context, icon="INFO")


class GRMM_PT_hair(_LookPanel):
    """What hair the avatar wears, and what can be changed about strands."""

    bl_label = "Hair"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        avatar = avatar_of(context.object)
        if avatar is None:
            return
        layout, settings = self.layout, avatar.object.grmm.hair
        layout.use_property_split = not is_narrow(context)
        choice = layout.column()
        choice.active = settings.curves is None
        choice.template_icon_view(settings, "picked", show_labels=True, scale=_PICTURE, scale_popup=_PICTURE)
        choice.prop(settings, "groom")
        if settings.groom == RANDOM_HAIR:
            choice.prop(settings, "seed")
        for part in PARTS:
            layout.prop(settings, part)
        layout.prop(settings, "curves")
        layout.operator("grmm.hair_as_curves", icon="SCULPTMODE_HLT")
        row = layout.row(align=True)
        row.active = settings.curves is None
        row.prop(settings, "swing")
        row.operator("grmm.bake_swing", icon="REC")
        message = message_of(settings.curves) if settings.curves is not None else ""
        if message:
            draw_text(layout, message, context, icon="ERROR")
            if shared_with(avatar.object) is not None:
                layout.operator("grmm.make_independent")
        column = layout.column()
        column.active = settings.curves is not None or settings.groom != NO_HAIR
        for setting in SETTINGS:
            row = column.row()
            row.active = _counts(settings, setting.name)
            row.prop(settings, setting.name, slider=True)


def _counts(settings: bpy.types.PropertyGroup, name: str) -> bool:
    """Whether a slider does anything: whole dye, as photos give hair, covers what grows; without any, its color is unseen."""
    if name in ("melanin", "redness", "grey"):
        return settings.dye < 1.0
    return not name.startswith("dye_") or settings.dye > 0.0


CLASSES = (GRMM_PT_hair, GRMM_PT_light)
