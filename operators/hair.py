"""Hair: a groom chosen by its picture, and its strands as Blender's curves, to comb, cut and grow."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..grmm_blender.declare import Operator, choice, flag
from ..grmm_blender.hair.build import make_curves, worn_hair
from ..grmm_blender.hair.grooms import HAIR_ITEMS, icon_of
from ..grmm_blender.properties import wear
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_core.errors import ConfigError
from ..grmm_core.hair import SETTINGS
from .common import Result, active_avatar, check_object_mode, polls, reports_errors, require

SCULPT = "SCULPT_CURVES"  # Blender's mode


def _combable(context: bpy.types.Context) -> Avatar:
    """The active avatar, in object mode, if the model draws it. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    require(avatar.has_network, "No network draws this head")
    check_object_mode(context)
    return avatar


class GRMM_OT_hair_as_curves(Operator):
    """Make the active avatar's hair Blender's curves and go to sculpt mode: comb, cut, grow and puff it."""

    bl_label = "Edit as Curves"
    bl_description = (
        "Make the active avatar's hair a Curves object on its head, which Blender's sculpt mode and geometry nodes change, "
        "and go to sculpt mode"
    )
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    sculpt: flag("Sculpt Mode", "Go to sculpt mode at once", default=True)
    poll = polls(_combable)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Make the curves where there are none, and select them."""
        avatar = _combable(context)
        hair = avatar.object.grmm.hair
        if hair.curves is None:
            worn = worn_hair(avatar)
            if worn is None:
                raise ConfigError("This avatar's own hair is no strands; choose a groom, or None to grow hair on a bald head.")
            hair.curves = make_curves(avatar, worn.groom, worn.settings)
            for row in SETTINGS:  # strands of its own bring settings along
                if getattr(hair, row.name) != getattr(worn.settings, row.name):
                    setattr(hair, row.name, getattr(worn.settings, row.name))
            avatar.tag_edited()
        if self.sculpt:
            for other in context.selected_objects:
                other.select_set(False)
            hair.curves.hide_set(False)
            hair.curves.select_set(True)
            context.view_layer.objects.active = hair.curves
            bpy.ops.object.mode_set(mode=SCULPT)
        return {"FINISHED"}


class GRMM_OT_wear_hair(Operator):
    """Have the active avatar wear a groom of strands, whatever it wore."""

    bl_label = "GRMM Hair"

    groom: choice("Hair", "What hair the avatar wears", *HAIR_ITEMS)
    poll = polls(active_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Change what it wears."""
        avatar = active_avatar(context)
        wear(avatar.object.grmm.hair, self.groom)
        avatar.tag_edited()
        return {"FINISHED"}


class GRMM_MT_add_hair(bpy.types.Menu):
    """Grooms by their pictures."""

    bl_idname = "GRMM_MT_add_hair"
    bl_label = "Hair"

    def draw(self, context: bpy.types.Context) -> None:
        """List what there is."""
        for name, label, _ in HAIR_ITEMS:
            self.layout.operator(GRMM_OT_wear_hair.bl_idname, text=label, icon_value=icon_of(name.lower())).groom = name
        self.layout.separator()
        self.layout.operator(GRMM_OT_hair_as_curves.bl_idname, icon="SCULPTMODE_HLT")


CLASSES = (GRMM_OT_hair_as_curves, GRMM_OT_wear_hair, GRMM_MT_add_hair)
