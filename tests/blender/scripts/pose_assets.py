"""The pose library of a head: assets, catalogues, thumbnails, applying: pose_assets.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from rig_support import fresh_head
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
poses = module("grmm_blender.poses")
expressions = module("grmm_core.controls.names")
avatar = fresh_head(weights)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "poses.blend"))
(folder / poses.CATALOGUE_FILE).write_text("VERSION 1\n\n11111111-2222-3333-4444-555555555555:Mine:Mine\n", "utf-8")
report(done=bpy.ops.grmm.create_pose_library() == {"FINISHED"})
first = sorted(action.name for action in poses.local_poses())
smile = bpy.data.actions["Smile Left"]


def thumbnail(name: str) -> np.ndarray:
    preview = bpy.data.actions[name].preview
    pixels = np.empty(len(preview.image_pixels_float), np.float32)
    preview.image_pixels_float.foreach_get(pixels)
    return pixels.reshape(*reversed(preview.image_size), 4)


pictures = {name: thumbnail(name) for name in ("Smile Left", "Open Jaw")}
report(
    count=len(first),
    sizes=[list(picture.shape) for picture in pictures.values()],
    covered=[float((picture[..., 3] > 0.9).mean()) for picture in pictures.values()],
    differ=float(np.abs(pictures["Smile Left"] - pictures["Open Jaw"]).max()),
    tags=sorted(tag.name for tag in smile.asset_data.tags),
    catalogues=(folder / poses.CATALOGUE_FILE).read_text("utf-8"),
    catalogue=smile.asset_data.catalog_id,
    description=smile.asset_data.description,
)
bpy.ops.grmm.create_pose_library(thumbnails=False)
report(again=sorted(action.name for action in poses.local_poses()) == first, kept=thumbnail("Open Jaw").shape[0])

head = avatar.object
shown = lambda: {n: round(head[n], 4) for n in expressions.ALIGNED_NAMES if abs(head[n]) > 1e-6}  # noqa: E731
head["jawOpen"] = 0.5
bpy.ops.grmm.apply_pose(pose="Smile Left")
report(replaced=shown())
bpy.ops.grmm.apply_pose(pose="Open Jaw", amount=0.25, add=True)
report(added=shown())
bpy.ops.grmm.apply_pose(pose="Smile Left", flip=True)
report(flipped=shown())
bpy.ops.grmm.apply_pose(relative_asset_identifier="Action/Puff Cheeks", asset_library_type="LOCAL")
report(clicked=shown())

# The user's own pose, with a coefficient of the residual code; applied from another file.
head["jawOpen"] = 0.3
head["z_exp"][2] = 1.25
bpy.ops.grmm.save_pose(name="My Pose")
own = bpy.data.actions["My Pose"]
report(own=[own.asset_data is not None, own.asset_data.catalog_id == poses.catalogue_id("GRMM Expressions/Own")])
bpy.ops.wm.save_mainfile()
head = fresh_head(weights).object  # another file, whose library the first one is
library = bpy.context.preferences.filepaths.asset_libraries.new(name="Poses", directory=str(folder))
count = len(bpy.data.actions)
bpy.ops.grmm.apply_pose(
    relative_asset_identifier="poses.blend/Action/My Pose", asset_library_type="CUSTOM", asset_library_identifier="Poses"
)
report(from_library=shown(), code=round(head["z_exp"][2], 4), left_over=len(bpy.data.actions) - count)
avatar = module("grmm_blender.rig.avatar").avatar_of(head)
messages = []
for wanted in ("poses.blend/Action/Nothing", "gone.blend/Action/My Pose", "Action/Nothing"):
    try:
        bpy.ops.grmm.apply_pose(relative_asset_identifier=wanted, asset_library_type="CUSTOM", asset_library_identifier="Poses")
        messages.append("")
    except RuntimeError as error:
        messages.append(str(error))
report(messages=messages)

# Keyed where automatic keying is on; and a pose's action moves the head like any action.
bpy.context.scene.tool_settings.use_keyframe_insert_auto = True
head["jawOpen"] = 0.0
bpy.ops.grmm.create_pose_library(thumbnails=False)
bpy.ops.grmm.apply_pose(pose="Open Jaw")
curves = list(module("grmm_blender.rig.actions").action_curves(head))
report(keyed=len(curves))
