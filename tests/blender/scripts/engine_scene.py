"""Film, world, scene meshes, holdouts, hidden avatars: engine_scene.py WEIGHTS FOLDER.

Reports, for each variation, measures of the saved pictures that the test judges.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import difference, expected, expected_png, full_camera, heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
scene.camera.location.x = 0.0
scene.camera.rotation_euler.z = 0.0
bpy.context.view_layer.update()
color = module("grmm_core.pictures.color")
camera = full_camera(scene)
buffers = expected(scene, camera)
alone = expected_png(buffers)
alpha = np.clip(buffers["alpha"], 0, 1)
linear = color.scene_linear_premultiplied(buffers["rgb"], buffers["alpha"])
count = 0


def shot() -> np.ndarray:
    global count
    count += 1
    return load_png(render(folder / f"{count}.png"))


def plane(name: str, distance: float, x0: float, x1: float) -> bpy.types.Object:
    """A wall across the picture at a distance in front of the head's origin."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(x0, -distance, -2), (x1, -distance, -2), (x1, -distance, 2), (x0, -distance, 2)], [], [(0, 1, 2, 3)])
    wall = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(wall)
    return wall


def over(background: np.ndarray) -> np.ndarray:
    """The avatar over a linear color, as PNG bytes."""
    mixed = linear[..., :3] + (1 - alpha) * background
    return np.concatenate([color.linear_to_srgb(mixed), np.ones_like(alpha)], -1) * 255


report(transparent=difference(shot(), alone))

# The world behind, by node and by color.
scene.render.film_transparent = False
world = bpy.data.worlds.new("World")
scene.world = world
world.use_nodes = True
node = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (0.2, 0.4, 0.1, 1.0), 0.5
report(world=difference(shot(), over(np.array([0.1, 0.2, 0.05]))))

# A holdout in front of the left half, then beside and behind: alpha goes where nothing is in front of it.
wall = plane("Wall", 0.4, -5.0, 0.0)
wall.is_holdout = True
found = shot()
half = camera.width // 2
report(holdout_left=float(found[:, :half, 3].max()), holdout_right=float(found[:, half:, 3].min()))
wall.location.y = 0.9
found = shot()
solid = alone[..., 3] > 254.5
report(holdout_behind=float(found[solid][:, 3].min()), holdout_corner=float(found[0, 0, 3]))
wall.is_holdout = False
scene.render.film_transparent = True

# A plain wall: the left half of the avatar goes, the edge is soft, the rest stays; behind the head it changes nothing.
wall.location.y = 0.0
found = shot()
report(
    occluded_left=float(found[:, : half - 1, 3].max()),
    unoccluded_right=difference(found[:, half + 1 :], alone[:, half + 1 :]),
)
scene.grmm_render.use_occlusion = False
report(occlusion_off=difference(shot(), alone))
scene.grmm_render.use_occlusion = True
wall.hide_render = True
report(wall_hidden=difference(shot(), alone))
wall.hide_render = False
wall.location.y = 0.9
report(wall_behind=difference(shot(), alone))

# An instance of a collection hides as the object itself does.
nested = bpy.data.collections.new("Nested")
scene.collection.objects.unlink(wall)
nested.objects.link(wall)
instancer = bpy.data.objects.new("Instancer", None)
instancer.instance_type, instancer.instance_collection = "COLLECTION", nested
scene.collection.objects.link(instancer)
instancer.location.y = -0.9
report(instance_left=float(shot()[:, : half - 1, 3].max()))
bpy.data.objects.remove(instancer)

# A text object counts as well.
text = bpy.data.objects.new("Text", bpy.data.curves.new("Text", "FONT"))
text.data.body, text.data.size, text.data.align_x = "MMMM", 0.3, "CENTER"
text.location, text.rotation_euler = (0.0, -0.4, 0.0), (np.pi / 2, 0, 0)
scene.collection.objects.link(text)
found = shot()
report(text_hides=float((found[..., 3] < alone[..., 3] - 100).mean()))
bpy.data.objects.remove(text)

# The avatar as a holdout, then hidden.
head = heads(scene)[0]
scene.render.film_transparent = False
head.is_holdout = True
found = shot()
report(avatar_holdout=float(found[solid][:, 3].mean()), beside_holdout=float(found[0, 0, 3]))
head.is_holdout = False
scene.render.film_transparent = True
head.hide_render = True
report(hidden=float(shot()[..., 3].max()))
head.hide_render = False

# AgX: what the color management makes of our linear values, not the network's own.
scene.view_settings.view_transform = "AgX"
agx = shot()
report(agx_alpha=float(np.abs(agx[..., 3] - alone[..., 3]).max()), agx_differs=difference(agx, alone))
solid = agx[..., 3] > 254.5
straight = np.where(solid[..., None], linear[..., :3] / np.maximum(linear[..., 3:], 0.5), 0.0)
straight = np.concatenate([straight, np.ones_like(linear[..., 3:])], -1).astype(np.float32)
image = bpy.data.images.new("Linear", linear.shape[1], linear.shape[0], float_buffer=True)
image.colorspace_settings.name = "Linear Rec.709"
image.pixels.foreach_set(straight[::-1].ravel())
image.save_render(str(folder / "agx.png"), scene=scene)  # Blender's own AgX of the same values
graded = load_png(folder / "agx.png")
report(agx_error=float(np.abs(agx - graded)[solid][:, :3].max()))
settings = scene.render.image_settings
settings.color_management = "OVERRIDE"
settings.view_settings.view_transform = "Standard"
report(override=difference(shot(), alone))
