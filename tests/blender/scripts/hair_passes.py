"""The hair pass of combed curves: whole, a border of it, behind a holdout, blurred: hair_passes.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from render_support import heads, new_scene
from support import report, set_multilayer_exr

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
scene.camera.location.x = scene.camera.rotation_euler.z = 0.0
head = heads(scene)[0]
head.grmm.hair.groom = "bob"
bpy.ops.grmm.hair_as_curves(sculpt=False)
layer = scene.view_layers[0]
layer.grmm_passes.use_hair = layer.grmm_passes.use_mask = True
set_multilayer_exr(scene.render.image_settings)
scene.render.image_settings.exr_codec = "NONE"


def shot(name: str) -> None:
    scene.render.filepath = str(folder / f"{name}.exr")
    bpy.ops.render.render(write_still=True)


shot("whole")
scene.render.use_border = scene.render.use_crop_to_border = True
scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.75
scene.render.border_min_y, scene.render.border_max_y = 0.25, 0.75
shot("border")
scene.render.use_border = False
mesh = bpy.data.meshes.new("Wall")
mesh.from_pydata([(-5, -0.5, -2), (0, -0.5, -2), (0, -0.5, 2), (-5, -0.5, 2)], [], [(0, 1, 2, 3)])
wall = bpy.data.objects.new("Wall", mesh)
scene.collection.objects.link(wall)
wall.is_holdout = True
shot("holdout")
bpy.data.objects.remove(wall)
bone = head.parent.pose.bones["neck"]
for frame, angle in ((1, 0.0), (3, 0.8)):
    bone.rotation_euler.y = angle
    bone.keyframe_insert("rotation_euler", frame=frame)
scene.frame_set(2)
shot("turned")
scene.render.use_motion_blur, scene.render.motion_blur_shutter, scene.grmm_render.motion_steps = True, 1.0, 3
shot("blurred")
report(layer=layer.name)
