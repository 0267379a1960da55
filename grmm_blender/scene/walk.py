"""The one pass over an evaluated scene, and the shots made from it.

Every avatar, cloud and mesh that a picture may need is met once, whoever asks. What is met is read by the module of its kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy

from ...grmm_core.geometry.camera import Camera
from ..properties import SCENE_LIGHT
from ..splats.cloud import Cloud, CloudShot
from .avatars import DrawnAvatar, avatars_in, avatars_shown, avatars_with_instanced, drawn_avatar, is_drawn
from .cameras import Eye, clip_range, render_camera, scene_camera
from .clouds import DrawnCloud, clouds_in, drawn_cloud
from .lights import LightReader
from .meshes import MeshCache, OccluderReader
from .shot import Frame, Occluders, SceneShot
from .visibility import is_rendered
from .world import world_color

Drawn = DrawnAvatar | DrawnCloud
"""What Gaussians draw."""


def walk(
    depsgraph: bpy.types.Depsgraph, visit: Callable[[bpy.types.DepsgraphObjectInstance, bool], None] | None = None
) -> list[Drawn]:
    """Go once over everything that an evaluated scene shows.

    Args:
        depsgraph: Evaluated scene.
        visit: Called with everything that is met, and whether Gaussians draw it. Instances are lent by Blender until the next
            one: they must not be kept.

    Returns:
        Avatars and clouds in the order of their names; what is instanced is there once for each instance.
    """
    found: list[Drawn] = []
    copies: dict[Cloud, CloudShot] = {}
    for instance in depsgraph.object_instances:
        drawn = drawn_avatar(instance, depsgraph) or drawn_cloud(instance, copies)
        if isinstance(drawn, DrawnCloud) or (drawn is not None and drawn.has_size):
            found.append(drawn)
        if visit is not None:
            visit(instance, drawn is not None)
    return sorted(found, key=lambda drawn: drawn.object.name)


def read_scene(
    depsgraph: bpy.types.Depsgraph,
    camera: Camera | None = None,
    use_meshes: bool = True,
    kept: MeshCache | None = None,
) -> SceneShot:
    """Copy what a render of the depsgraph's moment shows. See `begin_scene`."""
    shot, meshes = begin_scene(depsgraph, camera, use_meshes, kept)
    return shot if meshes is None else replace(shot, occluders=meshes())


def begin_scene(
    depsgraph: bpy.types.Depsgraph,
    camera: Camera | None = None,
    use_meshes: bool = True,
    kept: MeshCache | None = None,
) -> tuple[SceneShot, Callable[[], Occluders] | None]:
    """Copy what a render of the depsgraph's moment shows, but perhaps for the meshes that hide avatars.

    Args:
        depsgraph: Evaluated scene.
        camera: Camera of the picture, beside and behind which meshes do not matter; None for any.
        use_meshes: Meshes hide avatars.
        kept: Triangles of earlier pictures.

    Returns:
        The scene, and what copies its meshes on the same thread before the depsgraph changes; None: it has them, or there are
        none. They may wait until the avatars are being drawn, for only light asks for them earlier.

    Raises:
        FileFormatError: A cloud was damaged by edits.
    """
    view_layer, scene = depsgraph.view_layer, depsgraph.scene_eval
    is_lit = any(avatar.object.grmm.lighting == SCENE_LIGHT for avatar in avatars_shown(depsgraph))
    # what is beside the picture may throw a shadow into it
    reader = OccluderReader(depsgraph, None if is_lit else camera, use_meshes, kept)
    lights = LightReader()

    def visit(instance: bpy.types.DepsgraphObjectInstance, is_drawn: bool) -> None:
        reader.visit(instance, is_drawn)
        lights.visit(instance)

    shown = [drawn for drawn in walk(depsgraph, visit) if is_rendered(drawn.object, view_layer)]
    shots = [drawn.shot(depsgraph) for drawn in shown]
    if is_lit:
        shots = [
            replace(shot, response=lights.linked(shot.response, each.object)) for each, shot in zip(shown, shots, strict=True)
        ]
    replaced = {mesh: shot.holdout for drawn, shot in zip(shown, shots, strict=True) for mesh in drawn.meshes}
    world = None if scene.render.film_transparent else world_color(scene)
    drawn_shots = tuple(shot for shot in shots if not shot.holdout)
    if is_lit or not reader.found:
        occluders = reader.occluders(replaced)
        lighting = lights.lighting(scene, occluders.plain) if is_lit else None
        return SceneShot(drawn_shots, bool(shots), occluders, world, lighting), None
    return SceneShot(drawn_shots, bool(shots), world=world), lambda: reader.occluders(replaced)


def take_frame(
    depsgraph: bpy.types.Depsgraph,
    size: tuple[int, int],
    camera: bpy.types.Object | None = None,
    eye: Eye | None = None,
    use_meshes: bool = True,
    kept: MeshCache | None = None,
) -> Frame:
    """Copy everything that a picture of the depsgraph's moment is made from. See `begin_frame`."""
    frame, meshes = begin_frame(depsgraph, size, camera, eye, use_meshes, kept)
    return frame if meshes is None else replace(frame, scene=replace(frame.scene, occluders=meshes()))


def begin_frame(
    depsgraph: bpy.types.Depsgraph,
    size: tuple[int, int],
    camera: bpy.types.Object | None = None,
    eye: Eye | None = None,
    use_meshes: bool = True,
    kept: MeshCache | None = None,
) -> tuple[Frame, Callable[[], Occluders] | None]:
    """Copy everything that a picture of the depsgraph's moment is made from, but perhaps for meshes, as `begin_scene`.

    Args:
        depsgraph: Evaluated scene.
        size: Width and height of the full picture in pixels.
        camera: As `scene_camera` returns it; the scene's when None.
        eye: Which one, in stereo.
        use_meshes: Meshes hide avatars.
        kept: Triangles of earlier pictures.

    Raises:
        ConfigError: There is no camera, or none that can be used.
        FileFormatError: A cloud was damaged by edits.
    """
    camera = scene_camera(depsgraph) if camera is None else camera
    view = render_camera(depsgraph, camera, *size, eye)
    scene, meshes = begin_scene(depsgraph, view, use_meshes, kept)
    return Frame(scene, view, clip_range(camera)), meshes


def drawn_objects(scene: bpy.types.Scene, instanced: bool = False) -> list[bpy.types.Object]:
    """Return the heads and clouds of a scene that Gaussians draw, visible or not, in the order of their names.

    Args:
        scene: The scene.
        instanced: Also the heads of collections that it shows as instances.
    """
    avatars = avatars_with_instanced(scene) if instanced else avatars_in(scene)
    heads = [avatar.object for avatar in avatars if is_drawn(avatar)]
    return sorted(heads + [cloud.object for cloud in clouds_in(scene)], key=lambda obj: obj.name)
