"""Import splat files and other projects' avatars: splats_import.py WEIGHTS FOLDER (with the files of test_blender_splats)."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import bpy
import numpy as np
from render_support import difference, expected_png, full_camera, load_png, new_scene, render
from support import empty_scene, module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
formats = module("grmm_core.formats")
session_api = module("grmm_core.session")
splats, walk = module("grmm_blender.splats"), module("grmm_blender.scene.walk")
clouds_in = module("grmm_blender.scene.clouds").clouds_in
host = module("grmm_blender.session_host")
arkit = module("grmm_core.controls.names").ARKIT_NAMES


def scene_with(*names: str, **options) -> list[bpy.types.Object]:
    """An empty scene with imported files; returns what became active after each import."""
    scene = new_scene(weights, heads=0)
    found = []
    for name in names:
        bpy.ops.grmm.import_splats(filepath=str(folder / name), **options)
        found.append(bpy.context.object)
    scene.render.engine = "GRMM"
    return found


def arrays(cloud) -> object:
    return session_api.CloudArrays(cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh)


def shot(obj: bpy.types.Object):
    return splats.Cloud(obj).shot(bpy.context.evaluated_depsgraph_get()).arrays


def gap(found, wanted) -> list[float]:
    """Largest differences of centres, of rotations (1 - |cos|), of scales relative to themselves."""
    turned = 1 - np.abs((found.quats * wanted.quats).sum(1))
    return [
        float(np.abs(found.means - wanted.means).max()),
        float(turned.max()),
        float(np.abs(found.scales / wanted.scales - 1).max()),
    ]


def every_format() -> dict:
    """Objects of each format, and the rendered picture against the session's own of the same file."""
    result = {}
    for name in ("cloud.ply", "cloud.splat", "cloud.spz", "cloud.glb"):
        (obj,) = scene_with(name)
        scene = bpy.context.scene
        obj.location, obj.rotation_euler, obj.scale = (0.02, 0.1, -0.03), (0.3, 0.2, 0.9), (1.1, 1.1, 1.1)
        bpy.context.view_layer.update()
        picture = load_png(render(folder / f"{name}.png"))
        own = formats.read_splats(folder / name)
        placed = session_api.Instance(
            host.get_session().put_cloud(f"test {name}", "1", arrays(own)),
            model_to_world=np.array(obj.matrix_world) @ session_api.HEAD_TO_BLENDER,
        )
        buffers = host.get_session().render([placed], full_camera(scene), session_api.RenderOptions(passes=("rgb", "alpha")))
        result[name] = {
            "count": len(obj.data.vertices),
            "gap": gap(shot(obj), own),
            "picture": difference(picture, expected_png(buffers)),
            "covered": float((picture[..., 3] > 128).mean()),
            "terms": shot(obj).harmonics.shape[1],
        }
    return result


def kept_in_files() -> dict:
    """Saved and opened again, duplicated, moved, hidden, edited."""
    (obj,) = scene_with("cloud.ply")
    before = shot(obj)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "saved.blend"))
    obj = clouds_in(bpy.context.scene)[0].object
    after = shot(obj)
    copy = obj.copy()
    copy.data = obj.data.copy()
    bpy.context.collection.objects.link(copy)
    copy.data.vertices[0].co.x += 0.5
    names = [cloud.name for cloud in clouds_in(bpy.context.scene)]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    versions = [splats.Cloud(o).shot(depsgraph).version for o in (obj, copy)]
    both = len(walk.read_scene(depsgraph).avatars)
    copy.hide_viewport = True
    one = len(walk.read_scene(bpy.context.evaluated_depsgraph_get()).avatars)
    copy.data.attributes.remove(copy.data.attributes["rotation"])
    copy.hide_viewport = False
    bpy.context.scene.view_layers[0].update()
    try:
        render(folder / "damaged.png")
        message = "rendered"
    except RuntimeError as error:
        message = str(error)
    return {
        "same": float(np.abs(before.means - after.means).max() + np.abs(before.harmonics - after.harmonics).max()),
        "names": names,
        "versions": len(set(versions)),
        "shown": [both, one],
        "damaged": message,
    }


def beside_a_head() -> dict:
    """A cloud behind, beside and in front of a head."""
    scene = new_scene(weights, heads=1)
    head = next(o for o in scene.objects if o.type == "MESH")
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.grmm.import_splats(filepath=str(folder / "cloud.ply"))
    cloud = bpy.context.object
    scene.view_layers[0].grmm_passes.use_mask = True
    masks = {}
    for where, y in (("front", -0.5), ("behind", 0.6)):
        cloud.location = (0.0, y, 0.0)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        camera = full_camera(scene)
        shots = walk.read_scene(depsgraph).avatars
        instances = module("grmm_blender.engine.pipeline").open_instances(shots)
        buffers = host.get_session().render(instances, camera, session_api.RenderOptions(passes=("rgb", "alpha", "mask")))
        picture = load_png(render(folder / f"{where}.png"))
        index = [shot.name for shot in shots].index(head.name)
        masks[where] = [float(buffers["mask"][..., index].sum()), difference(picture, expected_png(buffers))]
    return {"masks": masks, "names": walk.drawn_objects(scene) == sorted([head, cloud], key=lambda obj: obj.name)}


def lam() -> dict:
    (obj,) = scene_with("lam.zip")
    own = formats.read_avatar(folder / "lam.zip")
    obj["jawOpen"], obj["mouthSmileLeft"] = 0.6, 0.3
    obj.update_tag()
    bpy.context.view_layer.update()
    moved = gap(shot(obj), own.splats({"jawOpen": 0.6, "mouthSmileLeft": 0.3}))
    render(folder / "lam.png")
    bpy.context.scene.render.fps = 30
    can = bpy.ops.grmm.import_performance.poll()
    bpy.ops.grmm.import_performance(filepath=str(folder / "speech.json"), start=1, limit=False)
    recorded = formats.read_performance(folder / "speech.json")
    bpy.context.scene.frame_set(21)
    wanted = own.splats({name: float(w) for name, w in zip(arkit, recorded.weights[20], strict=True)})
    return {
        "controls": sum(name in obj for name in arkit),
        "moved": moved,
        "can": can,
        "performed": gap(shot(obj), wanted),
        "occludes": len(walk.read_scene(bpy.context.evaluated_depsgraph_get()).occluders.plain),
    }


def cap4d() -> dict:
    (obj,) = scene_with("cap4d.ply")
    own = formats.read_avatar(folder / "cap4d.ply")
    result = {"frames": own.frame_count, "gaps": []}
    for frame in range(own.frame_count):
        bpy.context.scene.frame_set(bpy.context.scene.frame_start + frame)
        result["gaps"].append(gap(shot(obj), own.splats(frame)))
    return result


def gaussian_avatar() -> dict:
    """On a stand-in for the user's FLAME file."""
    empty_scene()
    path = folder / "person" / "point_cloud.ply"
    try:
        bpy.ops.grmm.import_splats(filepath=str(path))
        message = "accepted"
    except RuntimeError as error:
        message = str(error).strip().splitlines()[0].removeprefix("Error: ")
    bpy.context.scene.render.fps = 25
    bpy.ops.grmm.import_splats(filepath=str(path), flame_file=str(folder / "flame2023.pkl"))
    carrier = bpy.context.object
    cloud = clouds_in(bpy.context.scene)[0]
    head = module("grmm_core.head").load_flame(folder / "flame2023.pkl")
    own = formats.read_avatar(path)
    place = module("grmm_core.formats.avatars.binding").place_on_mesh
    track, gaps = own.track, []
    for k in (0, 3):
        bpy.context.scene.frame_set(bpy.context.scene.frame_start + k)
        pose = np.zeros((5, 3))
        pose[0], pose[1], pose[2] = track.head_rotation[k], track.neck_rotation[k], track.jaw_rotation[k]
        pose[3], pose[4] = track.left_eye_rotation[k], track.right_eye_rotation[k]
        vertices = head.vertices(track.shape, track.expression[k], pose)
        gaps.append(gap(shot(cloud.object), place(own.cloud, vertices, head.faces)))
    bpy.context.scene.frame_set(500)
    carrier["jawOpen"] = 0.0
    still = shot(cloud.object).means.copy()
    for curve in list(module("grmm_blender.rig.actions").action_curves(carrier)):
        if curve.data_path == '["jawOpen"]':
            curve.mute = True
    carrier["jawOpen"] = 0.7
    carrier.update_tag()
    bpy.context.view_layer.update()
    opened = float(np.abs(shot(cloud.object).means - still).max())
    drawn = [shot.name for shot in walk.read_scene(bpy.context.evaluated_depsgraph_get()).avatars]
    return {"message": message, "gaps": gaps, "opened": opened, "drawn": drawn, "cloud": cloud.name}


def sog() -> dict:
    """Blender's own decoder of pictures gives the bytes that Pillow gives."""
    empty_scene()
    bpy.ops.grmm.import_splats(filepath=str(folder / "cloud.sog"))
    decode = module("grmm_blender.splats.pictures").decode_picture
    with zipfile.ZipFile(folder / "cloud.sog") as archive:
        pictures = {name: decode(archive.read(name)) for name in archive.namelist() if name.endswith(".webp")}
    np.savez(folder / "pictures.npz", **pictures)
    return {"count": len(bpy.context.object.data.vertices), "images": len(bpy.data.images)}


def messages() -> dict:
    empty_scene()
    result = {}
    for name in ("gone.ply", "truncated.spz", "text.ply", "unknown.xyz", ""):
        try:
            bpy.ops.grmm.import_splats(filepath=str(folder / name) if name else "")
            result[name] = "accepted"
        except RuntimeError as error:
            result[name] = str(error).strip().splitlines()[0].removeprefix("Error: ")
    return {"messages": result, "left": len(bpy.data.objects)}


report(formats=every_format())
report(kept=kept_in_files())
report(beside=beside_a_head())
report(lam=lam())
report(cap4d=cap4d())
report(flame=gaussian_avatar())
report(sog=sog())
report(errors=messages())
