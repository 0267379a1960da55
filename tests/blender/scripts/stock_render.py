"""A newcomer's first picture, with the zip alone: stock_render.py ZIP PICTURE. Installs, adds a head, renders."""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np
from support import MODULE, module, report

begin = time.monotonic()
bpy.ops.extensions.package_install_files(filepath=str(Path(sys.argv[1]).resolve()), repo="user_default", enable_on_install=True)
assert MODULE in bpy.context.preferences.addons
report(torch=find_spec("torch") is not None, install_seconds=time.monotonic() - begin)
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)
bpy.ops.grmm.add_head()
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location, camera.rotation_euler = (0.0, -1.1, 0.0), (np.pi / 2, 0.0, 0.0)
camera.data.angle = np.radians(23.0)
scene = bpy.context.scene
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine = "GRMM"
scene.render.film_transparent = True
scene.view_settings.view_transform = "Standard"
scene.render.resolution_x = scene.render.resolution_y = 256
scene.render.filepath = str(Path(sys.argv[2]).resolve())
bpy.ops.render.render(write_still=True)
status = module("grmm_blender.session_host").get_session().status()
report(first_picture_seconds=time.monotonic() - begin, kind=status.kind, engine=status.engine, here="torch" in sys.modules)
image = bpy.data.images.load(scene.render.filepath)
pixels = np.array(image.pixels[:], np.float32).reshape(256, 256, 4)
report(alpha=float(pixels[..., 3].mean()), middle=pixels[96:160, 96:160].mean((0, 1)).tolist())
