"""The engine's Blender class; every method delegates."""

from __future__ import annotations

import bpy

from ..scene.walk import drawn_objects
from . import final, passes
from .settings import ENGINE
from .view import ViewRenderer


class GRMM_RenderEngine(bpy.types.RenderEngine):
    """Renders GRMM avatars with their Gaussians."""

    bl_idname = ENGINE
    bl_label = "GRMM"
    bl_use_preview = False
    bl_use_exclude_layers = True
    bl_use_eevee_viewport = True  # material preview shows the scene with EEVEE

    # A `ViewRenderer` once the viewport is drawn; Blender would take an annotation for a property. It ends with this object,
    # whose own `__del__` could not reach it any more.
    _view = None

    def update_render_passes(self, scene: bpy.types.Scene, renderlayer: bpy.types.ViewLayer) -> None:
        """Tell Blender which passes there are."""
        passes.register_passes(self, scene, renderlayer, [obj.name for obj in drawn_objects(scene, instanced=True)])

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Render one view layer of one frame."""
        final.render(self, depsgraph)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Follow a change of the scene in a rendered viewport."""
        self._viewport().update(depsgraph)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw a rendered viewport."""
        self._viewport().draw(self, context, depsgraph)

    def _viewport(self) -> ViewRenderer:
        if self._view is None:
            self._view = ViewRenderer()
        return self._view


CLASSES = (GRMM_RenderEngine,)
