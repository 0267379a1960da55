"""Worlds whose nodes are not read: engine_world.py. Reports what the test judges."""

from __future__ import annotations

import math

import bpy
import numpy as np
from support import empty_scene, module, report

empty_scene()
scene = bpy.context.scene
lights = module("grmm_blender.scene.lights")
world = scene.world = bpy.data.worlds.new("World")
world.use_nodes = True
tree = world.node_tree
background = next(node for node in tree.nodes if node.type == "BACKGROUND")
ways = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)


def light() -> list[list[float]]:
    """Radiance of a white plane that faces each way."""
    around = lights.world_light(scene)
    spots = sum(np.maximum(ways @ spot.direction, 0)[:, None] * spot.irradiance for spot in around.spots)
    return ((around.irradiance(ways) + spots) / math.pi).tolist()


# Red from +x, green from +y, blue from above: each as bright as the direction leans there.
coordinates, upwards = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
upwards.operation = "MAXIMUM"
tree.links.new(coordinates.outputs["Generated"], upwards.inputs[0])
tree.links.new(upwards.outputs[0], background.inputs["Color"])
world.color = (0.5, 0.5, 0.5)
scenes = len(bpy.data.scenes)
report(unread=lights.unread_world(scene), unbaked=light())
report(finished=list(bpy.ops.grmm.bake_world()), read=lights.unread_world(scene), baked=light())
report(left=[len(bpy.data.scenes) - scenes, len([image for image in bpy.data.images if "Light" in image.name])])
background.inputs["Strength"].default_value = 2.0
report(changed=lights.unread_world(scene))
bpy.ops.grmm.bake_world()
report(again=light(), read_again=lights.unread_world(scene))
report(images=len([image for image in bpy.data.images if "Light" in image.name]))

missing = bpy.data.images.new("Sky", 8, 4, float_buffer=True)
missing.source, missing.filepath = "FILE", "//no_such_sky.exr"
missing.reload()
texture = tree.nodes.new("ShaderNodeTexEnvironment")
texture.image = missing
tree.links.new(texture.outputs[0], background.inputs["Color"])


def failure() -> str:
    """What reading the world says."""
    try:
        return str(light())
    except Exception as error:  # noqa: BLE001 - whatever comes is reported
        return f"{type(error).__name__}: {error}"


report(missing=failure())
tree.links.remove(background.inputs["Color"].links[0])
strength = background.inputs["Strength"]
strength.default_value = 0.0
report(black=light())
strength.default_value = float("nan")
report(nan=failure())
scene.world = None
report(nothing=lights.world_light(scene) is None)
