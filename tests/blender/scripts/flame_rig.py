"""The rig on a user's FLAME head: flame_rig.py FLAME_FILE."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from rig_support import core_mesh, each_alone, largest, mesh_of, update
from support import empty_scene, module, report

path = Path(sys.argv[1])
preferences = module("grmm_blender.preferences").get()
avatar_of, avatars_in = module("grmm_blender.rig.avatar").avatar_of, module("grmm_blender.scene.avatars").avatars_in
JOINTS = module("grmm_core.controls.names").JOINT_NAMES


def message_of(**options: object) -> str:
    try:
        bpy.ops.grmm.add_flame_head(**options)
    except RuntimeError as error:
        return str(error).strip().splitlines()[0]
    return ""


empty_scene()
report(none=message_of(), gone=message_of(filepath=str(path.with_name("gone.pkl"))))
preferences.flame = str(path)
bpy.ops.grmm.add_flame_head()
avatar = avatar_of(bpy.context.object)
head = module("grmm_blender.rig.identity").read_identity(avatar.source).head
report(
    source=avatar.source,
    counts=[len(avatar.object.data.vertices), head.vertex_count, len(avatar.object["expression"])],
    parts=[material["grmm_part"] for material in avatar.object.data.materials],
    codes=[name for name in ("z_id", "z_exp") if name in avatar.object],
    network=avatar.has_network,
    rest=largest(mesh_of(avatar) - core_mesh(avatar)),
    turning=[JOINTS[j] for j in module("grmm_blender.rig.armature").driven_joints(head)],
)
# the jaw is turned by ARKit's shapes, not by FLAME's own components
generator = np.random.default_rng(0)
neutral = mesh_of(avatar)
report(single=each_alone(avatar, ("jawOpen", "eyeLookInLeft", "scream", "mouthSmileLeft")))
everything = []
for _ in range(2):
    for name in module("grmm_core.controls.names").ALIGNED_NAMES:
        avatar.object[name] = float(generator.uniform(0.0, 0.4))
    avatar.object["expression"] = generator.uniform(-0.3, 0.3, len(avatar.object["expression"])).tolist()
    avatar.object["shape"] = generator.normal(size=len(avatar.object["shape"])).clip(-2, 2).tolist()
    for bone in JOINTS:
        avatar.armature.pose.bones[bone].rotation_euler = generator.uniform(-0.25, 0.25, 3)
    update(avatar)
    everything.append(largest(mesh_of(avatar) - core_mesh(avatar)))
report(everything=everything)
bpy.ops.grmm.random_identity(seed=1)
bpy.ops.grmm.mirror()
bpy.ops.grmm.reset()
update(avatar)
report(reset=largest(mesh_of(avatar) - neutral), detail_poll=bpy.ops.grmm.random_detail.poll())
walk = module("grmm_blender.scene.walk")
report(
    drawn=len(walk.walk(bpy.context.evaluated_depsgraph_get())),
    masks=[obj.name for obj in walk.drawn_objects(bpy.context.scene)],
)
