"""Presets by Blender's own preset system: expressions and render settings, shipped ones and the user's.

Shipped presets are in `presets/grmm/`; those that a user adds go where Blender keeps user presets. Loading an expression puts
all named expressions at rest first, so that a preset only lists what moves.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bpy.types import Menu

from ..grmm_core.controls.control import Control
from ..grmm_core.controls.table import EXPRESSIONS
from .declare import Operator
from .rig.avatar import active_object, avatar_of
from .rig.custom_properties import property_path, put_at_rest

EXPRESSION_FOLDER, RENDER_FOLDER = "grmm/expression", "grmm/render"
_FOLDER = str(Path(__file__).parent)
FIND_HEAD = "head = next(o for o in (bpy.context.object, *bpy.context.object.children) if 'jawOpen' in o)"
_RENDER_VALUES = (
    "use_refine", "detail", "use_occlusion", "occlusion_samples", "motion_steps", "use_viewport_refine", "viewport_detail",
)  # fmt: skip


class GRMM_MT_expression_presets(Menu):
    """Expressions to start from."""

    bl_label = "Expression Presets"
    preset_subdir = EXPRESSION_FOLDER
    preset_operator = "script.execute_preset"
    draw = Menu.draw_preset

    @classmethod
    def reset_cb(cls, context: bpy.types.Context, _filepath: str) -> None:
        """Put everything at rest first."""
        for head, control in _expressions(context):
            put_at_rest(head, control)

    @classmethod
    def post_cb(cls, context: bpy.types.Context, _filepath: str) -> None:
        """Evaluate again, key where automatic keying is on, and make it one step of the undo history."""
        avatar = avatar_of(context.object)
        if avatar is None:
            return
        avatar.tag_edited()
        if context.scene.tool_settings.use_keyframe_insert_auto:
            for head, control in _expressions(context):
                head.keyframe_insert(property_path(control.name))
        _remember(cls.bl_label)


class GRMM_MT_render_presets(Menu):
    """Settings of the GRMM engine for a purpose."""

    bl_label = "Render Presets"
    preset_subdir = RENDER_FOLDER
    preset_operator = "script.execute_preset"
    draw = Menu.draw_preset

    @classmethod
    def post_cb(cls, _context: bpy.types.Context, _filepath: str) -> None:
        """Make it one step of the undo history."""
        _remember(cls.bl_label)


def _expressions(context: bpy.types.Context) -> list[tuple[bpy.types.Object, Control]]:
    """The active avatar's head with each control that a preset sets."""
    avatar = avatar_of(context.object)
    return [] if avatar is None else [(avatar.object, control) for control in EXPRESSIONS if control.name in avatar.object]


def _remember(name: str) -> None:
    if bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=f"Preset {name}")


class GRMM_OT_expression_preset_add(AddPresetBase, Operator):
    """Keep the active avatar's expression as a preset, or remove a preset."""

    bl_label = "Add Expression Preset"
    preset_menu = "GRMM_MT_expression_presets"
    preset_subdir = EXPRESSION_FOLDER
    preset_defines = (FIND_HEAD,)
    preset_values = tuple(f"head{property_path(control.name)}" for control in EXPRESSIONS)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with an avatar."""
        return avatar_of(active_object(context)) is not None


class GRMM_OT_render_preset_add(AddPresetBase, Operator):
    """Keep the GRMM render settings as a preset, or remove a preset."""

    bl_label = "Add Render Preset"
    preset_menu = "GRMM_MT_render_presets"
    preset_subdir = RENDER_FOLDER
    preset_defines = ("settings = bpy.context.scene.grmm_render",)
    preset_values = tuple(f"settings.{name}" for name in _RENDER_VALUES)


def draw_presets(layout: bpy.types.UILayout, menu: type[Menu], operator: type[bpy.types.Operator]) -> None:
    """Draw a preset menu with its buttons to add and remove."""
    row = layout.row(align=True)
    row.menu(menu.__name__, text=menu.bl_label)
    row.operator(operator.bl_idname, text="", icon="ADD")
    row.operator(operator.bl_idname, text="", icon="REMOVE").remove_active = True


CLASSES = (
    GRMM_MT_expression_presets, GRMM_MT_render_presets, GRMM_OT_expression_preset_add, GRMM_OT_render_preset_add,
)  # fmt: skip


def register() -> None:
    """Let Blender find the shipped presets."""
    bpy.utils.register_preset_path(_FOLDER)


def unregister() -> None:
    """Take that back."""
    bpy.utils.unregister_preset_path(_FOLDER)
