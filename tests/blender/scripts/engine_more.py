"""View layers, stereo, motion blur, a camera inside the head, mutual occlusion: engine_more.py WEIGHTS FOLDER"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import difference, expected, expected_png, full_camera, heads, load_png, new_scene, render
from support import module, report, set_multilayer_exr

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, heads=2, size=(80, 64))
camera = scene.camera
camera.location.x, camera.rotation_euler.z, camera.data.lens = 0.17, 0.0, 45.0
bpy.context.view_layer.update()
color = module("grmm_core.pictures.color")
host = module("grmm_blender.session_host")
session = module("grmm_core.session")
first, second = heads(scene)
both = expected_png(expected(scene, full_camera(scene)))


def only(head: bpy.types.Object) -> np.ndarray:
    """PNG bytes of one head alone, by the session."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    avatar = module("grmm_blender.rig.avatar").Avatar(head)
    instance = session.Instance(
        host.open_avatar(avatar.source).id, avatar.controls(depsgraph), avatar.model_to_world(depsgraph)
    )
    return expected_png(host.get_session().render([instance], full_camera(scene)))


# View layers: each shows what its collections say; the second avatar is a holdout in the third layer.
collections = []
for head in (first, second):
    collection = bpy.data.collections.new(head.name)
    scene.collection.children.link(collection)
    for obj in (head, head.parent):
        for other in obj.users_collection:
            other.objects.unlink(obj)
        collection.objects.link(obj)
    collections.append(collection)
alone = [only(first), only(second)]
layers = [scene.view_layers[0], scene.view_layers.new("Second"), scene.view_layers.new("Cut")]
layers[0].layer_collection.children[collections[1].name].exclude = True
layers[1].layer_collection.children[collections[0].name].exclude = True
layers[2].layer_collection.children[collections[1].name].holdout = True
shots = []
for layer in layers:
    for other in layers:
        other.use = other == layer
    shots.append(load_png(render(folder / f"layer_{layer.name}.png")))
overlap = (alone[0][..., 3] > 250) & (alone[1][..., 3] > 250)
cut = shots[2][..., 3]
for layer in layers:
    layer.use = True
set_multilayer_exr(scene.render.image_settings)
scene.render.image_settings.exr_codec = "NONE"
scene.render.filepath = str(folder / "layers.exr")
bpy.ops.render.render(write_still=True)
if hasattr(scene.render.image_settings, "media_type"):
    scene.render.image_settings.media_type = "IMAGE"
scene.render.image_settings.file_format = "PNG"
report(
    layers=[difference(shots[0], alone[0]), difference(shots[1], alone[1])],
    layer_names=[layer.name for layer in layers],
    cut_outside=float(np.abs(cut - alone[0][..., 3])[alone[1][..., 3] == 0].max()),
    exr=(folder / "layers.exr").exists(),
)
for layer in layers[1:]:
    scene.view_layers.remove(layer)
layers[0].layer_collection.children[collections[1].name].exclude = False
np.savez(folder / "layers.npz", first=alone[0], second=alone[1])

# Mutual occlusion, with the second head moved behind and then before the first: nearer to it the nearer one is seen.
rig = second.parent
saved = rig.location.copy()
rig.location = (0.02, 0.5, 0.0)
bpy.context.view_layer.update()
behind = load_png(render(folder / "behind.png"))
report(mutual=difference(behind, expected_png(expected(scene, full_camera(scene)))))
wanted = only(first)
core = wanted[..., 3] > 254.5
report(front_is_seen=float(np.abs(behind[core][:, :3] - wanted[core][:, :3]).mean()), core=float(core.mean()))
rig.location = saved
bpy.context.view_layer.update()

# Stereo: each eye as a camera moved aside whose lens is shifted back.
scene.render.use_multiview = True
scene.render.views_format = "STEREO_3D"
scene.render.image_settings.views_format = "INDIVIDUAL"
stereo = camera.data.stereo
stereo.pivot = "CENTER"
stereo.convergence_mode, stereo.interocular_distance, stereo.convergence_distance = "OFFAXIS", 0.065, 1.2
render(folder / "eye.png")
eyes = [load_png(folder / f"eye_{side}.png") for side in "LR"]
scene.render.use_multiview = False
place = camera.location.x
found = []
for eye, sign in zip(eyes, (-1, 1), strict=True):
    camera.location.x = place + sign * 0.065 / 2
    camera.data.shift_x = -sign * 0.5 * 0.065 / camera.data.sensor_width * camera.data.lens / 1.2
    bpy.context.view_layer.update()
    found.append(difference(eye, expected_png(expected(scene, full_camera(scene)))))
camera.location.x, camera.data.shift_x = place, 0.0
report(stereo=found, eyes_differ=difference(*eyes))

# Motion blur: the mean of the moments within the shutter time, of head, pose and camera.
rig = first.parent
for frame, x in ((1, 0.0), (5, 0.4)):
    rig.location.x = x
    rig.keyframe_insert("location", frame=frame)
    first["jawOpen"] = 2.0 * x
    first.keyframe_insert('["jawOpen"]', frame=frame)
settings = scene.render
settings.use_motion_blur, settings.motion_blur_shutter, settings.motion_blur_position = True, 0.5, "START"
scene.grmm_render.motion_steps = 2
scene.frame_set(2)
blurred = load_png(render(folder / "blurred.png"))
moments = []
for subframe in (0.125, 0.375):
    scene.frame_set(2, subframe=subframe)
    buffers = expected(scene, full_camera(scene))
    moments.append(color.scene_linear_premultiplied(buffers["rgb"], buffers["alpha"]))
mean = np.mean(moments, axis=0)
straight = mean[..., :3] / np.maximum(mean[..., 3:], 1e-6)
wanted = np.concatenate([color.linear_to_srgb(straight), mean[..., 3:]], -1) * 255
scene.frame_set(2)
settings.use_motion_blur = False
sharp = load_png(render(folder / "sharp.png"))
strong = np.where(wanted[..., 3:] > 32, 1.0, 0.0)  # faint pixels store coarse colors
report(
    blur=float((np.abs(blurred - wanted) * strong).max()),
    blur_differs=difference(sharp, blurred),
    frame_after_blur=scene.frame_current,
)
rig.animation_data_clear()
first.animation_data_clear()
rig.location.x, first["jawOpen"] = 0.0, 0.0

# Inside the head, and looking away from it.
camera.location = (0.0, 0.0, 0.0)
bpy.context.view_layer.update()
inside = load_png(render(folder / "inside.png"))
wanted = expected_png(expected(scene, full_camera(scene)))
report(inside=float(np.abs(inside[..., 3] - wanted[..., 3]).max()), inside_covered=float((inside[..., 3] > 127).mean()))
camera.location = (0.0, 3.0, 0.0)
bpy.context.view_layer.update()
report(away=float(load_png(render(folder / "away.png"))[..., 3].max()))

# Hidden in renders, in the viewport only, and by its collection.
camera.location = (0.17, -1.1, 0.02)
second.hide_render = True
bpy.context.view_layer.update()
report(one_hidden=difference(load_png(render(folder / "hidden.png")), only(first)))
second.hide_render = False
second.hide_viewport = True
bpy.context.view_layer.update()
report(viewport_hidden=difference(load_png(render(folder / "viewport_hidden.png")), both))
second.hide_viewport = False
collections[1].hide_render = True
report(collection_hidden=difference(load_png(render(folder / "collection.png")), only(first)))
