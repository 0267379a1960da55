"""The evaluated mesh against the core for the same controls: rig_parity.py WEIGHTS."""

from __future__ import annotations

import sys

import bpy
import numpy as np
from rig_support import core_mesh, each_alone, fresh_head, largest, mesh_of, model_mesh, randomise, update, without_detail
from support import module, report

generator = np.random.default_rng(7)
weights = sys.argv[1]


def keyframe_everything(avatar) -> None:
    """Key every control at three frames."""
    for frame in (1, 11, 21):
        randomise(avatar, generator)
        for name in module("grmm_core.controls.names").ALIGNED_NAMES:
            avatar.object.keyframe_insert(f'["{name}"]', frame=frame)
        for name in ("shape", "expression", "z_id", "z_exp"):
            avatar.object.keyframe_insert(f'["{name}"]', frame=frame)
        for bone in ("root", "neck", "jaw", "left_eye", "right_eye"):
            avatar.armature.pose.bones[bone].keyframe_insert("rotation_euler", frame=frame)


avatar = fresh_head(weights)
report(model=[], head=[], frames=[], controls=[], moved=0.0)
results = {"rest": largest(mesh_of(avatar) - model_mesh(avatar)), "model": [], "head": [], "frames": [], "controls": []}

for _ in range(4):
    randomise(avatar, generator)
    results["model"].append(largest(mesh_of(avatar) - model_mesh(avatar)))
without_detail(avatar)
for _ in range(4):
    randomise(avatar, generator)
    angles = [avatar.armature.pose.bones[n].rotation_euler[:] for n in ("root", "neck", "jaw", "left_eye", "right_eye")]
    results["controls"].append(largest(avatar.controls().pose - np.array(angles)))
    results["head"].append(largest(mesh_of(avatar) - core_mesh(avatar)))

# each component by itself, at a large value: a wrong key or weight cannot hide among the others
for name in ("shape", "expression"):
    avatar.object[name] = [0.0] * len(avatar.object[name])
for name in module("grmm_core.controls.names").ALIGNED_NAMES:
    avatar.object[name] = 0.0
neutral = mesh_of(avatar)
single = each_alone(avatar, ("jawOpen", "eyeLookInLeft", "scream", "tongueOut"))
for name, index in (("shape", 0), ("shape", 49), ("shape", 50), ("shape", 299), ("expression", 24), ("expression", 99)):
    avatar.object[name][index] = 3.0
    update(avatar)
    single[f"{name}.{index}"] = [largest(mesh_of(avatar) - core_mesh(avatar)), largest(mesh_of(avatar) - neutral)]
    avatar.object[name][index] = 0.0
results["single"] = single

avatar.object.grmm.live_detail = True
keyframe_everything(avatar)
for frame, fraction in ((21, 0.0), (1, 0.0), (6, 0.25), (16, 0.0), (6, 0.25)):
    bpy.context.scene.frame_set(frame, subframe=fraction)
    results["frames"].append(largest(mesh_of(avatar) - model_mesh(avatar)))

# placed in the world: armature moved, turned, scaled; root bone moved
rig = avatar.armature
rig.location, rig.rotation_euler, rig.scale = (0.5, -1.0, 2.0), (0.3, -0.2, 1.1), (2.0, 2.0, 2.0)
rig.pose.bones["root"].location = (0.02, -0.01, 0.03)
update(avatar)
depsgraph = bpy.context.evaluated_depsgraph_get()
evaluated = avatar.object.evaluated_get(depsgraph)
matrix = np.array(evaluated.matrix_world)
flat = np.empty(len(evaluated.data.vertices) * 3, np.float32)
evaluated.data.attributes["position"].data.foreach_get("vector", flat)
world = flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
to_world = avatar.model_to_world(depsgraph)
results["moved"] = largest(world - (model_mesh(avatar) @ to_world[:3, :3].T + to_world[:3, 3]))
report(**results)
