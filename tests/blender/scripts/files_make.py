"""Save a file with an animated head: files_make.py WEIGHTS FOLDER. Leaves head.blend, person.grmm, meshes.npz, saved.png."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import add_camera, exact_colors, render, use_weights
from rig_support import core_mesh, mesh_of, randomise, update
from support import empty_scene, module, report

FRAMES = (1, 7, 13)
weights, folder = sys.argv[1], Path(sys.argv[2])

scene = empty_scene()
use_weights(weights)
host = module("grmm_blender.session_host")
host.get_session().save(host.open_avatar("sample:4").id, folder / "person.grmm")
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "head.blend"))
bpy.ops.grmm.add_head(person="FILE", filepath=str(folder / "person.grmm"))
avatar = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
generator = np.random.default_rng(11)
shape = generator.normal(size=len(avatar.object["shape"])).tolist()
for frame in FRAMES:
    randomise(avatar, generator)
    avatar.object["shape"] = shape
    update(avatar)
    for name in ("jawOpen", "laugh", "eyeLookInLeft"):
        avatar.object.keyframe_insert(f'["{name}"]', frame=frame)
    for name in ("expression", "z_exp"):
        avatar.object.keyframe_insert(f'["{name}"]', frame=frame)
    avatar.armature.pose.bones["neck"].keyframe_insert("rotation_euler", frame=frame)
meshes = {}
for frame in FRAMES:
    scene.frame_set(frame)
    meshes[f"frame{frame}"] = mesh_of(avatar)
# what a file shows where nothing keeps the learned detail up to date: that of the frame it was saved on
detail = host.get_session().deform(host.open_avatar(avatar.source).id, avatar.controls()).displacement
for frame in FRAMES:
    scene.frame_set(frame)
    meshes[f"native{frame}"] = core_mesh(avatar, displacement=detail)
np.savez(folder / "meshes.npz", **meshes)
scene.frame_set(FRAMES[-1])
scene.render.engine = "GRMM"
scene.render.film_transparent = True
scene.render.resolution_x, scene.render.resolution_y = 96, 80
exact_colors(scene)
add_camera(scene)
render(folder / "saved.png")
bpy.ops.wm.save_mainfile()
report(stored=avatar.object.grmm.source, source=avatar.source)
