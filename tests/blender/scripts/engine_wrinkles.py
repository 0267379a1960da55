"""The slider for wrinkles, with keys: engine_wrinkles.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import sys
from pathlib import Path

from render_support import difference, heads, load_png, new_scene, render
from support import report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, size=(192, 160))
head = heads(scene)[0]


def shot(name: str):
    return load_png(render(folder / f"{name}.png"))


rest = shot("rest")
head.grmm.wrinkles = 0.0
report(at_rest=difference(shot("smooth_rest"), rest))
for name in ("browInnerUp", "browOuterUpLeft", "browOuterUpRight"):
    head[name] = 1.0
for frame, value in ((1, 0.0), (3, 2.0)):
    head.grmm.wrinkles = value
    head.grmm.keyframe_insert("wrinkles", frame=frame)
pictures = []
for frame in (1, 2, 3):
    scene.frame_set(frame)
    pictures.append(shot(f"frame_{frame}"))
report(value=head.grmm.wrinkles, half=difference(pictures[1], pictures[0]), whole=difference(pictures[2], pictures[0]))
