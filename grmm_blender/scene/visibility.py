"""Which objects a render of a view layer shows, and which cut holes into it."""

from __future__ import annotations

import bpy


def is_rendered(obj: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether the camera of a render sees an object's Gaussians. A composite hides from other engines what GRMM draws."""
    return (obj.visible_camera or obj.grmm_handed_over) and not obj.indirect_only_get(view_layer=view_layer)


def is_holdout(obj: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether an object, or its collection in the view layer, is a holdout."""
    return obj.is_holdout or obj.holdout_get(view_layer=view_layer)
