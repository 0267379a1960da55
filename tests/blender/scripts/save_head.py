"""Save a file with a head whose sliders are set: save_head.py FILE."""

from __future__ import annotations

import sys

import bpy
from rig_support import fresh_head, without_detail

avatar = without_detail(fresh_head())
avatar.object.name = "old head"
avatar.object["jawOpen"], avatar.object["visemeAA"] = 0.25, 0.5
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
