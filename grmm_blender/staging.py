"""Where a new avatar stands and who looks at it: the floor under it, cameras that frame it, Blender's startup scene."""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from .engine.settings import ENGINE
from .rig.avatar import Avatar
from .scene.avatars import place_of
from .scene.cameras import fit_shorter_side

PORTRAIT_TAG = "grmm_portrait"  # custom property of the camera: a second run uses it again
LENS = 85.0  # of a portrait, millimetres
_YAW, _PITCH = math.radians(15.0), math.radians(4.0)  # a little from the side, a little from above
_MARGIN = 0.1  # around the head, of its size
_VIEW_RADII = 4.0  # distance of a viewport from the middle of the head, in radii
# What Blender's startup scene holds, and where.
_STARTUP = {"CAMERA": (7.3589, -6.9258, 4.9583), "MESH": (0.0, 0.0, 0.0), "LIGHT": (4.0762, 1.0055, 5.9039)}
_CUBE = 2.0  # metres


def stand_up(avatar: Avatar) -> None:
    """Raise an avatar so that its lower edge is where its middle was: a floor does not run through the face then."""
    mesh = avatar.object.data
    positions = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", positions)
    avatar.root.location.z -= float(positions[2::3].min())


def is_as_started(scene: bpy.types.Scene) -> bool:
    """Whether nobody has set up a scene yet: it holds nothing but what Blender starts with, each thing in its place."""
    return scene.render.engine != ENGINE and all(_is_of_startup(obj) for obj in scene.objects)


def _is_of_startup(obj: bpy.types.Object) -> bool:
    place = _STARTUP.get(obj.type)
    if place is None or (obj.location - Vector(place)).length > 1e-3 or obj.parent or obj.animation_data:
        return False
    return obj.type != "MESH" or (len(obj.data.vertices) == 8 and (obj.dimensions - Vector((_CUBE,) * 3)).length < 1e-3)


def set_up(context: bpy.types.Context, avatar: Avatar, fresh: bool) -> None:
    """Show a head: a camera and the viewport before it, rendered by GRMM.

    Args:
        context: Its viewport looks at the head, or the window's largest.
        avatar: The head.
        fresh: The scene was as Blender starts it: its camera is moved, a head inside its cube stands upon it, and the viewports
            of all workspaces look at it.
    """
    scene, location = context.scene, avatar.root.location
    if (
        fresh
        and max(map(abs, location)) < _CUBE / 2
        and any(_is_of_startup(obj) for obj in scene.objects if obj.type == "MESH")
    ):
        location.z = _CUBE / 2
        stand_up(avatar)
    if fresh:
        scene.view_settings.view_transform = "Standard"  # pictures as solid view shows them; AgX grades them paler
    aim(scene, avatar, (scene.camera if fresh else None) or _portrait_camera(scene))
    scene.render.engine = ENGINE
    place = place_of(avatar, context.evaluated_depsgraph_get())
    for space in _viewports(context, fresh):
        view = space.region_3d
        view.view_location, view.view_distance = place.centre, _VIEW_RADII * place.radius
        view.view_rotation = Euler((math.pi / 2 - _PITCH, 0.0, place.facing + _YAW)).to_quaternion()
        view.view_perspective = "PERSP"
        space.shading.color_type = "TEXTURE"  # the mesh is painted: a face also before there are splats


def _viewports(context: bpy.types.Context, everywhere: bool) -> list[bpy.types.SpaceView3D]:
    """The viewport that a menu belongs to, whose region is then its header; the largest of the window for *File > Import*.

    Args:
        context: Of the operator.
        everywhere: Those of the other workspaces as well, but for those that look through a camera.
    """
    found = [context.space_data] if context.space_data is not None and context.space_data.type == "VIEW_3D" else []
    if not found and context.screen is not None:
        areas = [area for area in context.screen.areas if area.type == "VIEW_3D"]
        found = [area.spaces.active for area in sorted(areas, key=lambda area: area.width * area.height)[-1:]]
    if everywhere:
        spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
        found += [space for space in spaces if space not in found and space.region_3d.view_perspective != "CAMERA"]
    return found


def aim(scene: bpy.types.Scene, avatar: Avatar, camera: bpy.types.Object) -> None:
    """Put a camera without parent before an avatar so that its head fills the picture, and render through it."""
    place = place_of(avatar, bpy.context.evaluated_depsgraph_get())
    distance = fit_shorter_side(camera.data, LENS, place.radius * (1 + _MARGIN))
    turned = Matrix.Rotation(place.facing + _YAW, 4, "Z") @ Matrix.Rotation(math.pi / 2 - _PITCH, 4, "X")
    camera.matrix_world = Matrix.Translation(place.centre) @ turned @ Matrix.Translation((0.0, 0.0, distance))
    camera.data.display_size = min(camera.data.display_size, distance / 8)  # else its frame is larger than the head
    camera.data.clip_start = min(camera.data.clip_start, distance / 10)
    scene.camera = camera


def _portrait_camera(scene: bpy.types.Scene) -> bpy.types.Object:
    """The scene's camera for portraits, made where there is none."""
    for obj in scene.objects:
        if PORTRAIT_TAG in obj:
            return obj
    camera = bpy.data.objects.new("Portrait Camera", bpy.data.cameras.new("Portrait Camera"))
    camera[PORTRAIT_TAG] = True
    scene.collection.objects.link(camera)
    return camera
