"""The sidebar panel of the splat viewport."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..rig.avatar import avatar_of
from ..width import draw_text
from . import overlay


class GRMM_PT_splat_viewport(bpy.types.Panel):
    """How avatars and splat clouds are shown in the viewport."""

    bl_label = "Viewport"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "GRMM"
    bl_order = 90
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.grmm_viewport, "use_splats", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.grmm_viewport
        column = layout.column()
        column.active = settings.use_splats
        column.prop(settings, "detail")
        column.prop(settings, "playback")
        column.prop(settings, "use_status")
        layout.prop(settings, "use_handles")
        avatar = avatar_of(context.object)
        if avatar is not None:
            # Bounds hide the mesh, so that only splats are seen.
            layout.prop(avatar.object, "display_type", text="Mesh")
        if settings.use_splats:
            for line in overlay.statuses():
                draw_text(layout, line, context)


CLASSES = (GRMM_PT_splat_viewport,)
