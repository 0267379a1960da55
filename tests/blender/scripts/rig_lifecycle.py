"""What happens to heads in a working file: renamed, parented, scaled, redone, saved, deleted, extension off and on.

rig_lifecycle.py FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import addon_utils
import bpy
import numpy as np
from render_support import unpainted
from rig_support import core_mesh, fresh_head, largest, mesh_of, new_head, randomise, update, without_detail
from support import MODULE, enable, module, report

folder = Path(sys.argv[1])


def find(name: str):
    return module("grmm_blender.rig.avatar").Avatar(bpy.data.objects[name])


def parity(avatar, seed: int) -> float:
    randomise(avatar, np.random.default_rng(seed))
    return largest(mesh_of(avatar) - core_mesh(avatar))


def world_error(avatar) -> float:
    """The evaluated mesh in the world against the core's mesh placed by `model_to_world`."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = avatar.object.evaluated_get(depsgraph)
    points = np.empty(len(evaluated.data.vertices) * 3, np.float32)
    evaluated.data.attributes["position"].data.foreach_get("vector", points)
    matrix, placed = np.array(evaluated.matrix_world), avatar.model_to_world(depsgraph)
    world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return largest(world - (core_mesh(avatar) @ placed[:3, :3].T + placed[:3, 3]))


def renamed(avatar) -> dict:
    avatar.object.name, avatar.object.data.name = "Ada", "Ada's face"
    avatar.armature.name, avatar.armature.data.name = "Ada's bones", "bones"
    avatar.object.data.shape_keys.name = "keys"
    return {"parity": parity(avatar, 1), "again": find("Ada") == avatar}


def parented(avatar) -> float:
    empty = bpy.data.objects.new("Handle", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location, empty.rotation_euler, empty.scale = (1.0, -0.5, 2.0), (0.4, 0.2, -0.9), (3.0, 3.0, 3.0)
    avatar.armature.parent = empty
    avatar.armature.location = (0.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    return world_error(avatar) / 3.0


def redone(name: str) -> dict:
    bpy.ops.ed.undo_push(message="before")
    randomise(find(name), np.random.default_rng(2))
    after = mesh_of(find(name))
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    update(find(name))
    undone = largest(mesh_of(find(name)) - after)
    bpy.ops.ed.redo()
    update(find(name))
    return {"undone": undone, "redone": largest(mesh_of(find(name)) - after), "parity": parity(find(name), 3)}


def added_and_undone() -> list[int]:
    count = len(bpy.data.objects)
    bpy.ops.ed.undo_push(message="before adding")
    with unpainted():
        bpy.ops.grmm.add_head()
    bpy.ops.ed.undo_push(message="added")
    added = len(bpy.data.objects) - count
    bpy.ops.ed.undo()
    return [added, len(bpy.data.objects) - count]


def one_of_two_deleted() -> dict:
    other = without_detail(new_head())
    both = [parity(find("Ada"), 4), parity(other, 5)]
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (other.object, other.armature):
        obj.select_set(True)
    bpy.ops.object.delete()
    left = [avatar.name for avatar in module("grmm_blender.scene.avatars").avatars_in(bpy.context.scene)]
    return {"both": both, "left": left, "parity": parity(find("Ada"), 6)}


def saved() -> dict:
    before = mesh_of(find("Ada"))
    file = str(folder / "ada.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    return {"opened": largest(mesh_of(find("Ada")) - before), "parity": parity(find("Ada"), 7)}


def switched_off() -> dict:
    head = bpy.data.objects["Ada"]
    addon_utils.disable(MODULE, default_set=True)
    evaluated = head.evaluated_get(bpy.context.evaluated_depsgraph_get())

    def positions() -> np.ndarray:
        flat = np.empty(len(evaluated.data.vertices) * 3, np.float32)
        head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.attributes["position"].data.foreach_get("vector", flat)
        return flat

    before = positions()
    head["jawOpen"] = 0.9
    head.update_tag()
    bpy.context.view_layer.update()
    result = {"gone": not hasattr(bpy.types.Object, "grmm"), "moved": largest(positions() - before)}
    bpy.context.scene.frame_set(5)
    enable()
    ours = [avatar.name for avatar in module("grmm_blender.scene.avatars").avatars_in(bpy.context.scene)]
    return result | {"back": ours, "parity": parity(find("Ada"), 8)}


avatar = without_detail(fresh_head())
report(renamed=renamed(avatar), parented=parented(avatar))
report(added=added_and_undone())
report(redo=redone("Ada"))
report(deleted=one_of_two_deleted())
report(saved=saved())
report(off=switched_off())
