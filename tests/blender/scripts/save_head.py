"""Save a file with a head whose sliders are set, as a version that knew sculpted shapes alone built it: save_head.py FILE."""

from __future__ import annotations

import sys

import bpy
from rig_support import fresh_head, without_detail
from support import module

avatar = without_detail(fresh_head())
avatar.object.name = "old head"
avatar.object["jawOpen"], avatar.object["visemeAA"] = 0.25, 0.5
drivers = module("grmm_blender.rig.drivers")
keys = avatar.object.data.shape_keys.key_blocks
for index, name in ((8, "eyeBlinkLeft"), (9, "eyeBlinkRight"), (26, "mouthClose")):
    keys[f"aligned.{name}"].driver_remove("value")
    avatar.object.shape_key_remove(keys[f"aligned.{name}"])
    drivers.drive_sum(keys[name], "value", -1, avatar.object, [f'["expression"][{index}]', f'["{name}"]'])
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
