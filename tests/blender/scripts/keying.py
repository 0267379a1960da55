"""The keying set of all controls, and the channel groups of keys that somebody sets: keying.py."""

from __future__ import annotations

import bpy
from rig_support import fresh_head, without_detail
from support import module, report

actions = module("grmm_blender.rig.actions")
avatar = without_detail(fresh_head())
head, rig, scene = avatar.object, avatar.armature, bpy.context.scene
names = {head.name: "head", rig.name: "rig"}


def groups() -> dict:
    found = {curve.data_path.split('"')[1]: curve.group for curve in actions.action_curves(head)}
    return {name: group and group.name for name, group in found.items()}


bpy.ops.grmm.select_controls()
compat = module("grmm_blender.compat")
bones = sorted(bone.name for bone in rig.pose.bones if compat.bone_state(bone)[1])
report(selected=[sorted(names[obj.name] for obj in bpy.context.selected_objects), bones, scene.keying_sets_all.active.bl_label])
report(paths=len(list(module("operators.keying").keyed_paths(avatar))))
window = bpy.context.window_manager.windows[0]
area = window.screen.areas[0]
area.type = "VIEW_3D"
with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
    bpy.ops.anim.keyframe_insert()
report(keyed=[len(list(actions.action_curves(obj))) for obj in (head, rig)], groups=sorted(set(groups().values())))
bpy.ops.grmm.add_motion(feature="control")
report(with_face_bones=len(list(module("operators.keying").keyed_paths(avatar))))
bpy.ops.grmm.remove_motion(feature="control")

head.animation_data_clear()
head["own"] = 0.5
for name in ("jawOpen", "noseSneerLeft", "own"):
    head.keyframe_insert(f'["{name}"]', frame=2)
bpy.context.view_layer.update()
report(by_hand=groups())

head.animation_data_clear()
scene.tool_settings.use_keyframe_insert_auto = True
head["mouthSmileLeft"] = 0.8
bpy.ops.grmm.reset(what="EXPRESSION", region="Mouth")
bpy.context.view_layer.update()
report(automatic={name: group for name, group in groups().items() if name == "mouthSmileLeft"})
