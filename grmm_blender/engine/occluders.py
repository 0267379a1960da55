"""Scene meshes that hide avatars: from evaluated objects to world triangles.

Everything that Blender can turn into a mesh counts (curves, text, metaballs, instances), as it is at render time; the
avatars' own head meshes do not.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...grmm_core.camera import Camera
from .collect import Collected
from .snapshot import Occluders

_MESH_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


class MeshCache:
    """Triangles of objects, kept between the updates of a viewport, so that an update costs what changed.

    One for each viewport. Instances are not kept: what geometry nodes generate changes under one name.
    """

    def __init__(self) -> None:
        self._triangles: dict[int, np.ndarray] = {}  # by session uid of the object

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Drop what an update of the depsgraph has changed. Changed data is there with every object that uses it."""
        for update in depsgraph.updates:
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._triangles.pop(update.id.original.session_uid, None)

    def get(self, candidate: bpy.types.Object) -> np.ndarray:
        """Return the triangles of an evaluated object, [T, 3, 3] in its own space."""
        key = candidate.original.session_uid
        if key not in self._triangles:
            self._triangles[key] = _triangles(candidate)
        return self._triangles[key]


def collect(
    depsgraph: bpy.types.Depsgraph,
    camera: Camera | None,
    avatars: list[Collected],
    use_scene: bool = True,
    kept: MeshCache | None = None,
) -> Occluders:
    """Return the triangles of all visible meshes that touch the picture.

    Args:
        depsgraph: Evaluated scene.
        camera: Camera of the picture: what lies wholly beside or behind it is left out; None keeps everything.
        avatars: Avatars of the depsgraph. Their meshes hide nothing, but those of holdout avatars cut.
        use_scene: Other meshes hide avatars as well.
        kept: Triangles of earlier calls.
    """
    avatar_objects = {name for avatar in avatars for name in avatar.object_names}
    holdout_objects = {name for avatar in avatars if avatar.shot.holdout for name in avatar.object_names}
    if not use_scene and not holdout_objects:
        return Occluders()
    view_layer = depsgraph.view_layer
    cache: dict[int, np.ndarray] = {}
    plain: list[np.ndarray] = []
    holdouts: list[np.ndarray] = []
    for instance in depsgraph.object_instances:
        candidate = instance.object
        if candidate.type not in _MESH_TYPES or not instance.show_self or not candidate.visible_camera:
            continue
        original = candidate.original
        is_avatar = original.name in avatar_objects
        if original.name not in holdout_objects if is_avatar else not use_scene:
            continue
        # What an instance may hide follows from the object that stands in the scene.
        owner = (instance.parent or candidate).original if instance.is_instance else original
        if owner.indirect_only_get(view_layer=view_layer):
            continue
        matrix = np.array(instance.matrix_world, np.float64)
        box = np.array(candidate.bound_box, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        if camera is not None and not _touches(camera, box):
            continue
        # Instances of one object share its mesh.
        key = candidate.as_pointer()
        if kept is not None and not instance.is_instance:
            local = kept.get(candidate)
        else:
            if key not in cache:
                cache[key] = _triangles(candidate)
            local = cache[key]
        if not len(local):
            continue
        world = (local.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32).reshape(-1, 3, 3)
        holdout = is_avatar or original.is_holdout or owner.is_holdout or owner.holdout_get(view_layer=view_layer)
        (holdouts if holdout else plain).append(world)
    empty = np.zeros((0, 3, 3), np.float32)
    return Occluders(np.concatenate([empty, *plain]), np.concatenate([empty, *holdouts]))


def _touches(camera: Camera, corners: np.ndarray) -> bool:
    """Return whether a box, world corners [8, 3], may be seen; boxes without size (all zero) always may."""
    local = corners @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    if np.ptp(corners, axis=0).max() == 0:
        return True
    if (local[:, 2] <= 0).all():
        return False
    if not camera.orthographic and (local[:, 2] <= 0).any():
        return True
    divisor = 1.0 if camera.orthographic else local[:, 2]
    x = camera.fx * local[:, 0] / divisor + camera.cx
    y = camera.fy * local[:, 1] / divisor + camera.cy
    return bool(x.max() >= 0 and x.min() <= camera.width and y.max() >= 0 and y.min() <= camera.height)


def _triangles(item: bpy.types.Object) -> np.ndarray:
    """Return an evaluated object's triangles in its own space, [T, 3, 3]."""
    try:
        mesh = item.to_mesh()
    except RuntimeError:  # objects that have no geometry, such as an empty curve
        return np.zeros((0, 3, 3), np.float32)
    if mesh is None:
        return np.zeros((0, 3, 3), np.float32)
    try:
        mesh.calc_loop_triangles()
        count = len(mesh.loop_triangles)
        indices = np.empty(count * 3, np.int32)
        mesh.loop_triangles.foreach_get("vertices", indices)
        positions = np.empty(len(mesh.vertices) * 3, np.float32)
        if len(positions):
            mesh.attributes["position"].data.foreach_get("vector", positions)
        return positions.reshape(-1, 3)[indices.reshape(-1, 3)]
    finally:
        item.to_mesh_clear()
