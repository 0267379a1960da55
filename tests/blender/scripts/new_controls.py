"""Controls that this extension has and the one that saved a file had not: new_controls.py FILE.

The test has added the expression `visemeMM`, and the slider `light.gloss` in a section of its own.
"""

from __future__ import annotations

import sys

import bpy
from panel_recorder import draw_all
from rig_support import core_mesh, fresh_head, largest, mesh_of, update, without_detail
from support import module, report

Avatar = module("grmm_blender.rig.avatar").Avatar
read_identity, gain_of = module("grmm_blender.rig.identity").read_identity, module("grmm_blender.rig.mesh").gain_of
arkit_gain, open_head = module("grmm_core.head").arkit_gain, module("grmm_core.head").load_open_head()
CLOSING = [open_head.expression_index(name) for name in module("grmm_core.head.closing").CLOSING]
NEW = ("visemeMM", "light.gloss")


def state(avatar) -> dict:
    """What has to hold of a head, whenever it was made."""
    head = avatar.object
    present, limits = [name in head for name in NEW], head.id_properties_ui("light.gloss").as_dict()
    before, person = mesh_of(avatar), read_identity(avatar.source)
    keys = [avatar.controls().key()]
    head["visemeMM"], head["jawOpen"], head["eyeBlinkLeft"] = 0.7, 0.3, 0.8
    update(avatar)
    keys.append(avatar.controls().key())
    head["light.gloss"] = 0.75
    update(avatar)
    keys.append(avatar.controls().key())
    return {
        "present": present,
        "limits": [limits["min"], limits["max"], limits["soft_max"], limits["default"]],
        "gains": [gain[CLOSING].tolist() for gain in (gain_of(head, open_head), arkit_gain(open_head, person.shape))],
        "moved": largest(mesh_of(avatar) - before),
        "parity": largest(mesh_of(avatar) - core_mesh(avatar)),
        "frames": len(set(keys)),
        "gloss": avatar.controls().light_gloss,
        "valid": all(curve.driver.is_valid for curve in head.data.shape_keys.animation_data.drivers),
    }


def reset(head) -> list[float]:
    bpy.ops.grmm.reset(what="LIGHT")
    found = [round(head[name], 4) for name in NEW]
    bpy.ops.grmm.reset(what="EXPRESSION", region="Mixtures")
    return [*found, round(head["visemeMM"], 4)]


def animated(avatar) -> list[float]:
    for frame, value in ((1, 0.0), (11, 1.0)):
        avatar.object["light.gloss"] = value
        avatar.object.keyframe_insert('["light.gloss"]', frame=frame)
    values = []
    for frame in (1, 6, 11):
        bpy.context.scene.frame_set(frame)
        values.append(round(float(avatar.controls().light_gloss), 3))
    return values


bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
old = Avatar(bpy.data.objects["old head"])
old_values = [round(old.object[name], 4) for name in ("jawOpen", "visemeAA")]
report(old=state(old), old_values=old_values)

avatar = without_detail(fresh_head())
head = avatar.object
report(new=state(avatar), reset=reset(head))
drawn = draw_all()
rows = dict(zip([path for path in drawn["properties"] if path.endswith('"]')], drawn["names"], strict=True))
report(rows={name: rows.get(f'["{name}"]') for name in NEW}, panels=drawn["panels"])
bpy.ops.grmm.random_expression(seed=1, region="Mixtures", share=1.0, amount=0.5)
report(random=head["visemeMM"])
bpy.ops.grmm.create_pose_library(thumbnails=False)
bpy.ops.grmm.reset()
bpy.ops.grmm.apply_pose(pose="Viseme MM", amount=0.5)
report(posed=head["visemeMM"], defines=len(module("grmm_blender.preset_menus").GRMM_OT_expression_preset_add.preset_values))
report(animated=animated(avatar))
