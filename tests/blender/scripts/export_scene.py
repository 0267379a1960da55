"""Export from a scene: export_scene.py WEIGHTS FOLDER (with the files of test_blender_export)."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import new_scene
from rig_support import mesh_of
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
session_api = module("grmm_core.session")
host = module("grmm_blender.session_host")
avatar_of = module("grmm_blender.rig.avatar").avatar_of
clouds_in = module("grmm_blender.scene.clouds").clouds_in


def posed_head():
    """A smiling head that turns, in a scene of five frames; not where the world's origin is."""
    scene = new_scene(weights, heads=1)
    scene.frame_start, scene.frame_end, scene.render.fps = 11, 15, 30
    avatar = avatar_of(bpy.context.object)
    for frame, amount in ((11, 0.0), (15, 0.8)):
        avatar.object["mouthSmileLeft"] = amount
        avatar.object.keyframe_insert('["mouthSmileLeft"]', frame=frame)
        bone = avatar.armature.pose.bones["neck"]
        bone.rotation_euler = (0.1 * amount, 0.4 * amount, 0.0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(14)
    return avatar


def message(call) -> str:
    try:
        call()
    except RuntimeError as error:
        return str(error).strip().splitlines()[0].removeprefix("Error: ")
    return "accepted"


def world_vertices(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    evaluated = obj.evaluated_get(depsgraph)
    return np.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.data.vertices])


def files() -> dict:
    avatar = posed_head()
    for extension in (".ply", ".spz", ".splat", ".glb"):
        bpy.ops.grmm.export_splats(filepath=str(folder / f"frame{extension}"), format=extension, degree=1)
    bpy.ops.grmm.export_splats(filepath=str(folder / "rest"), pose="CANONICAL", degree=0, lod=1)
    bpy.ops.grmm.export_splats(filepath=str(folder / "walk_###.ply"), pose="SEQUENCE", degree=0, lod=2, first=12, last=14)
    bpy.ops.grmm.export_splats(filepath=str(folder / "person.zip"), format=".zip", pose="CANONICAL", lod=1)
    frame = bpy.context.scene.frame_current
    info = host.open_avatar(avatar.source)
    controls = avatar.controls(bpy.context.evaluated_depsgraph_get())
    found = host.get_session().gaussians(info.id, controls)
    found = type(found)(*(part[found.opacities >= 1.0 / 255.0] for part in found))  # the others are never drawn
    np.savez(folder / "gaussians.npz", means=found.means, scales=found.scales, opacities=found.opacities, colors=found.colors)
    return {
        "frame": frame,
        "missing_folder": message(lambda: bpy.ops.grmm.export_splats(filepath=str(folder / "none" / "a.ply"))),
        "no_name": message(lambda: bpy.ops.grmm.export_splats(filepath="")),
        "no_frames": message(lambda: bpy.ops.grmm.export_splats(
            filepath=str(folder / "x.ply"), pose="SEQUENCE", first=20, last=10)),
    }  # fmt: skip


def meshes() -> dict:
    avatar = posed_head()
    bpy.ops.grmm.export_mesh(filepath=str(folder / "head.glb"))
    bpy.ops.grmm.export_mesh(filepath=str(folder / "head.obj"), canonical=False)
    np.save(folder / "posed.npy", mesh_of(avatar))
    return {}


def caches() -> dict:
    """Written and read again by Blender."""
    avatar = posed_head()
    scene = bpy.context.scene
    scene.frame_set(15)
    wanted = world_vertices(avatar.object, bpy.context.evaluated_depsgraph_get())
    result, active = {}, bpy.context.object
    bpy.ops.grmm.export_cache(filepath=str(folder / "cache.abc"))
    bpy.ops.grmm.export_cache(filepath=str(folder / "cache.usdc"), first=15, last=15)
    result["range"] = [scene.frame_start, scene.frame_end, scene.frame_current]
    result["active"] = bpy.context.object == active
    for name, importer in (("cache.abc", bpy.ops.wm.alembic_import), ("cache.usdc", bpy.ops.wm.usd_import)):
        before = set(bpy.data.objects)
        importer(filepath=str(folder / name))
        scene.frame_set(15)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        (made,) = [o for o in bpy.data.objects if o not in before and o.type == "MESH"]
        found = world_vertices(made, depsgraph)
        result[name] = float(np.abs(found - wanted).max()) if found.shape == wanted.shape else -1.0
    return result


def performances() -> dict:
    avatar = posed_head()
    scene = bpy.context.scene
    bpy.context.view_layer.objects.active = avatar.object
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=1)
    bpy.ops.grmm.export_performance(filepath=str(folder / "again.json"))
    bpy.ops.grmm.export_performance(filepath=str(folder / "again.csv"), first=1, last=31)
    needs = message(lambda: bpy.ops.grmm.export_performance(filepath=str(folder / "again.npz")))
    bpy.ops.grmm.export_performance(
        filepath=str(folder / "again.npz"), first=1, last=11, flame_file=str(folder / "flame2023.pkl")
    )
    return {"needs": needs, "detail": avatar.object.grmm.live_detail, "frame": scene.frame_current}


def gaussian() -> dict:
    avatar = posed_head()
    needs = message(lambda: bpy.ops.grmm.export_gaussian_avatar(directory=str(folder / "ours")))
    flame = str(folder / "flame2023.pkl")
    bpy.ops.grmm.export_gaussian_avatar(directory=str(folder / "ours"), flame_file=flame, degree=0)
    info = host.open_avatar(avatar.source)
    found = host.get_session().gaussians(info.id, module("grmm_core.controls.frame").Controls())
    np.savez(folder / "resting.npz", means=found.means)
    # The other way: somebody else's avatar, imported, written, imported again.
    new_scene(weights, heads=0)
    bpy.context.scene.render.fps = 25
    bpy.ops.grmm.import_splats(filepath=str(folder / "person" / "point_cloud.ply"), flame_file=flame)
    bpy.context.scene.frame_set(3)
    bpy.ops.grmm.export_splats(filepath=str(folder / "posed_person.ply"))
    bpy.ops.grmm.export_mesh(filepath=str(folder / "person.glb"))
    bpy.ops.grmm.export_gaussian_avatar(directory=str(folder / "theirs"), first=1, last=6)
    before = clouds_in(bpy.context.scene)[0].shot(bpy.context.evaluated_depsgraph_get()).arrays
    new_scene(weights, heads=0)
    bpy.context.scene.render.fps = 25
    bpy.ops.grmm.import_splats(filepath=str(folder / "theirs" / "point_cloud.ply"), flame_file=flame)
    bpy.context.scene.frame_set(3)
    after = clouds_in(bpy.context.scene)[0].shot(bpy.context.evaluated_depsgraph_get()).arrays
    return {"needs": needs, "again": float(np.abs(before.means - after.means).max())}


def clouds() -> dict:
    """A cloud that is read and written again."""
    new_scene(weights, heads=0)
    bpy.ops.grmm.import_splats(filepath=str(folder / "cloud.ply"))
    bpy.context.object.location.x = 3.0  # placement is not part of the file
    bpy.ops.grmm.export_splats(filepath=str(folder / "cloud_again.ply"))
    lam = message(lambda: bpy.ops.grmm.export_splats(filepath=str(folder / "cloud.zip"), format=".zip"))
    bpy.context.object.select_set(False)
    bpy.context.view_layer.objects.active = None
    return {"lam": lam, "polls": [getattr(bpy.ops.grmm, name).poll() for name in (
        "export_splats", "export_mesh", "export_performance", "export_cache", "export_gaussian_avatar")]}  # fmt: skip


for part in (files, meshes, caches, performances, gaussian, clouds):
    report(**{part.__name__: part()})
