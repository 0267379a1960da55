"""Hair that another engine does not draw and still takes for what throws shadows: on scene meshes, and on the avatar's mesh.

Hair that is curves already is handed over like the head. A groom of the panel, which has no object, becomes curves for as long
as the composite is set up; *Put Right* makes them anew after another groom was chosen.
"""

from __future__ import annotations

import bpy

from ...grmm_core.errors import GrmmError
from ..hair.build import make_curves, worn_hair
from ..rig.avatar import Avatar
from ..scene import walk

_MARK = "grmm_shadow"  # of curves that were made for a composite


def curves_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Curves that are hair of a scene's avatars."""
    return [a.object.grmm.hair.curves for a in _worn(scene) if a.object.grmm.hair.curves is not None]


def make(scene: bpy.types.Scene) -> None:
    """Give every groom of a scene's avatars curves that no camera sees, instead of those of before."""
    remove(scene)
    for avatar in _worn(scene):
        if avatar.object.grmm.hair.curves is not None:
            continue
        try:
            hair = worn_hair(avatar)
            if hair is None or hair.groom is None or not len(hair.groom):
                continue
            curves = make_curves(avatar, hair.groom, hair.settings)
        except GrmmError:  # a file or a runtime is missing: the render says so, and whatever else is composited stays usable
            continue
        curves[_MARK] = curves.hide_viewport = True
        curves.visible_camera = False


def remove(scene: bpy.types.Scene) -> None:
    """Take these curves away again."""
    for obj in [obj for obj in scene.objects if _MARK in obj]:
        data, materials = obj.data, list(obj.data.materials)
        bpy.data.objects.remove(obj)
        bpy.data.hair_curves.remove(data)
        for material in materials:
            bpy.data.materials.remove(material)


def _worn(scene: bpy.types.Scene) -> list[Avatar]:
    return [avatar for avatar in walk.avatars_in(scene) if walk.is_drawn(avatar)]
