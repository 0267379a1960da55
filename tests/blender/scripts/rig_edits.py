"""Saved codes, random detail, neutral calibration, mirrored regions, keys of automatic keying: rig_edits.py."""

from __future__ import annotations

import bpy
import numpy as np
from rig_support import core_mesh, fresh_head, largest, mesh_of, randomise, update, without_detail
from support import module, report

actions = module("grmm_blender.rig.actions")
components = module("grmm_blender.rig.components")
codes = module("grmm_blender.rig.saved_codes")
ALIGNED = module("grmm_core.controls.names").ALIGNED_NAMES


def code() -> np.ndarray:
    update(avatar)
    return avatar.controls().z_exp


def saved_codes() -> dict:
    head = avatar.object
    generator = np.random.default_rng(0)
    first, second = (generator.normal(size=len(head["z_exp"])).astype(np.float32) for _ in range(2))
    head["z_exp"] = first.tolist()
    bpy.ops.grmm.save_code(code="z_exp", slot="A")
    only = largest(code() - first)
    head["z_exp"] = second.tolist()
    bpy.ops.grmm.save_code(code="z_exp", slot="B")
    result = {"only": only, "saved": largest(code() - second), "sliders": largest(np.array(head["z_exp"].to_list()))}
    head["z_exp_blend"] = 0.25
    result["blended"] = largest(code() - (0.75 * first + 0.25 * second))
    head["z_exp"][3] = 2.0
    result["added"] = float(code()[3] - (0.75 * first + 0.25 * second)[3])
    head["z_exp"][3] = 0.0
    for frame, value in ((1, 0.0), (11, 1.0)):
        head["z_exp_blend"] = value
        head.keyframe_insert('["z_exp_blend"]', frame=frame)
    bpy.context.scene.frame_set(6)
    result["animated"] = largest(avatar.controls().z_exp - (first + second) / 2)
    head.animation_data_clear()
    head["z_exp_blend"] = 0.25
    bpy.ops.grmm.apply_blend(code="z_exp")
    result["applied"] = largest(code() - (0.75 * first + 0.25 * second))
    result["left"] = list(codes.code_properties(head, "z_exp"))
    # the other code, and reset
    bpy.ops.grmm.random_identity(seed=3)
    person = np.array(head["z_id"].to_list())
    bpy.ops.grmm.save_code(code="z_id", slot="A")
    bpy.ops.grmm.save_code(code="z_id", slot="B")
    result["identity"] = largest(avatar.controls().z_id - person)
    bpy.ops.grmm.reset(what="ALL")
    result["after_reset"] = [list(codes.code_properties(head, "z_id")), largest(code()), largest(avatar.controls().z_id)]
    return result


def random_detail() -> dict:
    drawn = []
    for seed, amount in ((1, 1.0), (1, 1.0), (2, 1.0), (1, 0.5), (1, 0.0)):
        bpy.ops.grmm.random_detail(seed=seed, amount=amount)
        drawn.append(code())
    spread = np.array([c.spread for c in sorted(components.components("z_exp", drawn[0].size), key=lambda c: c.index)])
    return {
        "same": largest(drawn[0] - drawn[1]),
        "other": largest(drawn[0] - drawn[2]),
        "half": largest(drawn[0] - 2 * drawn[3]),
        "none": largest(drawn[4]),
        "spread": float(np.sqrt(((drawn[0] / spread) ** 2).mean())),
    }


def names() -> dict:
    found = {name: components.components(name, len(avatar.object[name])) for name in ("z_id", "z_exp")}
    return {
        "indices": {
            name: sorted(c.index for c in each) == list(range(len(avatar.object[name]))) for name, each in found.items()
        },
        "labels": {name: [c.label for c in each[:8]] for name, each in found.items()},
        "effects": [c.effect for c in found["z_id"]],
        "shape": components.shape_labels(module("grmm_core.head").load_open_head(), 8),
        "foreign": [c.label for c in components.components("z_exp", 7)],
    }


def calibrate() -> dict:
    head, rig = avatar.object, avatar.armature
    bpy.ops.grmm.reset(what="ALL")
    for frame, jaw, smile, neck in ((1, 0.2, 0.1, 0.1), (11, 0.6, 0.4, 0.3), (21, 1.0, 0.8, -0.2)):
        head["jawOpen"], head["mouthSmileLeft"] = jaw, smile
        head.keyframe_insert('["jawOpen"]', frame=frame)
        head.keyframe_insert('["mouthSmileLeft"]', frame=frame)
        rig.pose.bones["neck"].rotation_euler = (neck, 0.0, 0.0)
        rig.pose.bones["neck"].keyframe_insert("rotation_euler", frame=frame)
    head["cheekPuff"] = 0.3
    rig.pose.bones["jaw"].rotation_euler = (0.05, 0.0, 0.0)
    scene = bpy.context.scene

    def at(frame: int) -> list[float]:
        scene.frame_set(frame)
        controls = avatar.controls()
        values = {name: float(controls.aligned[ALIGNED.index(name)]) for name in ("jawOpen", "mouthSmileLeft", "cheekPuff")}
        return [round(v, 4) for v in (*values.values(), float(controls.pose[1, 0]), float(controls.pose[2, 0]))]

    scene.frame_set(1)
    bpy.ops.grmm.calibrate_neutral()
    result = {"rest": at(1), "last": at(21), "parity": largest(mesh_of(avatar) - core_mesh(avatar))}
    bpy.ops.grmm.calibrate_neutral(source="FRAMES", frames="11-21", rotation=False)
    result["frames"] = [at(1), at(21)]
    try:
        bpy.ops.grmm.calibrate_neutral(source="FRAMES", frames="soon")
        result["bad"] = ""
    except RuntimeError as error:
        result["bad"] = str(error)
    head.animation_data_clear()
    rig.animation_data_clear()
    return result


def regions() -> dict:
    """Mirror, reset and random of one region leave the others alone."""
    bpy.ops.grmm.reset(what="ALL")
    head = avatar.object
    head["mouthSmileLeft"], head["browDownLeft"], head["eyeBlinkRight"] = 0.7, 0.5, 0.4
    bpy.ops.grmm.mirror(direction="LEFT", region="Mouth")
    mirrored = [round(head[n], 3) for n in ("mouthSmileRight", "browDownRight", "eyeBlinkLeft")]
    bpy.ops.grmm.mirror(direction="SWAP", region="Eyelids")
    swapped = [round(head[n], 3) for n in ("eyeBlinkLeft", "eyeBlinkRight", "browDownLeft")]
    bpy.ops.grmm.random_expression(seed=4, region="Brows", amount=0.5, share=1.0)
    brows = [head[n] for n in module("grmm_core.controls.table").REGIONS["Brows"]]
    bpy.ops.grmm.reset(what="EXPRESSION", region="Mouth")
    return {
        "mirrored": mirrored,
        "swapped": swapped,
        "brows": [min(brows) >= 0.0, 0.0 < max(brows) <= 0.5],
        "kept": [round(head[n], 3) for n in ("mouthSmileLeft", "eyeBlinkLeft")],
    }


def automatic_keys() -> list[str]:
    bpy.ops.grmm.reset(what="ALL")
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = True
    bpy.ops.grmm.random_expression(seed=1, region="Tongue")
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = False
    found = sorted({curve.data_path for curve in actions.action_curves(avatar.object)})
    avatar.object.animation_data_clear()
    return found


def undone() -> dict:
    """A calibration and a saved code go back with undo, and come again with redo."""
    global avatar
    name = avatar.object.name
    bpy.ops.grmm.reset(what="ALL")
    randomise(avatar, np.random.default_rng(1))
    bpy.ops.ed.undo_push(message="posed")
    before = mesh_of(avatar)
    bpy.ops.grmm.save_code(slot="A")
    bpy.ops.grmm.calibrate_neutral()
    update(avatar)
    after = mesh_of(avatar)
    bpy.ops.ed.undo_push(message="edited")
    bpy.ops.ed.undo()
    avatar = module("grmm_blender.rig.avatar").Avatar(bpy.data.objects[name])
    update(avatar)
    result = {
        "moved": largest(after - before),
        "undone": largest(mesh_of(avatar) - before),
        "saved": "z_exp_a" in avatar.object,
    }
    bpy.ops.ed.redo()
    avatar = module("grmm_blender.rig.avatar").Avatar(bpy.data.objects[name])
    update(avatar)
    return result | {"redone": largest(mesh_of(avatar) - after), "again": "z_exp_a" in avatar.object}


avatar = without_detail(fresh_head())
report(codes=saved_codes())
report(detail=random_detail(), names=names())
report(neutral=calibrate())
report(regions=regions(), keys=automatic_keys())
report(undo=undone())
