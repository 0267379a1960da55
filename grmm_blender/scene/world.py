"""The background of a scene."""

from __future__ import annotations

import bpy
import numpy as np


def world_color(scene: bpy.types.Scene) -> np.ndarray:
    """Return the scene-linear color of the world's background, [3]; textures are not evaluated."""
    world = scene.world
    if world is None:
        return np.zeros(3, np.float32)
    tree = world.node_tree if getattr(world, "use_nodes", True) else None
    if tree is not None:
        output = tree.get_output_node("ALL")
        surface = output.inputs["Surface"] if output is not None else None
        links = surface.links if surface is not None and surface.is_linked else ()
        for link in links:
            node = link.from_node
            if node.type == "BACKGROUND":
                color, strength = node.inputs["Color"], node.inputs["Strength"]
                if not color.is_linked and not strength.is_linked:
                    return np.array(color.default_value[:3], np.float32) * np.float32(strength.default_value)
    return np.array(world.color, np.float32)
