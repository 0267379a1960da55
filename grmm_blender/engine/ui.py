"""Panels of the engine in the render and view layer properties, and Blender's own panels that make sense with it."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..width import draw_text
from .settings import ENGINE

DISPLAY_TRANSFORM = "Standard"
GRADED = "{} grades the avatar like the rest of the scene: paler than in solid view. Standard shows the model's own colors."
# Blender's panels for engines without lights, materials and sampling of their own.
_EXCLUDED = {
    "DATA_PT_falloff_curve", "DATA_PT_light", "DATA_PT_preview", "DATA_PT_spot", "DATA_PT_camera_dof",
    "MATERIAL_PT_context_material", "MATERIAL_PT_preview", "NODE_DATA_PT_light", "NODE_DATA_PT_spot",
    "RENDER_PT_simplify", "VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes",
}  # fmt: skip


class _EnginePanel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}
    COMPAT_ENGINES: ClassVar[set[str]] = {ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Show with the GRMM engine only."""
        return context.engine in cls.COMPAT_ENGINES


class GRMM_PT_render(_EnginePanel, bpy.types.Panel):
    """How final pictures are made."""

    bl_label = "Avatars"
    bl_options: ClassVar[set[str]] = set()

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.grmm_render
        layout.prop(settings, "use_refine")
        layout.prop(settings, "detail")
        column = layout.column(heading="Scene")
        column.prop(settings, "use_occlusion", text="Occludes")
        row = column.row()
        row.active = settings.use_occlusion
        row.prop(settings, "occlusion_samples")
        view = context.scene.view_settings
        if view.view_transform != DISPLAY_TRANSFORM:
            draw_text(layout, GRADED.format(view.view_transform), context, icon="INFO")
            layout.prop(view, "view_transform")


class GRMM_PT_viewport(_EnginePanel, bpy.types.Panel):
    """How the rendered viewport is made."""

    bl_label = "Viewport"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.grmm_render
        layout.prop(settings, "use_viewport_refine")
        layout.prop(settings, "viewport_detail")


class GRMM_PT_film(_EnginePanel, bpy.types.Panel):
    """Background."""

    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(context.scene.render, "film_transparent", text="Transparent")


class GRMM_PT_motion_blur(_EnginePanel, bpy.types.Panel):
    """Motion blur by averaging pictures within the shutter time."""

    bl_label = "Motion Blur"

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        render = context.scene.render
        layout.active = render.use_motion_blur
        layout.prop(render, "motion_blur_position", text="Position")
        layout.prop(render, "motion_blur_shutter")
        layout.prop(context.scene.grmm_render, "motion_steps")


class GRMM_PT_passes(_EnginePanel, bpy.types.Panel):
    """Passes of the view layer."""

    bl_label = "Passes"
    bl_context = "view_layer"
    bl_options: ClassVar[set[str]] = set()

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        extra = context.view_layer.grmm_passes
        column = layout.column(heading="Data")
        column.prop(context.view_layer, "use_pass_z", text="Depth")
        column.prop(extra, "use_normal")
        column.prop(extra, "use_mask")
        column.prop(extra, "use_hair")
        column.prop(extra, "use_light")
        column = layout.column(heading="Model")
        column.prop(extra, "use_raw")
        column.prop(extra, "use_features")


CLASSES = (GRMM_PT_render, GRMM_PT_viewport, GRMM_PT_film, GRMM_PT_motion_blur, GRMM_PT_passes)


def register() -> None:
    """Show Blender's general panels with this engine too."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    """Take back `register`."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard(ENGINE)


def _shared_panels() -> list[type[bpy.types.Panel]]:
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in _EXCLUDED
    ]
