"""The engine's Blender class."""

from __future__ import annotations

import bpy


class GRMM_RenderEngine(bpy.types.RenderEngine):
    """Renders GRMM avatars with their Gaussians."""

    bl_idname = "GRMM"
    bl_label = "GRMM"
    bl_use_preview = False


CLASSES = (GRMM_RenderEngine,)


def unregister_at_exit() -> None:
    """Unregister the engine if it still is registered."""
    if GRMM_RenderEngine.is_registered:
        bpy.utils.unregister_class(GRMM_RenderEngine)
