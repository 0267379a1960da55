"""Large files: large_imports.py FOLDER. Reports CPU seconds, which do not depend on what else the machine does."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy
from rig_support import fresh_head, without_detail
from support import empty_scene, module, report

folder = Path(sys.argv[1])
splats = module("grmm_blender.splats")

for name in ("million.ply", "million.spz"):
    empty_scene()
    started = time.process_time()
    bpy.ops.grmm.import_splats(filepath=str(folder / name))
    taken = time.process_time() - started
    started = time.process_time()
    shot = splats.Cloud(bpy.context.object).shot(bpy.context.evaluated_depsgraph_get())
    report(**{name: {"import": taken, "copy": time.process_time() - started, "count": len(shot.arrays.means)}})

without_detail(fresh_head())
bpy.context.scene.render.fps = 30
for keys in ("FRAMES", "REDUCED"):
    started = time.process_time()
    bpy.ops.grmm.import_performance(filepath=str(folder / "long.json"), keys=keys, neutral="AUTO", smoothing=0.3)
    report(**{keys: {"import": time.process_time() - started, "end": bpy.context.scene.frame_end}})
