"""An animated avatar, rendered in several orders: engine_frames.py WEIGHTS FOLDER make|open.

"make" builds and saves the file, renders the animation forwards and then its frames backwards; "open" loads the file in a
process that has seen nothing else, and renders two of the frames.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from render_support import heads, new_scene, render, use_weights
from support import report

weights, folder, what = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
blend = folder / "scène.blend"
FRAMES = range(1, 5)

if what == "make":
    scene = new_scene(weights, heads=2)
    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    head, other = heads(scene)
    for frame, value in ((1, 0.0), (4, 0.8)):
        for name in ("jawOpen", "mouthSmileLeft", "visemeOO"):
            head[name] = value
            head.keyframe_insert(f'["{name}"]', frame=frame)
        other["eyeBlinkRight"] = value
        other.keyframe_insert('["eyeBlinkRight"]', frame=frame)
        bone = head.parent.pose.bones["neck"]
        bone.rotation_mode = "XYZ"
        bone.rotation_euler.y = value * 0.5
        bone.keyframe_insert("rotation_euler", frame=frame)
        scene.camera.location.z = value * 0.1
        scene.camera.keyframe_insert("location", frame=frame)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    scene.render.filepath = str(folder / "forwards_")
    bpy.ops.render.render(animation=True)
    for frame in reversed(FRAMES):
        scene.frame_set(frame)
        render(folder / f"backwards_{frame:04d}.png")
else:
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    use_weights(weights)
    scene = bpy.context.scene
    for frame in (3, 2):
        scene.frame_set(frame)
        render(folder / f"opened_{frame:04d}.png")
report(files=sorted(path.name for path in folder.glob("*.png")))
