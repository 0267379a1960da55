"""One machine of a render farm: engine_farm.py WEIGHTS FOLDER make|render NAME FRAMES...

"make" first saves the file: Placeholders, no Overwrite. Both load it, set the output to FOLDER/NAME, and render these frames
in this order, each as `blender -b FILE -f FRAME` does; without frames all of them, as `blender -b FILE -a`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from render_support import heads, new_scene, use_weights
from support import report

weights, folder, what, *rest = sys.argv[1], Path(sys.argv[2]), *sys.argv[3:]
blend = folder / "shot.blend"

if what == "make":
    scene = new_scene(weights, size=(64, 64))
    head = heads(scene)[0]
    scene.frame_start, scene.frame_end = 1, 8
    for frame, value in ((1, 0.0), (8, 0.9)):
        head["jawOpen"] = value
        head.keyframe_insert('["jawOpen"]', frame=frame)
    scene.render.use_placeholder, scene.render.use_overwrite = True, False
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))

bpy.ops.wm.open_mainfile(filepath=str(blend))
use_weights(weights)
scene = bpy.context.scene
scene.render.filepath = str(folder / rest[0] / "frame_")
drawn: list[int] = []
bpy.app.handlers.render_write.append(lambda scene, _: drawn.append(scene.frame_current))
frames = [int(frame) for frame in rest[1:]]
first, last = scene.frame_start, scene.frame_end
for frame in frames:
    scene.frame_start = scene.frame_end = frame
    bpy.ops.render.render(animation=True)
if not frames:
    bpy.ops.render.render(animation=True)
report(drawn=drawn, first=first, last=last)
