"""What a scene shows as Gaussians: avatars and splat clouds, copied into plain values, and their Gaussians in the world.

`shots_in` runs on the main thread, `world_gaussians` on any.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.controls.frame import Controls
from ...grmm_core.errors import GrmmError
from ...grmm_core.geometry.camera import Camera
from ...grmm_core.session import CloudArrays
from ...grmm_core.session.harmonics import harmonic_basis
from .. import session_host
from ..engine.snapshot import AvatarShot
from ..scene.avatars import instances_in
from ..splats import clouds_in
from ..splats.cloud import carries_splats, cloud_instances
from .arrays import WorldGaussians

__all__ = ["SceneShots", "clouds_in", "shots_in", "view_direction", "world_gaussians"]

HEAD_CENTRE = np.zeros(3)  # what a view direction points from, head space
_EDIT_MODES = {"EDIT", "SCULPT", "VERTEX_PAINT", "WEIGHT_PAINT", "TEXTURE_PAINT"}
_SOLID_DISPLAYS = {"SOLID", "TEXTURED"}
_CHUNK = 1 << 17  # Gaussians whose harmonics are evaluated at once: bounds memory


@dataclass(frozen=True)
class SceneShots:
    """What one viewport shows.

    Attributes:
        shots: Avatars and clouds.
        meshes: World triangles of each of their meshes that Blender draws too, [T, 3, 3] float64. Splats hide these.
        message: One sentence about what cannot be shown, or empty.
    """

    shots: tuple[AvatarShot, ...] = ()
    meshes: tuple[np.ndarray, ...] = ()
    message: str = ""


def shots_in(depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D) -> SceneShots:
    """Copy what a viewport shows. Objects that are being edited are left as meshes."""
    found: list[AvatarShot] = []
    meshes: list[np.ndarray] = []
    message = ""

    def visible(obj: bpy.types.Object) -> bool:
        return obj.mode not in _EDIT_MODES and obj.visible_in_viewport_get(space)

    for avatar, placement in instances_in(depsgraph):
        head = avatar.object
        if carries_splats(head) or not visible(head):
            continue
        found.append(AvatarShot(head.name, avatar.source, avatar.controls(depsgraph), placement))
        meshes += _drawn_triangles(head, depsgraph)
    shots = {}
    for cloud, placement in cloud_instances(depsgraph):
        if not visible(cloud.object):
            continue
        try:
            if cloud not in shots:
                shots[cloud] = cloud.shot(depsgraph)
        except GrmmError as error:
            message = str(error)
            continue
        found.append(AvatarShot(cloud.name, "", Controls(), placement, cloud=shots[cloud]))
        if cloud.carrier is not None and visible(cloud.carrier):
            meshes += _drawn_triangles(cloud.carrier, depsgraph)
    found.sort(key=lambda shot: shot.name)
    return SceneShots(tuple(found), tuple(meshes), message)


def view_direction(shot: AvatarShot, camera: Camera) -> np.ndarray:
    """Unit vector from an avatar towards the camera in the avatar's space, [3]."""
    return camera.transformed(shot.model_to_world).view_direction(HEAD_CENTRE)


def world_gaussians(shot: AvatarShot, camera: Camera, lod: int) -> WorldGaussians:
    """Return an avatar's or a cloud's Gaussians with the colors that a camera sees.

    Raises:
        GrmmError: The avatar or the session cannot be used.
    """
    if shot.cloud is not None:
        arrays = _thinned(shot.cloud.arrays, lod)
        colors = _cloud_colors(arrays, camera.transformed(shot.model_to_world))
        return WorldGaussians.place(arrays.means, arrays.quats, arrays.scales, arrays.opacities, colors, shot.model_to_world)
    info = session_host.open_avatar(shot.source)
    direction = view_direction(shot, camera)
    found = session_host.get_session().gaussians(info.id, shot.controls.validate(), direction, lod)
    return WorldGaussians.place(found.means, found.quats, found.scales, found.opacities, found.colors, shot.model_to_world)


def _thinned(arrays: CloudArrays, lod: int) -> CloudArrays:
    """Return an even part of a cloud, a quarter for each level, of larger Gaussians."""
    if not lod:
        return arrays
    step, growth = 4**lod, 2.0**lod
    return CloudArrays(
        arrays.means[::step],
        arrays.quats[::step],
        arrays.scales[::step] * np.float32(growth),
        arrays.opacities[::step],
        arrays.harmonics[::step],
    )


def _cloud_colors(arrays: CloudArrays, camera: Camera) -> np.ndarray:
    """Colors [N, 3] of a cloud as a camera in the cloud's space sees them."""
    degree = round(arrays.harmonics.shape[1] ** 0.5) - 1
    colors = np.empty((len(arrays.means), 3), np.float32)
    for start in range(0, len(colors), _CHUNK):
        part = slice(start, start + _CHUNK)
        offsets = arrays.means[part] - camera.position
        if camera.orthographic:
            offsets = np.broadcast_to(camera.forward, offsets.shape)
        basis = harmonic_basis(offsets / np.linalg.norm(offsets, axis=-1, keepdims=True).clip(1e-12), degree)  # [N, K]
        colors[part] = np.einsum("nk,nkc->nc", basis.astype(np.float32), arrays.harmonics[part]) + 0.5
    return colors.clip(0.0)


def _drawn_triangles(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[np.ndarray]:
    """World triangles of a mesh that the viewport draws as a surface, or nothing."""
    if obj.display_type not in _SOLID_DISPLAYS:
        return []
    evaluated = obj.evaluated_get(depsgraph)
    mesh = evaluated.data
    mesh.calc_loop_triangles()
    indices = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.loop_triangles.foreach_get("vertices", indices)
    positions = np.empty(len(mesh.vertices) * 3, np.float32)
    if not len(indices):
        return []
    mesh.attributes["position"].data.foreach_get("vector", positions)
    matrix = np.array(evaluated.matrix_world, np.float64)
    world = positions.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return [world[indices.reshape(-1, 3)]]
