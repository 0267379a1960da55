"""The background of a scene."""

from __future__ import annotations

import bpy
import numpy as np


def background_node(world: bpy.types.World) -> bpy.types.ShaderNode | None:
    """Return the background node that a world shows, None where it has another surface or none."""
    tree = world.node_tree if getattr(world, "use_nodes", True) else None
    output = None if tree is None else tree.get_output_node("ALL")
    surface = None if output is None else output.inputs["Surface"]
    node = surface.links[0].from_node if surface is not None and surface.is_linked else None
    return node if node is not None and node.type == "BACKGROUND" else None


def world_color(scene: bpy.types.Scene) -> np.ndarray:
    """Return the scene-linear color of the world's background, [3]; textures are not evaluated."""
    world = scene.world
    if world is None:
        return np.zeros(3, np.float32)
    node = background_node(world)
    if node is not None:
        color, strength = node.inputs["Color"], node.inputs["Strength"]
        if not color.is_linked and not strength.is_linked:
            return np.array(color.default_value[:3], np.float32) * np.float32(strength.default_value)
    return np.array(world.color, np.float32)
