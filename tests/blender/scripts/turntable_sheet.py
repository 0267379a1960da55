"""Turntable and contact sheets: turntable_sheet.py WEIGHTS FOLDER."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import exact_colors, load_png
from rig_support import fresh_head
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
avatar = fresh_head(weights)
scene = bpy.context.scene
exact_colors(scene)
scene.render.resolution_x, scene.render.resolution_y = 64, 48
rig = avatar.armature
rig.location, rig.rotation_euler, rig.scale = (1.0, 2.0, 0.5), (0.0, 0.0, 0.7), (2.0, 2.0, 2.0)
bpy.context.view_layer.update()
report(done=bpy.ops.grmm.turntable(frames=8, start=3, elevation=0.0) == {"FINISHED"})
count = len(scene.objects)
bpy.ops.grmm.turntable(frames=8, start=3, elevation=0.0)
report(again=len(scene.objects) == count, range=[scene.frame_start, scene.frame_end])


def seen() -> tuple[float, float, float]:
    """Direction of the camera in head space as an angle about the head's axis, distance, and how far it looks past the head."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    to_world = avatar.model_to_world(depsgraph)
    camera = np.array(scene.camera.evaluated_get(depsgraph).matrix_world)
    local = np.linalg.inv(to_world) @ camera
    ray, offset = -local[:3, 2] / np.linalg.norm(local[:3, 2]), local[:3, 3]
    past = np.linalg.norm(np.cross(ray, offset - np.array([0.0, -0.01, 0.0])))
    return math.degrees(math.atan2(offset[0], offset[2])), float(np.linalg.norm(offset)), float(past)


angles, distances, past = [], [], []
for frame in range(3, 11):
    scene.frame_set(frame)
    angle, distance, miss = seen()
    angles.append(angle % 360)
    distances.append(distance)
    past.append(miss)
report(angles=angles, distances=distances, past=max(past))

# A performance keeps its range and its camera, unless something else is asked for.
avatar.object["jawOpen"] = 0.0
avatar.object.keyframe_insert('["jawOpen"]', frame=1)
own = bpy.data.objects.new("Own", bpy.data.cameras.new("Own"))
scene.collection.objects.link(own)
turning = scene.camera
scene.camera, scene.frame_start, scene.frame_end = own, 11, 30
bpy.ops.grmm.turntable()
keys = [
    key.co[0] for curve in module("grmm_blender.rig.actions").action_curves(turning.parent) for key in curve.keyframe_points
]
kept = [scene.camera.name, scene.frame_start, scene.frame_end, keys]
bpy.ops.grmm.turntable(frames=8, start=3, elevation=0.0, set_range=True, set_camera=True)
report(kept=kept, asked=[scene.camera == turning, scene.frame_start, scene.frame_end])
avatar.object.animation_data_clear()
avatar.object["jawOpen"] = 0.0

scene.frame_set(5)
bpy.ops.grmm.contact_sheet(filepath=str(folder / "jaw.png"), region="Jaw", size=32, columns=3)
jaw = load_png(folder / "jaw.png")
bpy.ops.grmm.contact_sheet(filepath=str(folder / "plain"), region="Jaw", size=32, columns=3, captions=False)
plain = load_png(folder / "plain.png")
report(
    jaw=list(jaw.shape), plain=list(plain.shape),
    ink=float(jaw[:18, :, :3].min()), blank=float(jaw[18 + 32 + 18 :, 32 * 2 :, :3].min()),
    differ=float(np.abs(plain[:32, :32] - plain[:32, 64:96]).max()),
    background=plain[0, 0, :3].tolist(),
)  # fmt: skip
bpy.ops.grmm.contact_sheet(filepath=str(folder / "views.png"), content="VIEWS", count=4, columns=2, size=32, captions=False)
bpy.ops.grmm.contact_sheet(filepath=str(folder / "frames.png"), content="FRAMES", count=4, columns=4, size=64, captions=False)
frames = load_png(folder / "frames.png")
scene.render.engine = "GRMM"
scene.render.film_transparent = True
scene.frame_set(3)
scene.render.filepath = str(folder / "frame.png")
bpy.ops.render.render(write_still=True)
one = load_png(folder / "frame.png")
alpha = one[..., 3:] / 255
report(
    views=list(load_png(folder / "views.png").shape), frames=list(frames.shape), frame=scene.frame_current,
    same=float(np.abs(frames[:, :64, :3] - (one[..., :3] * alpha + (1 - alpha) * 0.94 * 255)).max()),
    covered=float(alpha.mean()),
)  # fmt: skip
messages = []
for path, size in (("", 32), (folder / "no" / "x.png", 32), (folder / "x.png", 4096)):
    try:
        bpy.ops.grmm.contact_sheet(filepath=str(path), size=size)
        messages.append("")
    except RuntimeError as error:
        messages.append(str(error))
report(messages=messages, left=[p.name for p in folder.glob("x*")])
# A model that fails leaves the scene on its frame and no file.
scene.frame_set(6)
avatar.object.grmm.source = str(folder / "gone.grmm")
try:
    bpy.ops.grmm.contact_sheet(filepath=str(folder / "x.png"), content="FRAMES", count=3, size=16)
    failed = ""
except RuntimeError as error:
    failed = str(error)
report(failed=failed, frame_kept=scene.frame_current, none=not (folder / "x.png").exists())
module("grmm_blender.session_host").shutdown()
