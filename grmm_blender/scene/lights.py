"""The lamps and the world of a scene, as `grmm_core.light` has them, in Blender's world axes.

Kept between pictures: what a world's picture gives, by image. Other node trees than a background of one color or an environment
texture are read as `baked_world` has them; until that is made the world's viewport color stands for them, and `unread_world`
says so in the panel.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...grmm_core.errors import ConfigError
from ...grmm_core.light.lamps import Area, Lamp, Lighting, Point, Spot, Sun
from ...grmm_core.light.shading import Response
from ...grmm_core.light.surroundings import Surroundings
from ...grmm_core.pictures.color import srgb_to_linear
from . import baked_world
from .shot import Occluder
from .world import background_node

MAX_SHADOW_TRIANGLES = 400_000  # of scene meshes; beyond, the largest objects throw no shadows on avatars
# Blender looks up an environment picture with its middle along +x and its left half towards +y.
_PICTURE_TO_BLENDER = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_pictures: dict[tuple[Any, ...], Surroundings] = {}


class LightReader:
    """Copies lamps while `walk` goes over a scene."""

    def __init__(self) -> None:
        self._lamps: list[Lamp] = []
        self._receivers: list[bpy.types.Collection | None] = []

    def visit(self, instance: bpy.types.DepsgraphObjectInstance) -> None:
        """Copy a lamp; everything else is passed over. What a render does not show is not in its depsgraph."""
        if instance.object.type == "LIGHT" and instance.show_self and not _is_portal(instance.object.data):
            matrix = np.array(instance.matrix_world, np.float64)
            self._lamps.append(lamp_of(instance.object.data, matrix, instance.object.name))
            self._receivers.append(instance.object.original.light_linking.receiver_collection)

    def linked(self, response: Response | None, head: bpy.types.Object) -> Response | None:
        """How a head takes the light of the lamps that are linked to it, or to everything."""
        kept_off = tuple(i for i, receivers in enumerate(self._receivers) if not _receives(receivers, head.original))
        return replace(response, unlit_by=kept_off) if response is not None and kept_off else response

    def lighting(self, scene: bpy.types.Scene, occluders: tuple[Occluder, ...]) -> Lighting:
        """All light of a scene. Raises `ConfigError` for numbers that are no light, naming the lamp."""
        budget, kept = MAX_SHADOW_TRIANGLES, []
        for occluder in sorted(occluders, key=lambda each: len(each.triangles)):
            budget -= len(occluder.triangles)
            if budget < 0:
                break
            kept.append(occluder.placed())
        return Lighting(
            tuple(self._lamps), world_light(scene), np.concatenate(kept) if kept else np.zeros((0, 3, 3), np.float32)
        )


def _receives(collection: bpy.types.Collection | None, head: bpy.types.Object) -> bool:
    """Whether a lamp with a collection of receivers lights a head: what it excludes never, what it includes alone."""
    if collection is None:
        return True
    states = _link_states(collection)
    return states.get(head.name_full, "EXCLUDE" if "INCLUDE" in states.values() else "INCLUDE") == "INCLUDE"


def _link_states(collection: bpy.types.Collection) -> dict[str, str]:
    """Whether objects of a collection are included or excluded, by full name; of nested ones their collection decides."""
    states: dict[str, str] = {}
    for child, link in zip(collection.children, collection.collection_children, strict=True):
        states |= dict.fromkeys((obj.name_full for obj in child.all_objects), link.light_linking.link_state)
    for obj, link in zip(collection.objects, collection.collection_objects, strict=True):
        states[obj.name_full] = link.light_linking.link_state
    return states


def _is_portal(light: bpy.types.Light) -> bool:
    """Whether an area lamp shines not by itself but only tells Cycles where the world's light comes in."""
    return light.type == "AREA" and bool(getattr(getattr(light, "cycles", None), "is_portal", False))


def _emitted(light: bpy.types.Light) -> np.ndarray:
    """What a lamp's nodes make of its color, linear RGB, [3]: the color and strength of an emission; what is linked is 1."""
    tree = light.node_tree if light.node_tree is not None and getattr(light, "use_nodes", True) else None
    output = None if tree is None else tree.get_output_node("ALL")
    if output is None:
        return np.ones(3)
    surface = output.inputs["Surface"]
    if not surface.is_linked:
        return np.zeros(3)
    node = surface.links[0].from_node
    if node.type != "EMISSION":
        return np.ones(3)
    color, strength = node.inputs["Color"], node.inputs["Strength"]
    emitted = np.ones(3) if color.is_linked else np.array(color.default_value[:3])
    return emitted if strength.is_linked else emitted * float(strength.default_value)


def lamp_of(light: bpy.types.Light, matrix: np.ndarray, name: str) -> Lamp:
    """One lamp.

    Args:
        light: Its data.
        matrix: Places it in the world, [4, 4]; it shines along its -z.
        name: For errors.

    Raises:
        ConfigError: Numbers that are no light.
    """
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-12)
    color = np.array(light.color) * _emitted(light)
    if light.use_temperature:
        color = color * np.array(light.temperature_color)
    strength = float(light.energy) * 2.0 ** float(light.exposure)
    if not light.normalize:  # brighter the larger it is
        strength *= float(light.area(matrix_world=Matrix(matrix)))
    common: dict[str, Any] = {"color": tuple(map(float, color)), "strength": strength, "shadow": bool(light.use_shadow)}
    position, forward = tuple(matrix[:3, 3]), tuple(-axes[:, 2])
    try:
        if light.type == "SUN":
            return Sun(**common, direction=tuple(axes[:, 2]), angle=float(light.angle))
        if light.type == "AREA":
            width = float(light.size)
            height = float(light.size_y) if light.shape in ("RECTANGLE", "ELLIPSE") else width
            sides = np.linalg.norm(matrix[:3, :3], axis=0)  # the object's scale makes the lamp larger, not brighter
            across, up = axes[:, 0] * 0.5 * width * sides[0], axes[:, 1] * 0.5 * height * sides[1]
            ellipse = light.shape in ("DISK", "ELLIPSE")
            return Area(**common, position=position, across=tuple(across), up=tuple(up), ellipse=ellipse)
        radius = float(light.shadow_soft_size)
        if light.type == "SPOT":
            cone, blend = float(light.spot_size), float(light.spot_blend)
            return Spot(**common, position=position, radius=radius, direction=forward, cone=cone, blend=blend)
        return Point(**common, position=position, radius=radius)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error


def world_light(scene: bpy.types.Scene) -> Surroundings | None:
    """The world's light; None without a world. Raises `ConfigError` for a strength or picture that is no light."""
    world = scene.world
    if world is None:
        return None
    image = None if _is_plain(world) else baked_world.baked(world)
    if image is not None:
        return _of_image(image)
    background, plain = background_node(world), Surroundings.even(tuple(world.color))
    if background is None:
        return plain
    color, strength = background.inputs["Color"], background.inputs["Strength"]
    factor = 1.0 if strength.is_linked else float(strength.default_value)
    if not color.is_linked:
        red, green, blue, _ = (float(c) * factor for c in color.default_value)
        return Surroundings.even((red, green, blue))
    node = color.links[0].from_node
    if node.type != "TEX_ENVIRONMENT" or node.image is None:
        return plain
    around = _of_image(node.image)
    turn = _mapping(node)
    return (around if turn is None else around.turned(turn)).scaled(factor)


def unread_world(scene: bpy.types.Scene) -> str:
    """What a world holds that is not read, in a sentence; "" where all of it is."""
    world = scene.world
    if world is None or _is_plain(world):
        return ""
    if baked_world.baked(world) is None:
        return "Avatars take this world's viewport color for its light until its nodes are baked"
    return "" if baked_world.is_current(world) else "The world has changed since its light was baked"


def _is_plain(world: bpy.types.World) -> bool:
    """Whether a world is read without being baked: a color, or an environment texture with its mapping."""
    background = background_node(world)
    if background is None:
        return world.node_tree is None or not getattr(world, "use_nodes", True)
    color = background.inputs["Color"]
    node = color.links[0].from_node if color.is_linked else None
    plain = node is None or (node.type == "TEX_ENVIRONMENT" and node.image is not None)
    return plain and not background.inputs["Strength"].is_linked


def _of_image(image: bpy.types.Image) -> Surroundings:
    width, height = image.size
    key = (image.session_uid, image.filepath, width, height, image.colorspace_settings.name)
    if key not in _pictures:
        if width * height == 0:
            raise ConfigError(f"The picture {image.name} of the world is missing; find it with File > External Data.")
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        picture = pixels.reshape(height, width, image.channels)[::-1]  # Blender counts rows from below
        color = picture[..., :3] if image.channels >= 3 else np.repeat(picture[..., :1], 3, -1)
        if not image.is_float and image.colorspace_settings.name == "sRGB":
            color = srgb_to_linear(color)
        _pictures.clear()  # one world at a time
        _pictures[key] = Surroundings.of_picture(color).turned(_PICTURE_TO_BLENDER)
    return _pictures[key]


def _mapping(node: bpy.types.ShaderNode) -> np.ndarray | None:
    """Rotation of the surroundings by a mapping node before an environment texture, [3, 3], or None."""
    vector = node.inputs["Vector"]
    before = vector.links[0].from_node if vector.is_linked else None
    if before is None or before.type != "MAPPING":
        return None
    x, y, z = (float(angle) for angle in before.inputs["Rotation"].default_value)
    about = []
    for axis, angle in enumerate((x, y, z)):
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i] = turn[j, j] = math.cos(angle)
        turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
        about.append(turn)
    looked_up: np.ndarray = about[2] @ about[1] @ about[0]  # where the picture is read for a direction
    return looked_up.T
