"""Brows, beard and lashes as Blender's curves: hair_parts.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
head = heads(scene)[0]
hair = head.grmm.hair
avatars, roots = module("grmm_blender.scene.avatars"), module("grmm_core.hair.roots")


def worn():
    """The avatar as the scene shows it now."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    avatar = avatars.avatars_in(scene)[0]
    return avatars.DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph)


def picture(name: str) -> np.ndarray:
    return load_png(render(folder / f"{name}.png"))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of two pictures, of 255."""
    return float(np.abs(one - other).mean())


def counts(strands) -> list[int]:
    """Strands of each part."""
    return np.bincount(strands.groom.groups, minlength=len(roots.GROUPS)).tolist()


def lengths(strands) -> list[float]:
    """Mean length of each part's strands as Blender evaluates them."""
    steps = np.linalg.norm(np.diff(strands.points, axis=0), axis=1)
    steps[strands.groom.offsets[1:-1] - 1] = 0.0
    every = np.add.reduceat(np.append(steps, 0.0), strands.groom.offsets[:-1])
    return [float(every[strands.groom.groups == group].mean()) for group in range(len(roots.GROUPS))]


hair.groom, hair.brows, hair.beard, hair.lashes, hair.melanin = "crop", "bushy", "goatee", "natural", 0.4
library = module("grmm_core.hair").library_groom
parts = {"brows": "bushy", "beard": "goatee", "lashes": "natural"}
report(grooms=[len(library("crop")), *(len(library(name, part=part)) for part, name in parts.items())])
plain = picture("plain")
bpy.ops.grmm.hair_as_curves(sculpt=False)
curves, data = hair.curves, hair.curves.data
strands, shown = worn(), picture("curves")
report(
    same=apart(shown, plain), counts=counts(strands.strands), use=[strands.hair.brows, strands.hair.beard, strands.hair.lashes]
)
before = lengths(strands.strands)
hair.length = 0.5
report(lengths=np.divide(lengths(worn().strands), before).tolist())
hair.length = 1.0

# Lashes go with their lids, as those of the package do.
head["eyeBlinkLeft"] = 1.0
head.update_tag()
blinked = picture("blinked")
kept, hair.curves = hair.curves, None
report(blinked=apart(picture("blinked_groom"), blinked), lid=apart(blinked, shown))
hair.curves, head["eyeBlinkLeft"] = kept, 0.0
head.update_tag()

# Back into a file, and what the panel says anew counts instead.
file = folder / "parts.grmm"
bpy.ops.grmm.save_avatar(filepath=str(file))
saved = module("grmm_core.avatar").load_avatar(file).hair.groom
report(saved=np.bincount(saved.groups, minlength=4).tolist())
hair.beard = "NONE"
report(shaved=apart(picture("shaved"), shown), shaved_use=worn().hair.beard)
hair.beard = "goatee"

# Hairs that somebody drew have no part: their roots tell.
data.attributes.remove(data.attributes["grmm_part"])
report(told=counts(worn().strands))
data.remove_curves(indices=np.flatnonzero(worn().strands.groom.groups == roots.BEARD).tolist())
report(cut=counts(worn().strands), cut_use=worn().hair.beard)

# Hair that a knot holds keeps its length, also as curves.
hair.curves, hair.beard = None, "NONE"
hair.groom = "bun"
bpy.ops.grmm.hair_as_curves(sculpt=False)
before = lengths(worn().strands)[roots.SCALP]
hair.length = 2.0
report(tied=lengths(worn().strands)[roots.SCALP] / before)

# A session hears whether hair was made of the person's own, as a file has it, or of somebody else's.
made_of = [worn().hair.of_own]
bpy.ops.grmm.open_avatar(filepath=str(file))
fitted = bpy.context.object if bpy.context.object.type == "MESH" else bpy.context.object.children[0]
bpy.ops.grmm.hair_as_curves(sculpt=False)
bpy.context.view_layer.update()
depsgraph = bpy.context.evaluated_depsgraph_get()
avatar = avatars.Avatar(fitted)
made_of.append(avatars.DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph).hair.of_own)
report(made_of=made_of)

# Duplicated with its head, hair follows the copy's sliders and color; a head that is deleted takes its hair and rig along.
rig, first = fitted.parent, fitted.grmm.hair
for obj in (rig, *rig.children_recursive):
    obj.select_set(True)
before = {obj.name for obj in bpy.data.objects}
bpy.ops.object.duplicate()
copy = next(obj for obj in bpy.data.objects if obj.name not in before and obj.type == "MESH")
second = copy.grmm.hair
bpy.context.view_layer.update()
reports = {"own": [second.curves != first.curves, second.curves.data.surface == copy]}
second.length, second.dye, second.melanin = 0.5, 0.0, 0.05
bpy.context.view_layer.update()


def drawn(obj: bpy.types.Object) -> list[float]:
    """Length of the scalp's hair as Blender evaluates it, and how bright its material is."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    wearer = avatars.Avatar(obj)
    shot = avatars.DrawnAvatar(wearer, wearer.model_to_world(depsgraph)).shot(depsgraph)
    nodes = obj.grmm.hair.curves.data.materials[0].node_tree.nodes
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    return [lengths(shot.strands)[roots.SCALP], float(sum(shader.inputs["Base Color"].default_value[:3]))]


reports["first"], reports["second"] = drawn(fitted), drawn(copy)
left_rigs = module("grmm_blender.rig.left_rigs").LeftRigs()
left_rigs.notice_deleted()
for obj in bpy.context.selected_objects:
    obj.select_set(False)
copy.select_set(True)
bpy.ops.object.delete()
reports["noticed"] = left_rigs.notice_deleted()
left_rigs.remove()
reports["left"] = sorted({obj.name for obj in bpy.data.objects} - before)
reports["kept"] = sorted(before - {obj.name for obj in bpy.data.objects})
report(duplicate=reports)

# A linked duplicate shares mesh and curves until it is made independent; so does one that was duplicated without its curves.
shared = {}
for case, parts in {"linked": (rig, fitted, first.curves), "without curves": (rig, fitted)}.items():
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    for obj in parts:
        obj.select_set(True)
    before = {obj.name for obj in bpy.data.objects}
    bpy.ops.object.duplicate(linked=case == "linked")
    copy = next(obj for obj in bpy.data.objects if obj.name not in before and obj.type == "MESH")
    bpy.context.view_layer.objects.active = copy
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    wearer = avatars.Avatar(copy)
    note = avatars.DrawnAvatar(wearer, wearer.model_to_world(depsgraph)).shot(depsgraph).note
    bpy.ops.grmm.make_independent()
    copy.grmm.hair.length = 0.5
    bpy.context.view_layer.update()
    curves = [obj.grmm.hair.curves for obj in (fitted, copy)]
    shared[case] = {
        "note": note, "polls": bpy.ops.grmm.make_independent.poll(), "meshes": fitted.data != copy.data,
        "own": [one.data.surface == obj and one.parent == obj for one, obj in zip(curves, (fitted, copy), strict=True)],
        "lengths": [drawn(fitted)[0], drawn(copy)[0]],
    }  # fmt: skip
report(shared=shared)
