"""Photos behind their camera: pixels of the background as Blender has them, the first row on top.

Arguments: photos of 96 by 64 pixels when upright.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from support import empty_scene, enable, module, report


def shown(photo: Path) -> dict[str, object]:
    context = bpy.context
    head = bpy.data.objects.new("head", bpy.data.meshes.new("head"))
    context.scene.collection.objects.link(head)
    camera = module("grmm_core.geometry.camera").Camera.orbit(96, 64)
    item = module("grmm_blender.fitting.photo_camera").add_photo_camera(context, head, photo, camera)
    if not item.data.show_background_images:
        return {"shown": False}
    image = item.data.background_images[0].image
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    rows = values.reshape(height, width, 4)[::-1, :, :3]
    return {"shown": True, "pixels": rows.tolist(), "packed": image.packed_file is not None}


enable()
empty_scene()
photos = [Path(argument) for argument in sys.argv[1:]]
report(shown=[shown(photo) for photo in photos])
bpy.ops.wm.save_as_mainfile(filepath=str(photos[0].with_suffix(".blend")))
bpy.ops.wm.open_mainfile(filepath=str(photos[0].with_suffix(".blend")))
report(kept=sum(image.packed_file is not None for image in bpy.data.images))
