"""Panels about making pictures: poses and presets, composite, turntable, contact sheet. In the sidebar's GRMM tab."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..composite import nodes, scenes
from ..engine.settings import MESH_ALONE, shows_mesh_alone
from ..poses import local_poses
from ..preset_menus import (
    GRMM_MT_expression_presets,
    GRMM_MT_render_presets,
    GRMM_OT_expression_preset_add,
    GRMM_OT_render_preset_add,
    draw_presets,
)
from ..rig.avatar import avatar_of
from ..scene.avatars import avatars_in
from ..width import draw_text
from .twins import CATEGORY

_STUDIO_LIT = "Avatars have the studio's even light, not that of this scene"


class _SidebarPanel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}


class GRMM_PT_poses(_SidebarPanel, bpy.types.Panel):
    """Presets and the pose library."""

    bl_label = "Pose Library"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show with an avatar selected."""
        return avatar_of(context.object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        draw_presets(layout, GRMM_MT_expression_presets, GRMM_OT_expression_preset_add)
        column = layout.column(align=True)
        if next(local_poses(), None) is None:
            column.operator("grmm.create_pose_library", icon="ASSET_MANAGER")
        else:
            column.operator_context = "INVOKE_DEFAULT"
            if context.space_data is not None:  # Blender's own popover of a shelf is a dark box six rows high
                column.prop(context.space_data, "show_region_asset_shelf", text="Show Poses", icon="ASSET_MANAGER", toggle=True)
            column.operator("grmm.apply_pose", text="Apply Pose by Name...", icon="VIEWZOOM")
            column.operator("grmm.create_pose_library", text="Draw Thumbnails Again", icon="FILE_REFRESH")
        column.operator_context = "INVOKE_DEFAULT"
        column.operator("grmm.save_pose", text="Save Expression...", icon="ADD")


class GRMM_PT_pictures(_SidebarPanel, bpy.types.Panel):
    """Composite, turntable, contact sheet."""

    bl_label = "Pictures"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show where there is something to look at."""
        return bool(avatars_in(context.scene)) or context.scene.grmm_composite.main is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        if shows_mesh_alone(context.scene):
            draw_text(layout, MESH_ALONE, context, icon="INFO")
        self._draw_composite(layout, context)
        column = layout.column(align=True)
        column.operator("grmm.portrait_camera", icon="CAMERA_DATA")
        column.operator("grmm.turntable", icon="CON_FOLLOWPATH")
        column.operator_context = "INVOKE_DEFAULT"
        column.operator("grmm.contact_sheet", text="Contact Sheet...", icon="IMGDISPLAY")

    def _draw_composite(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        scene = context.scene
        if scene.grmm_composite.main is not None:
            layout.label(text=f"Renders the avatars of {scene.grmm_composite.main.name}", icon="SCENE_DATA")
            return
        partner = scenes.partner_of(scene)
        if partner is None:
            layout.operator("grmm.composite_set_up", icon="NODE_COMPOSITING")
            return
        box = layout.box().column()
        box.label(text=f"Avatars: {partner.name}", icon="NODE_COMPOSITING")
        merge = nodes.merge_node(scene)
        if merge is not None and nodes.COMPARE in merge.inputs:
            box.prop(merge.inputs[nodes.COMPARE], "default_value", text=nodes.COMPARE, slider=True)
        if scenes.studio_lit(scene):
            draw_text(box, _STUDIO_LIT, context, icon="INFO")
            box.operator("grmm.composite_light", icon="LIGHT")
        row = box.row(align=True)
        row.operator("grmm.composite_set_up", text="Put Right", icon="FILE_REFRESH")
        row.operator("grmm.composite_remove", text="Remove", icon="X")


def _render_presets(self: bpy.types.Panel, _context: bpy.types.Context) -> None:
    draw_presets(self.layout, GRMM_MT_render_presets, GRMM_OT_render_preset_add)


CLASSES = (GRMM_PT_poses, GRMM_PT_pictures)


def register() -> None:
    """Offer presets above the engine's settings; the engine's panels are registered before."""
    bpy.types.GRMM_PT_render.prepend(_render_presets)


def unregister() -> None:
    """Take that back."""
    bpy.types.GRMM_PT_render.remove(_render_presets)
