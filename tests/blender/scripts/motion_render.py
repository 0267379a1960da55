"""What moves a head beside its sliders is rendered, and undone: motion_render.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from rig_support import fresh_head, largest, mesh_of, model_mesh, update
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
Avatar = module("grmm_blender.rig.avatar").Avatar


def picture(name: str) -> np.ndarray:
    """Render the present frame with the engine, [N]."""
    scene = bpy.context.scene
    scene.render.filepath = str(folder / name)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(folder / f"{name}.png"))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels


avatar = fresh_head(weights)
scene = bpy.context.scene
scene.render.engine = "GRMM"
scene.render.resolution_x = scene.render.resolution_y = 96
scene.render.image_settings.file_format = "PNG"
bpy.ops.grmm.portrait_camera()
rest = picture("rest")
bpy.ops.ed.undo_push(message="before")
bpy.context.view_layer.objects.active = avatar.armature
bpy.ops.object.mode_set(mode="POSE")
bpy.ops.grmm.add_motion(feature="control")
mode = bpy.context.mode
bpy.ops.object.mode_set(mode="OBJECT")
chin = avatar.armature.pose.bones["chin"]
chin.location[1] = 0.0
chin.keyframe_insert("location", frame=1)
chin.location[1] = -0.03
chin.keyframe_insert("location", frame=11)
bpy.ops.grmm.add_motion(feature="blink")
avatar.object.grmm_motion.blink_rate = 60.0
bpy.ops.ed.undo_push(message="after")
scene.frame_set(1)
scene.frame_set(11)
parity = largest(mesh_of(avatar) - model_mesh(avatar))
by_bones = picture("bones")
shown = dict(zip(module("grmm_core.controls.names").EXPRESSION_NAMES, avatar.controls().aligned.tolist(), strict=True))
for feature in ("control", "blink"):
    bpy.ops.grmm.remove_motion(feature=feature)
for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight"):
    avatar.object[name] = shown[name]
update(avatar)
by_sliders = picture("sliders")
name = avatar.object.name
bpy.ops.ed.undo_push(message="removed")
bpy.ops.ed.undo()
bpy.ops.ed.undo()
again = Avatar(bpy.data.objects[name])
bones = len(again.armature.data.bones)
tracks = len(again.object.animation_data.nla_tracks) if again.object.animation_data else 0
scene = bpy.context.scene
scene.frame_set(1)
undone = picture("undone")
report(
    moved=largest(by_bones - rest), same=largest(by_bones - by_sliders), parity=parity, jaw=shown["jawOpen"], mode=mode,
    bones=bones, tracks=tracks, undone=largest(undone - rest),
)  # fmt: skip
