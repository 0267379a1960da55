"""What lights the meshes of a viewport, for splats of avatars that take the scene's light: roughly, as viewports show it.

In solid view these are the four lamps of the studio light that was chosen, which turn with the view or stand in the world. In
material preview they are the scene's lamps and world where they are switched on; the studio's rig stands for the picture that
Blender takes instead of the world.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ...grmm_core.light.lamps import STUDIO, Lighting, Sun
from ...grmm_core.light.surroundings import Surroundings
from ..scene.shot import AvatarShot

_TO_VIEW = np.diag([1.0, -1.0, -1.0, 1.0])  # from a view's axes (y up, z to the viewer) to a camera's


def lit_in(shading: bpy.types.View3DShading, shot: AvatarShot, scene: Callable[[], Lighting]) -> AvatarShot:
    """A shot as a viewport lights it; `scene` gives the scene's light. As trained where that has no direction."""
    if shot.response is None:
        return shot
    if shot.own_light is not None:
        return replace(shot, lighting=shot.own_light.in_space(shot.model_to_world))
    if shading.type == "SOLID":
        if shading.light != "STUDIO":
            return replace(shot, response=None)
        lighting, by_view = _solid(shading)
        return replace(shot, response=replace(shot.response, unlit_by=()), lighting=lighting, lit_by_view=by_view)
    shown, world = shading.use_scene_lights, shading.use_scene_world
    found = scene() if shown or world else Lighting()
    rest = found if world else STUDIO.scaled((float(shading.studiolight_intensity),) * 3)
    lamps = (*(found.lamps if shown else ()), *(() if world else rest.lamps))
    response = shot.response if shown else replace(shot.response, unlit_by=())
    return replace(shot, response=response, lighting=Lighting(lamps, rest.surroundings))


def light_key(shading: bpy.types.View3DShading) -> tuple[Any, ...]:
    """What `lit_in` reads of a viewport: splats are looked at again where it changes."""
    if shading.type == "SOLID" and shading.light == "STUDIO":
        lighting, by_view = _solid(shading)
        return repr(lighting), by_view
    return (
        shading.type, shading.light, shading.use_scene_lights, shading.use_scene_world, shading.studiolight_intensity
    )  # fmt: skip


def in_world(shot: AvatarShot, lighting: Lighting, world_to_camera: np.ndarray) -> Lighting:
    """A shot's light in the world's axes, which turns with the camera where the shot says so."""
    if not shot.lit_by_view:
        return lighting
    turn = np.eye(4)
    turn[:3, :3] = world_to_camera[:3, :3].T / np.cbrt(np.linalg.det(world_to_camera[:3, :3]))
    return lighting.in_space(turn @ _TO_VIEW)


def _solid(shading: bpy.types.View3DShading) -> tuple[Lighting, bool]:
    """The studio light of solid view, and whether it turns with the view.

    A lamp that shines straight on a white surface gives it the lamp's color: pi times that is its irradiance. Lamps in the
    world have their view's up as height, and are turned by the viewport's angle.
    """
    chosen: Any = shading.selected_studio_light
    if chosen is None or chosen.name == "Default":  # this one can be edited, and shows before it is saved
        chosen = bpy.context.preferences.system
    angle, suns = float(shading.studiolight_rotate_z), []
    for lamp in chosen.solid_lights:
        x, y, z = lamp.direction
        if shading.use_world_space_lighting:
            x, y, z = x * math.cos(angle) - z * math.sin(angle), -x * math.sin(angle) - z * math.cos(angle), y
        length = math.sqrt(x * x + y * y + z * z)
        if lamp.use and length > 0.0:
            suns.append(Sun(tuple(lamp.diffuse_color), math.pi, direction=(x / length, y / length, z / length)))
    red, green, blue = chosen.light_ambient
    return Lighting(tuple(suns), Surroundings.even((red, green, blue))), not shading.use_world_space_lighting
