"""All passes of two avatars into multilayer EXR, and what the session says they hold: engine_passes.py WEIGHTS FOLDER.

Three files: the whole picture, a border that is cropped to (crop.exr), and one in its place (keep.exr).
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import expected, full_camera, heads, new_scene
from support import module, report, set_multilayer_exr

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, heads=2)
camera = scene.camera
camera.location.x, camera.data.lens = 0.25, 45.0
layer = scene.view_layers[0]
layer.use_pass_z = True
extra = layer.grmm_passes
extra.use_light = extra.use_mask = extra.use_raw = extra.use_normal = extra.use_features = True
settings = scene.render.image_settings
set_multilayer_exr(settings)
settings.exr_codec = "NONE"
scene.render.border_min_x, scene.render.border_max_x = 0.3, 0.71
scene.render.border_min_y, scene.render.border_max_y = 0.2, 0.6
for name in ("passes", "crop", "keep"):
    scene.render.use_border, scene.render.use_crop_to_border = name != "passes", name == "crop"
    scene.render.filepath = str(folder / f"{name}.exr")
    bpy.ops.render.render(write_still=True)

bpy.context.view_layer.update()
buffers = expected(
    scene, full_camera(scene), passes=("rgb", "alpha", "depth", "raw", "normal", "features", "mask", "diffuse", "shadow")
)
buffers["combined"] = module("grmm_core.pictures.color").scene_linear_premultiplied(buffers["rgb"], buffers["alpha"])
np.savez(folder / "expected.npz", **buffers)
report(heads=[head.name for head in heads(scene)], layer=layer.name)
