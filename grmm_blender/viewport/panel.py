"""The sidebar panel of the splat viewport."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..rig.avatar import avatar_of
from . import overlay

_WRAP = 48  # characters of a line in the sidebar


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
        avatar = avatar_of(context.object)
        if avatar is not None:
            # Bounds hide the mesh, so that only splats are seen.
            layout.prop(avatar.object, "display_type", text="Mesh")
        if settings.use_splats:
            for line in overlay.statuses():
                _draw_text(layout, line)


def _draw_text(layout: bpy.types.UILayout, text: str) -> None:
    """Draw a sentence over as many lines as it needs."""
    column = layout.column(align=True)
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > _WRAP:
            column.label(text=line)
            line = word
        else:
            line = f"{line} {word}".strip()
    column.label(text=line)


CLASSES = (GRMM_PT_splat_viewport,)
