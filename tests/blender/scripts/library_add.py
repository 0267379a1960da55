"""Adding avatars of the library: library_add.py [COUNT]. Without a number all of them."""

from __future__ import annotations

import sys

import bpy
import numpy as np
from render_support import unpainted
from rig_support import core_mesh, mesh_of, update, without_detail
from support import empty_scene, module, report

library = module("grmm_core.avatar.library")
result: dict = {"names": list(library.library_names()), "menu": hasattr(bpy.types, "GRMM_MT_add"), "people": {}}
empty_scene()
for name in result["names"][: int(sys.argv[1]) if len(sys.argv) > 1 else None]:
    with unpainted():
        bpy.ops.grmm.add_head(person="LIBRARY", library=name)
    avatar = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
    bare = without_detail(avatar)
    result["people"][name] = {
        "source": avatar.source,
        "object": avatar.name,
        "parity": float(np.abs(mesh_of(bare) - core_mesh(bare)).max()),
    }
path = bpy.app.tempdir + "library.blend"
bpy.ops.wm.save_as_mainfile(filepath=path)
bpy.ops.wm.open_mainfile(filepath=path)
avatars = [module("grmm_blender.rig.avatar").Avatar(o) for o in bpy.data.objects if o.type == "MESH" and o.grmm.source]
for avatar in avatars:
    update(avatar)
result["reopened"] = sorted(avatar.source for avatar in avatars)
report(**result)
