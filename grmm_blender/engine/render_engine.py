"""The engine's Blender class; every method delegates."""

from __future__ import annotations

import bpy

from . import collect, final, passes


class GRMM_RenderEngine(bpy.types.RenderEngine):
    """Renders GRMM avatars with their Gaussians."""

    bl_idname = "GRMM"
    bl_label = "GRMM"
    bl_use_preview = False
    bl_use_exclude_layers = True
    bl_use_eevee_viewport = True  # material preview shows the scene with EEVEE

    def update_render_passes(self, scene: bpy.types.Scene, renderlayer: bpy.types.ViewLayer) -> None:
        """Tell Blender which passes there are."""
        passes.register_passes(self, scene, renderlayer, collect.avatar_names(scene))

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Render one view layer of one frame."""
        final.render(self, depsgraph)


CLASSES = (GRMM_RenderEngine,)
