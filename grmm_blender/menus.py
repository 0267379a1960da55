"""The GRMM menu of the 3D viewport (Object and Pose). What is in a menu is found by Blender's search (F3).

Operators that are not listed here, of whatever module, stand in a submenu of their own, so that none can be forgotten; those
that are buttons of one panel and mean nothing elsewhere (`INTERNAL`: "Cancel", "Remove") stay out.
"""

from __future__ import annotations

import bpy

from .motion.features import FEATURES

_SECTIONS = (
    ("add_head", "open_avatar"),
    ("wear_hair", "hair_as_curves"),
    ("random_expression", "mirror", "reset", "random_identity", "make_independent", "select_controls"),
    ("apply_pose", "save_pose", "create_pose_library"),
    ("import_performance", "import_video", "import_voice", "save_avatar"),
    ("composite_set_up", "composite_remove", "portrait_camera", "turntable", "contact_sheet"),
)


class GRMM_MT_main(bpy.types.Menu):
    """Everything that can be done with GRMM avatars."""

    bl_idname = "GRMM_MT_main"
    bl_label = "GRMM"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the sections and the submenus."""
        layout = self.layout
        for section in _SECTIONS:
            for name in section:
                layout.operator(f"grmm.{name}")
            layout.separator()
        layout.menu("GRMM_MT_expression_presets")
        layout.menu(GRMM_MT_motion.bl_idname)
        layout.menu(GRMM_MT_more.bl_idname)


class GRMM_MT_motion(bpy.types.Menu):
    """What a rig can have beside its sliders, by name: the search knows operators by what menus call them."""

    bl_idname = "GRMM_MT_motion"
    bl_label = "Add to Rig"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one entry for each."""
        for key, feature in FEATURES.items():
            self.layout.operator("grmm.add_motion", text=feature.label, icon=feature.icon).feature = key


class GRMM_MT_more(bpy.types.Menu):
    """Operators that have their place in a panel or in Blender's own menus."""

    bl_idname = "GRMM_MT_more"
    bl_label = "Other GRMM Operators"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw them by name."""
        self.layout.operator_context = "INVOKE_DEFAULT"
        for name in other_operators():
            self.layout.operator(f"grmm.{name}")


def other_operators() -> list[str]:
    """Names of the registered operators that no section has and that are more than a panel's button."""
    placed = {"add_motion", *(name for section in _SECTIONS for name in section)}
    return sorted(name for name in dir(bpy.ops.grmm) if name not in placed and not _is_internal(name))


def _is_internal(name: str) -> bool:
    return "INTERNAL" in getattr(getattr(bpy.types, f"GRMM_OT_{name}"), "bl_options", ())


def _in_viewport(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.separator()
    self.layout.menu(GRMM_MT_main.bl_idname)


CLASSES = (GRMM_MT_more, GRMM_MT_motion, GRMM_MT_main)
_PLACES = ("VIEW3D_MT_object", "VIEW3D_MT_pose")


def register() -> None:
    """Add the menu to the viewport's."""
    for place in _PLACES:
        getattr(bpy.types, place).append(_in_viewport)


def unregister() -> None:
    """Take it away."""
    for place in _PLACES:
        getattr(bpy.types, place).remove(_in_viewport)
