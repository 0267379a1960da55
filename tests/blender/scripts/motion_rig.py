"""Face bones, Look At, blinking and breathing on heads without a model: motion_rig.py FOLDER."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from rig_support import core_mesh, fresh_head, largest, mesh_of, new_head, update, without_detail
from support import module, report

FEATURES = module("grmm_blender.motion.features").FEATURES
FACE_BONES = module("grmm_blender.motion.face_bones").FACE_BONES
NAMES = module("grmm_core.controls.names").EXPRESSION_NAMES
Avatar = module("grmm_blender.rig.avatar").Avatar
left_rigs = module("grmm_blender.rig.left_rigs")
folder = Path(sys.argv[1])


def weight(avatar, name: str) -> float:
    return round(float(avatar.controls().aligned[NAMES.index(name)]), 4)


def degrees(avatar) -> list:
    return np.degrees(avatar.controls().pose).round(2).tolist()


def act(operator: str, feature: str, avatar) -> None:
    bpy.context.view_layer.objects.active = avatar.armature
    assert getattr(bpy.ops.grmm, operator)(feature=feature) == {"FINISHED"}
    update(avatar)


def data_state(avatar) -> dict:
    """Everything that a feature might leave behind on a head."""
    head, rig = avatar.object, avatar.armature

    def drivers(owner) -> list:
        data = owner.animation_data
        return sorted(
            (c.data_path, c.array_index, c.driver.type, len(c.modifiers), [v.targets[0].data_path for v in c.driver.variables])
            for c in (data.drivers if data is not None else ())
        )

    tracks = [t.name for o in (head, rig) if o.animation_data for t in o.animation_data.nla_tracks]
    return {
        "bones": sorted(b.name for b in rig.data.bones),
        "collections": [c.name for c in rig.data.collections_all],
        "constraints": [(b.name, [c.name for c in b.constraints]) for b in rig.pose.bones],
        "drivers": [drivers(owner) for owner in (head, head.data.shape_keys, rig)],
        "properties": sorted(k for k in head.keys() if not k.startswith("grmm")),  # noqa: SIM118
        "tracks": tracks,
        "data": sorted(
            [*(o.name for o in bpy.data.objects), *(a.name for a in bpy.data.actions), *(m.name for m in bpy.data.meshes)]
        ),
    }


def everything_adds_and_goes(avatar) -> dict:
    before, mesh = data_state(avatar), mesh_of(avatar)
    for feature in FEATURES:
        act("add_motion", feature, avatar)
    rest = largest(mesh_of(avatar) - mesh) if bpy.context.scene.frame_current == 1 else None
    added = sorted(set(avatar.object.keys()) - set(before["properties"]))
    for feature in FEATURES:
        act("remove_motion", feature, avatar)
    after = data_state(avatar)
    return {
        "same": {key: after[key] == value for key, value in before.items()},
        "rest": rest,
        "mesh": largest(mesh_of(avatar) - mesh),
        "added": added,
    }


def face_bones(avatar) -> dict:
    act("add_motion", "control", avatar)
    rig, head = avatar.armature, avatar.object
    found = {}
    for bone in FACE_BONES:
        for axis, travel, names in bone.drives:
            rig.pose.bones[bone.name].location[axis] = travel / 2
            update(avatar)
            moved = {
                name: round(float(w), 3) for name, w in zip(NAMES, avatar.controls().aligned, strict=True) if abs(w) > 1e-4
            }
            found[f"{bone.name}.{'xyz'[axis]}{'+' if travel > 0 else '-'}"] = [moved == dict.fromkeys(names, 0.5), moved]
            rig.pose.bones[bone.name].location[axis] = 0.0
    lid = rig.pose.bones["lid_upper.L"]
    head["eyeBlinkLeft"], lid.location = 0.3, (0.0, -0.003, 0.0)
    head["jawOpen"], rig.pose.bones["chin"].location = 0.2, (0.0, -0.006, 0.0)
    update(avatar)
    sums = [weight(avatar, "eyeBlinkLeft"), weight(avatar, "jawOpen"), round(head["eyeBlinkLeft"], 3)]
    parity = largest(mesh_of(avatar) - core_mesh(avatar))
    lid.location = (0.0, -1.0, 0.0)
    update(avatar)
    beyond = weight(avatar, "eyeBlinkLeft")
    lid.location = (0.0, -0.006, 0.0)
    bpy.ops.grmm.mirror(direction="SWAP")
    swapped = [list(rig.pose.bones[name].location) for name in ("lid_upper.L", "lid_upper.R")]
    bpy.ops.grmm.reset(what="EXPRESSION")
    reset = [largest(np.array([bone.location for bone in rig.pose.bones])), weight(avatar, "eyeBlinkRight")]
    head["eyeBlinkLeft"] = 0.3
    # keys on either
    lid.keyframe_insert("location", frame=1)
    head.keyframe_insert('["eyeBlinkLeft"]', frame=1)
    lid.location, head["eyeBlinkLeft"] = (0.0, -0.006, 0.0), 0.1
    lid.keyframe_insert("location", frame=11)
    head.keyframe_insert('["eyeBlinkLeft"]', frame=11)
    keyed = []
    for frame in (1, 6, 11):
        bpy.context.scene.frame_set(frame)
        keyed.append(weight(avatar, "eyeBlinkLeft"))
    bpy.context.scene.frame_set(1)
    act("remove_motion", "control", avatar)
    bpy.context.scene.frame_set(11)
    left = [weight(avatar, "eyeBlinkLeft"), [c.data_path for c in module("grmm_blender.rig.actions").action_curves(rig)]]
    for owner in (head, rig):
        if owner.animation_data:
            owner.animation_data.action = None
    head["eyeBlinkLeft"] = head["jawOpen"] = 0.0
    bpy.context.scene.frame_set(1)
    return {"bones": found, "sums": sums, "parity": parity, "beyond": beyond, "keyed": keyed, "left": left, "swapped": swapped,
        "reset": reset}  # fmt: skip


def gaze(avatar, place: Vector, influence: float = 1.0) -> list:
    """Where an avatar looks at a place: angles, and degrees between the line of sight of each eye and the target."""
    target = avatar.object.grmm_motion.look_at
    target.location = place
    avatar.object["look_at"] = influence
    update(avatar)
    target.update_tag()
    bpy.context.view_layer.update()
    rig = avatar.armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    off = []
    for eye in ("left_eye", "right_eye"):
        matrix = rig.matrix_world @ rig.pose.bones[eye].matrix
        off.append(math.degrees(matrix.to_3x3().col[2].angle(place - matrix.translation)))
    return [degrees(avatar), np.round(off, 2).tolist(), weight(avatar, "eyeBlinkLeft")]


def look_at(avatar) -> dict:
    act("add_motion", "look", avatar)
    rig, head = avatar.armature, avatar.object
    rig.location, rig.rotation_euler = (1.0, 2.0, 0.5), (0.0, 0.0, 0.4)
    update(avatar)
    ahead = (
        avatar.model_to_world()
        @ np.array([[0.0, 0.036, 1.0, 1.0], [0.3, 0.1, 0.7, 1.0], [0.0, 0.6, -1.0, 1.0], [0.0, -0.4, 0.6, 1.0]]).T
    )
    places = [Vector(row[:3]) for row in ahead.T]
    found = {"straight": gaze(avatar, places[0]), "side": gaze(avatar, places[1]), "behind": gaze(avatar, places[2])}
    found["down"], found["off"] = gaze(avatar, places[3]), gaze(avatar, places[1], 0.0)
    found["half"] = gaze(avatar, places[1], 0.5)
    side = gaze(avatar, places[1])
    parity = largest(mesh_of(avatar) - core_mesh(avatar))
    rig.pose.bones["left_eye"].rotation_euler = (0.0, 0.1, 0.0)
    head["eyeLookUpLeft"] = 0.5
    update(avatar)
    nudged = np.subtract(degrees(avatar)[3], side[0][3]).round(2).tolist()
    both = largest(mesh_of(avatar) - core_mesh(avatar))
    rig.pose.bones["left_eye"].rotation_euler = (0.0, 0.0, 0.0)
    head["eyeLookUpLeft"] = 0.0
    # influence takes keys
    for frame, value in ((1, 0.0), (11, 1.0)):
        head["look_at"] = value
        head.keyframe_insert('["look_at"]', frame=frame)
    keyed = []
    for frame in (1, 11):
        bpy.context.scene.frame_set(frame)
        keyed.append(degrees(avatar)[1][1])
    bpy.data.objects.remove(head.grmm_motion.look_at)
    update(avatar)
    lost = [head.grmm_motion.look_at is None, degrees(avatar)]
    act("remove_motion", "look", avatar)
    head.animation_data.action = None
    rig.location, rig.rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    bpy.context.scene.frame_set(1)
    return {**found, "parity": parity, "both": both, "nudged": nudged, "keyed": keyed, "lost": lost}


def curve(avatar, value, frames=range(90, 126)) -> list:
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(value())
    return found


def breathing(avatar) -> list[float]:
    return [degrees(avatar)[1][0], float(avatar.model_to_world()[2, 3]), weight(avatar, "noseSneerLeft")]


def idle(avatar) -> dict:
    head, scene = avatar.object, bpy.context.scene
    for feature in ("blink", "breath"):
        act("add_motion", feature, avatar)

    def blink() -> float:
        return weight(avatar, "eyeBlinkLeft")

    first = curve(avatar, blink)
    head.grmm_motion.seed = 2
    other = curve(avatar, blink)
    head.grmm_motion.seed = 1
    again = curve(avatar, blink)
    actions = len(bpy.data.actions)
    head.grmm_motion.blink_strength = 0.5
    half = curve(avatar, blink)
    head.grmm_motion.blink_strength = 1.0
    # over keys, in an action of the animator's
    for frame, value in ((1, 0.2), (240, 0.2)):
        head["eyeBlinkLeft"] = value
        head.keyframe_insert('["eyeBlinkLeft"]', frame=frame)
    keyed = curve(avatar, blink)
    scene.frame_set(90 + first.index(max(first)))
    lifted = mesh_of(avatar) - [0.0, avatar.model_to_world()[2, 3], 0.0]
    parity = largest(lifted - core_mesh(avatar))
    head["eyeBlinkLeft"] = 0.2
    late = scene.frame_end + 19 * 60 * scene.render.fps
    far = max(curve(avatar, blink, range(late, late + 240, 2)))
    breath = np.array(curve(avatar, lambda: breathing(avatar), range(1, 121, 2)))
    mesh = mesh_at(avatar, 60)
    act("bake_motion", "breath", avatar)
    act("bake_motion", "blink", avatar)
    baked = curve(avatar, blink)
    head_curves = sorted(c.data_path for c in module("grmm_blender.rig.actions").action_curves(head))
    after = data_state(avatar)
    result = {
        "first": first, "other": other == first, "again": again == first, "half": max(half), "keyed": [min(keyed), max(keyed)],
        "parity": parity, "far": far, "breath": np.ptp(breath, 0).tolist(), "actions": actions,
        "baked": float(np.abs(np.subtract(baked, keyed)).max()), "mesh": largest(mesh_at(avatar, 60) - mesh),
        "curves": head_curves, "tracks": after["tracks"], "layers": [p for p in after["properties"] if "." in p],
    }  # fmt: skip
    return result


def mesh_at(avatar, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    return mesh_of(avatar)


def several() -> dict:
    """Two heads that look at each other, a duplicate, a saved file, a deleted head."""
    first = without_detail(fresh_head())
    for feature in FEATURES:
        act("add_motion", feature, first)
    second = without_detail(new_head())
    second.armature.location = (1.0, 0.0, 0.0)
    act("add_motion", "look", second)
    second.object.grmm_motion.look_at = first.object
    first.object.grmm_motion.look_at = second.armature
    for avatar in (first, second):
        update(avatar)
    bones = [a.armature.pose.bones["MCH-gaze"].constraints[0].subtarget for a in (first, second)]
    mutual = [degrees(first)[1][1] + degrees(first)[3][1], degrees(second)[1][1] + degrees(second)[3][1]]
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    for obj in (first.object, first.armature):
        obj.select_set(True)
    bpy.context.view_layer.objects.active = first.armature
    bpy.ops.object.duplicate(linked=False)
    third = Avatar(next(o for o in bpy.context.selected_objects if o.type == "MESH"))
    third.armature.pose.bones["lid_upper.L"].location[1] = -0.006
    third.object.grmm_motion.seed = 5
    update(third)
    apart = [weight(first, "eyeBlinkLeft"), weight(third, "eyeBlinkLeft")]
    blinks = [[round(sum(curve(a, lambda a=a: weight(a, "eyeBlinkRight"))), 2)] for a in (first, third)]
    bpy.context.scene.frame_set(30)
    before = mesh_of(third)
    path = str(folder / "several.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    heads = {o.name: Avatar(o) for o in bpy.data.objects if o.type == "MESH" and o.grmm.is_avatar}
    reopened = min(largest(mesh_of(avatar) - before) for avatar in heads.values())
    return {
        "bones": bones, "mutual": mutual, "apart": apart, "blinks": blinks, "reopened": reopened, "deleted": deleted(heads)
    }  # fmt: skip


def deleted(heads: dict) -> list:
    """What is left after one head after another was deleted."""
    watcher = left_rigs.LeftRigs()
    watcher.notice_deleted()
    found = []
    for name in sorted(heads):
        bpy.data.objects.remove(bpy.data.objects[name])
        assert watcher.notice_deleted()
        watcher.remove()
        found.append([sorted(o.type for o in bpy.data.objects), len(bpy.data.actions), len(bpy.data.armatures)])
    return [*found, len(bpy.data.meshes)]


avatar = without_detail(fresh_head())
bpy.context.scene.frame_end = 240
report(round=everything_adds_and_goes(avatar))
report(face=face_bones(avatar))
report(look=look_at(avatar))
report(idle=idle(avatar))
report(several=several())
