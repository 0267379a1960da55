"""A `lights.Light` in Blender's scene: area lamps and a world of three colors. Imports bpy."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from grmm_core.geometry.camera import Camera

from .lights import MAX_LAMPS, Light


class Lamps:
    """The lamps and the world of a scene, set anew for every light."""

    def __init__(self, scene: bpy.types.Scene) -> None:
        world = bpy.data.worlds.new("world")
        scene.world = world
        world.use_nodes = True
        tree = world.node_tree
        self._background = tree.nodes["Background"]
        height = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], height.inputs[0])
        self._ramp = tree.nodes.new("ShaderNodeValToRGB")
        share = tree.nodes.new("ShaderNodeMapRange")
        share.inputs["From Min"].default_value = -1.0
        tree.links.new(height.outputs[2], share.inputs["Value"])
        tree.links.new(share.outputs[0], self._ramp.inputs[0])
        tree.links.new(self._ramp.outputs[0], self._background.inputs[0])
        stops = self._ramp.color_ramp.elements
        stops[0].position = 0.40
        stops.new(0.5)
        stops[2].position = 0.75
        self._items = []
        for i in range(MAX_LAMPS):
            lamp = bpy.data.lights.new(f"lamp{i}", "AREA")
            lamp.shape = "SQUARE"
            item = bpy.data.objects.new(lamp.name, lamp)
            item.visible_camera = False
            scene.collection.objects.link(item)
            self._items.append(item)

    def set(self, light: Light) -> None:
        """Make the scene's light that of `light`."""
        self._background.inputs[1].default_value = light.strength
        for stop, color in zip(self._ramp.color_ramp.elements, (light.ground, light.horizon, light.zenith), strict=True):
            stop.color = (*color, 1.0)
        for i, item in enumerate(self._items):
            item.hide_render = i >= len(light.lamps)
            if not item.hide_render:
                lamp = light.lamps[i]
                item.data.size, item.data.energy, item.data.color = lamp.side, lamp.power, lamp.color
                item.matrix_world = look_at(Camera.orbit(8, 8, lamp.yaw, lamp.pitch, lamp.distance))


def look_at(camera: Camera) -> Matrix:
    """Blender object matrix of a camera in head space."""
    to_world = np.linalg.inv(np.asarray(camera.world_to_camera))
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return Matrix((turn @ to_world @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist())
