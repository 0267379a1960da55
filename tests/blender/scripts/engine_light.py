"""Avatars in the scene's light: engine_light.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from render_support import difference, heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
head = heads(scene)[0]
count = 0


def shot() -> np.ndarray:
    global count
    count += 1
    return load_png(render(folder / f"{count}.png"))


def lamp(kind: str, location: tuple[float, float, float], energy: float, **settings: object) -> bpy.types.Object:
    """A lamp that looks at the head."""
    data = bpy.data.lights.new(kind, kind)
    data.energy = energy
    for name, value in settings.items():
        setattr(data, name, value)
    item = bpy.data.objects.new(kind, data)
    item.location = location
    towards = -item.location
    item.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    return item


def sides(picture: np.ndarray) -> tuple[float, float]:
    """Mean color of the head's left and right part in a picture."""
    covered = picture[..., 3] > 250
    middle = int(np.median(np.nonzero(covered)[1]))
    left, right = covered.copy(), covered.copy()
    left[:, middle:] = right[:, :middle] = False
    return float(picture[left][:, :3].mean()), float(picture[right][:, :3].mean())


flat = shot()
sun = lamp("SUN", (2.0, -0.5, 0.3), 3.0)
report(studio_ignores_lamps=difference(shot(), flat))
head.grmm.lighting = "SCENE"
lit = shot()
report(sun=sides(lit), flat=sides(flat), same_cover=float(np.abs(lit[..., 3] - flat[..., 3]).max()))

head.grmm.lighting = "PHOTO"
report(no_photo=difference(shot(), flat))
host, files, photos = (
    module(name) for name in ("grmm_blender.session_host", "grmm_core.avatar", "grmm_core.fitting.photo_light")
)
plain, source = folder / "plain.grmm", head.grmm.source
host.get_session().save(host.open_avatar(source).id, plain)
suns, around = np.zeros((1, len(photos.SUNS), 3), np.float32), np.full((1, 9, 3), 0.0, np.float32)
suns[0, np.argmin([sun.direction[0] for sun in photos.SUNS])] = 3.0  # from the person's right, the picture's left
rows = {"light_suns": suns, "light_around": around, "light_tone": np.ones((1, 3)), "light_level": np.ones((1, 3))}
stored = files.load_avatar(plain)
files.save_avatar(replace(stored, tracking={**stored.tracking, **rows, "pose": np.zeros((1, 5, 3))}), folder / "lit.grmm")
head.grmm.source = str(folder / "lit.grmm")
report(photo=sides(shot()))
head.grmm.source, head.grmm.lighting = source, "SCENE"

hat = bpy.data.meshes.new("Hat")
hat.from_pydata([(0.6, y, z) for y, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [], [(0, 1, 2, 3)])
wall = bpy.data.objects.new("Hat", hat)
scene.collection.objects.link(wall)
report(shaded=sides(shot()))
wall.hide_render = True
report(shadow_goes=difference(shot(), lit))

others = bpy.data.collections.new("Receivers")
others.objects.link(wall)
sun.light_linking.receiver_collection = others
report(linked_to_others=float(shot()[..., :3].max()))
others.objects.link(head)
report(linked=difference(shot(), lit))
others.collection_objects[-1].light_linking.link_state = "EXCLUDE"
report(excluded=float(shot()[..., :3].max()))
sun.light_linking.receiver_collection = None

sun.hide_render = True
report(dark=float(shot()[..., :3].max()))
blue = lamp("POINT", (-1.5, -0.5, 0.0), 60.0, color=(0.1, 0.2, 1.0))
picture = shot()
covered = picture[..., 3] > 250
report(blue=[float(c) for c in picture[covered][:, :3].mean(0)])
head.grmm.light_intensity = 0.0
report(intensity_off=float(shot()[..., :3].max()))
head.grmm.light_intensity = 1.0
kinds = {"POINT": {"shadow_soft_size": 0.1}, "SUN": {"angle": 0.4}, "AREA": {"shape": "ELLIPSE", "size": 0.4, "size_y": 0.8}}
read, sizes = module("grmm_blender.scene.lights").lamp_of, {}
for kind, settings in kinds.items():
    another = lamp(kind, (-1.5, -0.5, 0.0), 10.0, **settings)
    another.data.normalize = False
    area, brighter = (
        another.data.area(matrix_world=another.matrix_world),
        read(another.data, np.array(another.matrix_world), kind),
    )
    sizes[kind] = brighter.strength / (10.0 * area)
    bpy.data.objects.remove(another)
report(not_normalized=sizes)
blue.data.energy = float("nan")
try:
    shot()
    report(nan="drawn")
except RuntimeError as error:
    report(nan=str(error))
bpy.data.objects.remove(blue)

# The world as Cycles has it: the light on a white plane that faces each way.
image = bpy.data.images.new("World", 64, 32, float_buffer=True)
columns, rows = np.meshgrid(np.arange(64), np.arange(32))
pixels = np.stack([columns < 16, rows > 20, (columns > 30) & (columns < 44), np.ones_like(rows)], -1).astype(np.float32)
image.pixels.foreach_set(pixels.ravel())
world = bpy.data.worlds.new("World")
scene.world = world
world.use_nodes = True
tree = world.node_tree
background = next(node for node in tree.nodes if node.type == "BACKGROUND")
texture, mapping = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeMapping")
texture.image = image
mapping.inputs["Rotation"].default_value = (0.3, -0.2, 0.8)
tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
tree.links.new(texture.outputs[0], background.inputs["Color"])
background.inputs["Strength"].default_value = 0.7
ways = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
lights = module("grmm_blender.scene.lights")
around = lights.world_light(scene)
ours = around.irradiance(ways) / math.pi
for spot in around.spots:
    ours += np.maximum(ways @ spot.direction, 0)[:, None] * spot.irradiance / math.pi
report(unread=lights.unread_world(scene))

head.hide_render = True
for obj in scene.objects:
    obj.hide_render = obj.type != "CAMERA"
plane = bpy.data.objects.new("Plane", bpy.data.meshes.new("Plane"))
plane.data.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
white = bpy.data.materials.new("White")
white.use_nodes = True
diffuse = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
diffuse.inputs[0].default_value = (1, 1, 1, 1)
white.node_tree.links.new(diffuse.outputs[0], white.node_tree.nodes["Material Output"].inputs[0])
plane.data.materials.append(white)
scene.collection.objects.link(plane)
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 256, 0, False
world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 64  # the picture's own; a finer one takes a second
scene.render.resolution_x = scene.render.resolution_y = 4
scene.render.image_settings.file_format = "OPEN_EXR"


def cycles(way: np.ndarray) -> list[float]:
    """Mean color of a white plane that faces a way."""
    rotation = Vector(way).to_track_quat("Z", "Y")
    plane.rotation_euler = rotation.to_euler()
    scene.camera.rotation_euler = rotation.to_euler()
    scene.camera.location = Vector(way) * 0.5
    path = folder / "plane.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    loaded = bpy.data.images.load(str(path))
    loaded.colorspace_settings.name = "Non-Color"
    color = np.array(loaded.pixels[:]).reshape(-1, 4)[:, :3].mean(0)
    bpy.data.images.remove(loaded)
    return color.tolist()


report(ours=ours.tolist(), cycles=[cycles(way) for way in ways])

# Nodes of lamps, and areas that only let the world's light in.
background.inputs["Strength"].default_value = 0.0
straight = lamp("AREA", (0.0, 0.0, 2.0), 50.0)
plain = read(straight.data, np.array(straight.matrix_world), "").color, cycles(ways[4])
straight.data.use_nodes = True
emission = next(node for node in straight.data.node_tree.nodes if node.type == "EMISSION")
emission.inputs["Color"].default_value, emission.inputs["Strength"].default_value = (0.2, 0.6, 1.0, 1.0), 2.5
nodes = read(straight.data, np.array(straight.matrix_world), "").color, cycles(ways[4])
report(nodes=[(np.array(by_nodes) / np.array(without)).tolist() for by_nodes, without in zip(nodes, plain, strict=True)])
straight.data.node_tree.links.clear()
report(unlinked=[*read(straight.data, np.array(straight.matrix_world), "").color, *cycles(ways[4])])
straight.data.use_nodes = False


def lamps() -> int:
    """How many lamps shine on avatars."""
    straight.data.update_tag()
    bpy.context.view_layer.update()
    reader = lights.LightReader()
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        reader.visit(instance)
    return len(reader.lighting(scene, ()).lamps)


before = lamps()
straight.data.cycles.is_portal = True
report(portal=[before - lamps(), *cycles(ways[4])])
