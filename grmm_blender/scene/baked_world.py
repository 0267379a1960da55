"""A world's light as a picture that Cycles made of it: what stands for node trees that `lights` cannot read.

Baked by the user's wish, for no picture can be rendered while another one is. A small image beside the world, saved with the
file, holds it, and of which nodes it was made.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...grmm_core.errors import ConfigError

_SIZE, _SAMPLES = (128, 64), 32
_IMAGE, _MADE_OF = "grmm_light", "grmm_light_made_of"  # custom properties of a world


def baked(world: bpy.types.World) -> bpy.types.Image | None:
    """The picture of a world's light, equirectangular; None where it was never baked."""
    image = world.original.get(_IMAGE)
    return image if isinstance(image, bpy.types.Image) else None


def is_current(world: bpy.types.World) -> bool:
    """Whether the world has the nodes that its picture was made of."""
    return world.original.get(_MADE_OF) == _made_of(world)


def bake(world: bpy.types.World) -> bpy.types.Image:
    """Render a world's light and keep it with the world. Raises `ConfigError` without Cycles."""
    if not hasattr(world, "cycles"):
        raise ConfigError("Cycles is switched off; enable it in the preferences to bake the world's light.")
    alike = world.original.copy()  # for a setting that only costs time here: where a panorama's rays go is known
    alike.cycles.sampling_method = "NONE"
    scene = bpy.data.scenes.new("GRMM World")
    camera = bpy.data.cameras.new("GRMM World")
    eye = bpy.data.objects.new("GRMM World", camera)
    try:
        _set_up(scene, eye, alike)
        with tempfile.TemporaryDirectory(prefix="grmm-world-") as folder:
            scene.render.filepath = str(Path(folder) / "world.exr")
            bpy.ops.render.render(write_still=True, scene=scene.name)
            pixels = _pixels(scene.render.filepath)
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(eye)
        bpy.data.cameras.remove(camera)
        bpy.data.worlds.remove(alike)
    before = baked(world)
    if before is not None:
        bpy.data.images.remove(before)
    image = bpy.data.images.new(f"{world.name} Light", *_SIZE, float_buffer=True)
    image.pixels.foreach_set(pixels)
    image.pack()
    world[_IMAGE], world[_MADE_OF] = image, _made_of(world)
    return image


def _set_up(scene: bpy.types.Scene, eye: bpy.types.Object, world: bpy.types.World) -> None:
    """A panorama of the world, in the directions that environment textures have."""
    scene.render.engine, scene.world, scene.camera = "CYCLES", world, eye
    scene.collection.objects.link(eye)
    eye.rotation_euler = (math.pi / 2, 0.0, -math.pi / 2)  # along +x: the middle of an environment texture
    eye.data.type = "PANO"
    kind = eye.data if hasattr(eye.data, "panorama_type") else eye.data.cycles  # the former since Blender 5
    kind.panorama_type = "EQUIRECTANGULAR"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", _SAMPLES, False
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = *_SIZE, 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.use_compositing = render.use_sequencer = False


def _pixels(path: str) -> np.ndarray:
    loaded = bpy.data.images.load(path)
    try:
        pixels = np.empty(4 * loaded.size[0] * loaded.size[1], np.float32)
        loaded.pixels.foreach_get(pixels)
        return pixels
    finally:
        bpy.data.images.remove(loaded)


def _made_of(world: bpy.types.World) -> str:
    """What tells one node tree from another."""
    digest = hashlib.blake2b(digest_size=16)
    tree = world.original.node_tree
    for line in [] if tree is None else _lines(tree):
        digest.update(line.encode())
    return digest.hexdigest()


def _lines(tree: bpy.types.NodeTree) -> list[str]:
    lines = []
    for node in tree.nodes:
        for name, value in _values(node):
            lines.append(f"{node.name}.{name}={value}")
        if getattr(node, "node_tree", None) is not None:
            lines += _lines(node.node_tree)
        ramp = getattr(node, "color_ramp", None)
        lines += [] if ramp is None else [f"{stop.position} {stop.color[:]}" for stop in ramp.elements]
    for link in tree.links:
        lines.append(f"{link.from_node.name}.{link.from_socket.identifier}>{link.to_node.name}.{link.to_socket.identifier}")
    return lines


def _values(node: bpy.types.Node) -> list[tuple[str, Any]]:
    """Settings of a node that change what it does, and numbers at its inputs."""
    skipped = {prop.identifier for prop in bpy.types.Node.bl_rna.properties} - {"mute"}
    found = [(name, getattr(node, name)) for name in set(node.bl_rna.properties.keys()) - skipped]
    found += [(each.identifier, each.default_value) for each in node.inputs if hasattr(each, "default_value")]
    plain = []
    for name, value in found:
        if isinstance(value, bpy.types.ID):
            plain.append((name, value.name_full))
        elif hasattr(value, "__len__") and not isinstance(value, str):
            plain.append((name, tuple(value)))
        elif isinstance(value, (bool, int, float, str)):
            plain.append((name, value))
    return sorted(plain, key=lambda each: each[0])
