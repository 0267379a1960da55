"""What happens to heads in a working file, as pictures of F12: lifecycle_render.py WEIGHTS FOLDER

Copied, changed and undone, one of two deleted, the extension off and on, saved, linked, overridden, appended.
"""

from __future__ import annotations

import sys
from pathlib import Path

import addon_utils
import bpy
import numpy as np
from render_support import (
    add_camera,
    difference,
    exact_colors,
    expected,
    expected_png,
    full_camera,
    heads,
    load_png,
    new_scene,
    render,
    use_weights,
)
from support import MODULE, empty_scene, enable, report

weights, folder = sys.argv[1], Path(sys.argv[2])
library = folder / "library.blend"
SIZE = 64, 48


def shot(name: str) -> np.ndarray:
    """F12, as PNG bytes."""
    bpy.context.view_layer.update()
    return load_png(render(folder / f"{name}.png"))


def error(name: str) -> float:
    """F12 against what the session draws of the scene's avatars."""
    found = shot(name)
    return difference(found, expected_png(expected(bpy.context.scene, full_camera(bpy.context.scene))))


def copy(linked: bool) -> bpy.types.Object:
    """Duplicate the first head with its rig, as Shift-D or Alt-D do; returns the copy."""
    first = heads(bpy.context.scene)[0]
    before = set(heads(bpy.context.scene))
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (first, first.parent):
        obj.select_set(True)
    bpy.ops.object.duplicate(linked=linked)
    made = next(head for head in heads(bpy.context.scene) if head not in before)
    made.parent.location.x += 0.2
    made["jawOpen"] = 0.9
    made.update_tag()
    return made


def delete(head: bpy.types.Object) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (head, head.parent):
        obj.select_set(True)
    bpy.ops.object.delete()


def copies() -> dict:
    found = {}
    for kind in ("full", "linked"):
        made = copy(kind == "linked")
        found[kind] = error(kind)
        found[f"{kind}_seen"] = difference(shot(f"{kind}_again"), alone)
        delete(made)
        found[f"{kind}_deleted"] = difference(shot(f"{kind}_deleted"), alone)
    return found


def undone() -> dict:
    bpy.ops.ed.undo_push(message="before")
    head = heads(bpy.context.scene)[0]
    head["jawOpen"], head.parent.location.x = 1.0, 0.05
    head.update_tag()
    after = shot("changed")
    bpy.ops.ed.undo_push(message="changed")
    bpy.ops.ed.undo()
    back = shot("undone")
    bpy.ops.ed.redo()
    again = shot("redone")
    bpy.ops.ed.undo()
    return {"changed": difference(after, alone), "undone": difference(back, alone), "redone": difference(again, after)}


def off_and_on() -> dict:
    addon_utils.disable(MODULE, default_set=True)
    scene = bpy.context.scene
    usable = any(item.identifier == "GRMM" for item in bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items)
    gone = not usable and not hasattr(scene, "grmm_render")
    enable()
    use_weights(weights)
    scene.render.engine = "GRMM"
    return {"gone": gone, "picture": difference(shot("enabled"), alone)}


def bring(link: bool) -> bpy.types.Object:
    """Bring the head of the library into an empty file with a camera."""
    scene = empty_scene()
    use_weights(weights)
    with bpy.data.libraries.load(str(library), link=link) as (there, here):
        here.objects = [name for name in there.objects if "Camera" not in name]
    for obj in here.objects:
        scene.collection.objects.link(obj)
    scene.render.engine = "GRMM"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.film_transparent = True
    exact_colors(scene)
    add_camera(scene)
    return heads(scene)[0]


def libraries() -> dict:
    found = {}
    bpy.ops.wm.open_mainfile(filepath=str(library))
    use_weights(weights)
    found["reloaded"] = difference(shot("reloaded"), alone)
    for kind in ("appended", "linked"):
        bring(kind == "linked")
        found[kind] = difference(shot(kind), alone)
    head = bring(link=True)
    made = head.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    for obj in list(bpy.context.scene.collection.objects):
        if obj.library is not None:
            bpy.context.scene.collection.objects.unlink(obj)
    found["overridden"] = difference(shot("overridden"), alone)
    made["jawOpen"] = 0.9
    made.update_tag()
    found["override_changed"] = error("override_changed")
    found["override_seen"] = difference(shot("override_seen"), alone)
    return found


scene = new_scene(weights, size=SIZE)
heads(scene)[0]["mouthSmileLeft"] = 0.5
heads(scene)[0].update_tag()
alone = shot("alone")
report(alone=error("alone_again"), covered=float((alone[..., 3] > 127).mean()))
bpy.ops.wm.save_as_mainfile(filepath=str(library))
report(copies=copies())
report(undo=undone())
report(off=off_and_on())
report(libraries=libraries())
