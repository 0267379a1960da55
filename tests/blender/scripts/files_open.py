"""Open a saved head, with or without the extension: files_open.py WEIGHTS FOLDER NAME [SAVE_AS].

Works with Blender's own data only, except where the extension is enabled.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from support import MODULE, module, report

weights, folder, name = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
enabled = MODULE in bpy.context.preferences.addons
bpy.context.preferences.filepaths.use_scripts_auto_execute = False
if enabled:
    from render_support import use_weights

    use_weights(weights)
bpy.ops.wm.open_mainfile(filepath=str(folder / name), use_scripts=False)
scene = bpy.context.scene
head = next(obj for obj in bpy.data.objects if obj.type == "MESH")


def positions() -> np.ndarray:
    mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.attributes["position"].data.foreach_get("vector", flat)
    points = flat.reshape(-1, 3)
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], 1)


def change(what: str) -> float:
    """Move one control; how far the mesh follows."""
    before = positions()
    if what == "bone":
        head.parent.pose.bones["neck"].rotation_euler[1] += 0.3
        head.parent.update_tag()
    else:
        head[what] += 0.5
        head.update_tag()
    bpy.context.view_layer.update()
    return float(np.abs(positions() - before).max())


with np.load(folder / "meshes.npz") as archive:
    saved, native = (
        {int(key.removeprefix(kind)): value for key, value in archive.items() if key.startswith(kind)}
        for kind in ("frame", "native")
    )
opened = float(np.abs(positions() - saved[scene.frame_current]).max())
errors, native_errors = {}, {}
for frame in saved:
    scene.frame_set(frame)
    errors[str(frame)] = float(np.abs(positions() - saved[frame]).max())
    native_errors[str(frame)] = float(np.abs(positions() - native[frame]).max())
drivers = [*head.data.shape_keys.animation_data.drivers, *head.parent.animation_data.drivers]
report(
    extension=hasattr(bpy.types.Object, "grmm"),
    opened=opened,
    errors=errors,
    native_errors=native_errors,
    valid=all(curve.driver.is_valid for curve in drivers),
    polygons=len(head.data.polygons),
)
if enabled:
    avatars = module("grmm_blender.scene.avatars").avatars_in(scene)
    report(avatars=[avatar.name for avatar in avatars], source=[avatar.source for avatar in avatars])
    from render_support import difference, load_png, render

    render(folder / "again.png")
    report(picture=difference(load_png(folder / "again.png"), load_png(folder / "saved.png")))
report(moved={what: change(what) for what in ("mouthFunnel", "visemeOO", "bone")})
if len(sys.argv) > 4:
    bpy.ops.wm.open_mainfile(filepath=str(folder / name), use_scripts=False)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / sys.argv[4]))
