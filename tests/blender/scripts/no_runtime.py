"""What works where nothing can run the model: no_runtime.py PERFORMANCE."""

from __future__ import annotations

import sys

import bpy
import numpy as np
from rig_support import core_mesh, fresh_head, largest, mesh_of, randomise
from support import heavy_modules, module, report

host = module("grmm_blender.session_host")
avatar = fresh_head(painted=True)
randomise(avatar, np.random.default_rng(0))
report(
    available=host.runtime_status().available,
    message=host.runtime_status().message,
    sliders=largest(mesh_of(avatar) - core_mesh(avatar)),
    panel=module("grmm_blender.rig.live").state_of(avatar).message,
)


def message_of(call, *arguments: object, **options: object) -> str:
    try:
        call(*arguments, **options)
    except RuntimeError as error:
        return str(error).strip().splitlines()[0]
    return ""


avatar = fresh_head(painted=True)
bpy.ops.grmm.import_performance(filepath=sys.argv[1], start=1)
errors, meshes = [], []
for frame in (1, 40, 90, 60):
    bpy.context.scene.frame_set(frame)
    meshes.append(mesh_of(avatar))
    errors.append(largest(meshes[-1] - core_mesh(avatar)))
report(playback=errors, moved=largest(meshes[1] - meshes[0]))
bpy.ops.grmm.random_identity(seed=1)
bpy.ops.grmm.random_detail(seed=1)
bpy.ops.grmm.calibrate_neutral()
bpy.context.scene.frame_set(1)
report(edited=largest(mesh_of(avatar) - core_mesh(avatar)))
rested = mesh_of(fresh_head(painted=True))
message = message_of(bpy.ops.grmm.add_head, person="RANDOM", seed=2)
person = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
report(random_person=[message, largest(mesh_of(person) - core_mesh(person)), largest(mesh_of(person) - rested)])
report(plain=module("grmm_blender.rig.materials").is_plain(person.object.data))
report(parts=[material["grmm_part"] for material in person.object.data.materials])
bpy.context.scene.render.engine = "GRMM"
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
bpy.context.scene.collection.objects.link(camera)
bpy.context.scene.camera = camera
report(render=message_of(bpy.ops.render.render), heavy=heavy_modules())
