"""Keys on the sliders of light, and an EXR file as the world: engine_light_keys.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from render_support import difference, heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
head = heads(scene)[0]
head.grmm.lighting = "SCENE"
data = bpy.data.lights.new("Lamp", "AREA")
data.energy, data.size = 25.0, 0.4
lamp = bpy.data.objects.new("Lamp", data)
lamp.location = (0.9, -0.7, 0.4)
lamp.rotation_euler = Vector((-0.9, 0.7, -0.4)).to_track_quat("-Z", "Y").to_euler()
scene.collection.objects.link(lamp)


def at(frame: int, name: str) -> np.ndarray:
    scene.frame_set(frame)
    return load_png(render(folder / name))


# each slider alone: its key at frame 10 draws what its value does without keys, and frame 1 what it was
names = ("light_intensity", "skin_gloss", "skin_detail", "skin_scattering", "shadow_softness")
usual = at(1, "usual.png")
for name in names:
    setattr(head.grmm, name, 1.0)
    head.grmm.keyframe_insert(name, frame=1)
    setattr(head.grmm, name, 0.2)
    head.grmm.keyframe_insert(name, frame=10)
    first, last = at(1, f"{name}_1.png"), at(10, f"{name}_10.png")
    head.animation_data_clear()
    setattr(head.grmm, name, 0.2)
    plain = at(10, f"{name}.png")
    setattr(head.grmm, name, 1.0)
    report(**{name: [difference(first, usual), difference(last, plain), difference(last, first)]})

# an EXR file as the environment gives the light of the same pixels that are no file
columns, rows = np.meshgrid(np.arange(64), np.arange(32))
sky = np.stack([6.0 * (columns > 50), 0.3 + 0.0 * rows, rows / 32, np.ones_like(rows)], -1).astype(np.float32)
made = bpy.data.images.new("Made", 64, 32, float_buffer=True)
made.pixels.foreach_set(sky.ravel())
path = folder / "sky.exr"
before = scene.render.image_settings.file_format
scene.render.image_settings.file_format = "OPEN_EXR"
made.save_render(str(path), scene=scene)
scene.render.image_settings.file_format = before
world = scene.world = bpy.data.worlds.new("World")
world.use_nodes = True
tree = world.node_tree
background = next(node for node in tree.nodes if node.type == "BACKGROUND")
texture = tree.nodes.new("ShaderNodeTexEnvironment")
tree.links.new(texture.outputs[0], background.inputs["Color"])
lights, ways = module("grmm_blender.scene.lights"), np.concatenate([np.eye(3), -np.eye(3)])
for name, image in (("pixels", made), ("exr", bpy.data.images.load(str(path)))):
    texture.image = image
    around = lights.world_light(scene)
    found = around.irradiance(ways)
    for spot in around.spots:
        found = found + np.maximum(ways @ spot.direction, 0)[:, None] * spot.irradiance
    report(**{name: found.tolist()})
lamp.hide_render = True
report(lit_by_exr=float(at(1, "exr.png")[..., :3].mean()))
path.unlink()
texture.image.reload()
try:
    at(1, "gone.png")
    report(gone="drawn")
except RuntimeError as error:
    report(gone=str(error))
