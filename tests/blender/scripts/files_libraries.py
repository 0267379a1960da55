"""Append, link and override a saved head, change who it is, lose its file: files_libraries.py WEIGHTS FOLDER."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import unpainted, use_weights
from rig_support import core_mesh, largest, mesh_of, model_mesh, randomise, without_detail
from support import empty_scene, module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
library = folder / "head.blend"
live = module("grmm_blender.rig.live")
avatar_of, avatars_in = module("grmm_blender.rig.avatar").avatar_of, module("grmm_blender.scene.avatars").avatars_in


def bring(link: bool):
    """Bring the head of the library into an empty file; returns its head object."""
    empty_scene()
    use_weights(weights)
    with bpy.data.libraries.load(str(library), link=link) as (there, here):
        here.objects = [name for name in there.objects if "Camera" not in name]
    for obj in here.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return next(obj for obj in here.objects if obj.type == "MESH")


def appended() -> dict:
    avatar = without_detail(avatar_of(bring(link=False)))
    avatar.object.animation_data_clear()
    randomise(avatar, np.random.default_rng(0))
    return {"parity": largest(mesh_of(avatar) - core_mesh(avatar)), "source": Path(avatar.source).name}


def linked() -> dict:
    avatar = avatar_of(bring(link=True))
    bpy.context.view_layer.objects.active = avatar.object
    return {
        "message": live.limitation(avatar),
        "poll": bpy.ops.grmm.reset.poll(),
        "source": Path(avatar.source).exists(),
        "parity": largest(mesh_of(avatar) - model_mesh(avatar)),
    }


def overridden() -> dict:
    head = bring(link=True)
    override = head.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    for obj in list(bpy.context.scene.collection.objects):
        if obj.library is not None:
            bpy.context.scene.collection.objects.unlink(obj)
    avatar = avatar_of(override)
    bpy.context.view_layer.update()
    before = mesh_of(avatar)
    override["browInnerUp"] = 0.9
    avatar.armature.pose.bones["jaw"].rotation_euler = (0.2, 0.0, 0.0)
    override.update_tag()
    avatar.armature.update_tag()
    bpy.context.view_layer.update()
    moved = largest(mesh_of(avatar) - before)
    message = live.limitation(avatar)
    file = folder / "shots" / "override.blend"
    file.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    bpy.context.scene.frame_set(1)
    after = mesh_of(avatar)
    bpy.ops.wm.open_mainfile(filepath=str(file))
    again = avatars_in(bpy.context.scene)[0]
    bpy.context.scene.frame_set(1)
    again.object.grmm.known_path = ""
    return {
        "source": Path(again.source).exists(),
        "moved": moved,
        "message": message,
        "kept": [round(float(again.controls().aligned[2]), 4), round(float(again.controls().pose[2, 0]), 4)],
        "reloaded": largest(mesh_of(again) - after),
    }


def another_person() -> dict:
    """Change the source of a head in place, to another person, to nobody, and back."""
    avatar = avatar_of(bring(link=False))
    avatar.object.animation_data_clear()
    randomise(avatar, np.random.default_rng(1))
    before = mesh_of(avatar)
    stored = avatar.source
    avatar.object.grmm.source = "sample:9"
    bpy.context.view_layer.update()
    other = {"parity": largest(mesh_of(avatar) - model_mesh(avatar)), "changed": largest(mesh_of(avatar) - before)}
    kept = mesh_of(avatar)
    avatar.object.grmm.source = str(folder / "gone.grmm")
    bpy.context.view_layer.update()
    missing = {"message": live.state_of(avatar).message, "mesh": largest(mesh_of(avatar) - kept)}
    bpy.context.view_layer.objects.active = avatar.object
    try:
        bpy.ops.grmm.relink_avatar(filepath=str(folder / "still_gone.grmm"))
    except RuntimeError as error:
        missing["relink"] = str(error)
    bpy.ops.grmm.relink_avatar(filepath=stored)
    bpy.context.view_layer.update()
    back = {"mesh": largest(mesh_of(avatar) - before), "message": live.state_of(avatar).message}
    return {"other": other, "missing": missing, "back": back}


def bad_files() -> list[str]:
    """Messages of the add operator for files that cannot be used."""
    empty_scene()
    messages = []
    (folder / "broken.grmm").write_bytes((folder / "person.grmm").read_bytes()[:500])
    for name in ("gone.grmm", "broken.grmm", ""):
        try:
            with unpainted():
                bpy.ops.grmm.add_head(person="FILE", filepath=str(folder / name) if name else "")
        except RuntimeError as error:
            messages.append(str(error).strip().splitlines()[0].removeprefix("Error: "))
    return [*messages, str(len(bpy.data.objects))]


def saved_elsewhere() -> dict:
    """Save a copy of the file to another folder, fail to save it, save it as another file, append from there to a third."""
    bpy.ops.wm.open_mainfile(filepath=str(library))
    obj = avatars_in(bpy.context.scene)[0].object
    stored, key = obj.grmm.source, module("grmm_blender.hair.swing").hair_key
    obj.grmm.known_path, obj.grmm.hair.swing_of = "", key(obj)
    obj.grmm.hair.swing_file = "//grmm_hair/head.npz"
    copy, own = folder / "deep" / "er" / "copy.blend", folder / "deep" / "head.blend"
    copy.parent.mkdir(parents=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True)
    with contextlib.suppress(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "not" / "there" / "head.blend"))
    found = {"untouched": [obj.grmm.source == stored, obj.grmm.hair.swing_file == "//grmm_hair/head.npz"]}
    for name, file in (("saved", own), ("opened", own), ("copy", copy)):
        if name == "saved":
            bpy.ops.wm.save_as_mainfile(filepath=str(file))
        else:
            bpy.ops.wm.open_mainfile(filepath=str(file))
        avatar = avatars_in(bpy.context.scene)[0]
        hair = avatar.object.grmm.hair
        swing = Path(bpy.path.abspath(hair.swing_file)).resolve() == folder.resolve() / "grmm_hair" / "head.npz"
        relative = avatar.object.grmm.source.startswith("//")
        found[name] = [Path(avatar.source).exists(), relative, swing, hair.swing_of == key(avatar.object)]
    empty_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shots" / "appended.blend"))
    with bpy.data.libraries.load(str(own)) as (there, here):
        here.objects = [name for name in there.objects if "Camera" not in name]
    avatar = next(avatar_of(obj) for obj in here.objects if obj.type == "MESH")
    avatar.object.grmm.known_path = ""
    found["appended"] = [Path(avatar.source).exists(), avatar.object.grmm.source.startswith("//")]
    return found


def in_a_collection() -> dict:
    """Curves for a head whose collection is a library's, linked and then overridden."""
    bpy.ops.wm.open_mainfile(filepath=str(library))
    obj, people = avatars_in(bpy.context.scene)[0].object, bpy.data.collections.new("People")
    bpy.context.scene.collection.children.link(people)
    for part in (obj, obj.parent):
        bpy.context.scene.collection.objects.unlink(part)
        people.objects.link(part)
    obj.grmm.hair.groom = "crop"
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "people.blend"))
    scene = empty_scene()
    use_weights(weights)
    with bpy.data.libraries.load(str(folder / "people.blend"), link=True) as (_, here):
        here.collections = ["People"]
    people = here.collections[0]
    scene.collection.children.link(people)
    scene.frame_end = 2
    caches = [cache_of(avatars_in(scene)[0], "linked.abc")]
    people.override_hierarchy_create(scene, bpy.context.view_layer, do_fully_editable=True)
    scene.collection.children.unlink(people)
    avatar = avatars_in(scene)[0]
    caches.append(cache_of(avatar, "overridden.usdc"))
    left = [len(bpy.data.hair_curves), len(bpy.data.materials), len(bpy.data.objects)]
    hair_build = module("grmm_blender.hair.build")
    kept, hair_build.link_beside = hair_build.link_beside, None  # whatever fails
    try:
        hair_build.make_curves(avatar, None)
    except TypeError:
        left = [left, [len(bpy.data.hair_curves), len(bpy.data.materials), len(bpy.data.objects)]]
    hair_build.link_beside = kept
    bpy.context.view_layer.objects.active = avatar.object
    bpy.ops.grmm.hair_as_curves(sculpt=False)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "people_shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    avatar = avatars_in(bpy.context.scene)[0]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    drawn = module("grmm_blender.scene.avatars").DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph)
    count = len(module("grmm_core.hair").library_groom("crop"))
    strands = 0 if drawn.strands is None else int((drawn.strands.groom.groups == 0).sum())
    return {"caches": caches, "left": left, "note": drawn.note, "strands": [strands, count]}


def cache_of(avatar, name: str) -> list[int]:
    """Bytes of mesh caches of an avatar with its hair and without."""
    bpy.context.view_layer.objects.active, hair = avatar.object, avatar.object.grmm.hair
    sizes = []
    for groom in ("crop", "NONE"):
        hair.groom = groom
        bpy.ops.grmm.export_cache(filepath=str(folder / name))
        sizes.append((folder / name).stat().st_size)
    hair.groom = "crop"
    return sizes


report(appended=appended())
report(linked=linked())
report(overridden=overridden())
report(person=another_person())
report(bad=bad_files())
report(elsewhere=saved_elsewhere())
report(collection=in_a_collection())
