"""Hair of strands on an avatar: engine_hair.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from render_support import difference, heads, load_png, new_scene, render
from support import report

NECK = slice(48, 56)  # rows of a picture of 80 between chin and shoulders

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
hair = heads(scene)[0].grmm.hair
count = 0


def shot() -> np.ndarray:
    global count
    count += 1
    return load_png(render(folder / f"{count}.png"))


own = shot()
hair.groom = "afro"
afro = shot()
hair.groom = "long"
dark = shot()
hair.melanin = 0.0
hair.grey = 1.0
grey = shot()
hair.keyframe_insert("length", frame=1)
hair.length = 0.2
hair.keyframe_insert("length", frame=20)
scene.frame_set(20)
short = shot()
hair.groom = "OWN"
for row in ("melanin", "grey"):
    hair.property_unset(row)
scene.frame_set(1)
report(
    own=difference(shot(), own),
    cover=[float((picture[..., 3] > 128).mean()) for picture in (own, afro)],
    beside_neck=[float((picture[NECK, :, 3] > 128).mean()) for picture in (dark, short)],
    brightness=[float(picture[picture[..., 3] > 250][:, :3].mean()) for picture in (dark, grey)],
    listed=[item.identifier for item in type(hair).bl_rna.properties["groom"].enum_items],
)
