"""Scene meshes that hide avatars: from evaluated objects to triangles.

Everything that Blender can turn into a mesh counts (curves, text, metaballs, instances), as it is at render time; the
avatars' own head meshes do not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.geometry.camera import Camera
from ..splats.cloud import carries_splats
from .shot import Occluder, Occluders
from .visibility import is_holdout, is_rendered

MESH_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
SOLID_DISPLAYS = {"SOLID", "TEXTURED"}

_Key = tuple[int, int]


class MeshCache:
    """Triangles of objects, kept between pictures, so that a picture costs what changed.

    A viewport hears of changes. A final render does not: every frame may have another depsgraph. Then the evaluated mesh is
    compared with the one that the triangles were made from, in a tenth of the time that making them takes.
    """

    def __init__(self) -> None:
        self._kept: dict[_Key, _Mesh] = {}
        self._trusted: set[_Key] = set()  # need no comparison
        self._used: set[_Key] = set()  # by the present picture

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Compare again what an update of the depsgraph has changed. Changed data is there with every object that uses it."""
        for update in depsgraph.updates:
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._trusted.discard((update.id.original.session_uid, 0))

    def doubt(self) -> None:
        """Compare everything again."""
        self._trusted.clear()

    def forget(self) -> None:
        """Drop everything."""
        self._kept.clear()
        self._trusted.clear()
        self._used.clear()

    def get(self, candidate: bpy.types.Object, number: int = 0) -> np.ndarray:
        """Return the triangles of an evaluated object, [T, 3, 3] in its own space; the same array while it is the same mesh.

        Args:
            candidate: The object.
            number: 0 for the object itself; else which one of the meshes that it generates, always compared.
        """
        key = (candidate.original.session_uid, number)
        self._used.add(key)
        if key not in self._trusted:
            known = self._kept.get(key)
            self._kept[key] = _read(candidate, known)
            if number == 0:
                self._trusted.add(key)
        return self._kept[key].triangles

    def drop_unused(self) -> None:
        """Drop what no `get` has asked for since the last call."""
        for key in self._kept.keys() - self._used:
            del self._kept[key]
        self._trusted &= self._used
        self._used.clear()


@dataclass(frozen=True)
class _Mesh:
    """Triangles, and what they were made from: [V * 3] positions, vertex of each corner, first corner of each face."""

    triangles: np.ndarray
    positions: np.ndarray
    corners: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True)
class _Found:
    """A mesh that touches the picture.

    Attributes:
        triangles: Reads them.
        matrix: Places it in the world.
        cuts: It is a holdout.
        carrier: Object whose cloud may take its place.
    """

    triangles: Callable[[], np.ndarray]
    matrix: np.ndarray
    cuts: bool
    carrier: bpy.types.Object | None


class OccluderReader:
    """Finds the meshes that touch a picture while `walk` goes over the scene, and copies them afterwards."""

    def __init__(
        self,
        depsgraph: bpy.types.Depsgraph,
        camera: Camera | None = None,
        use_scene: bool = True,
        kept: MeshCache | None = None,
    ) -> None:
        """Prepare for one pass.

        Args:
            depsgraph: Evaluated scene; its view layer says what is a holdout.
            camera: Camera of the picture: what lies wholly beside or behind it is left out; None keeps everything.
            use_scene: Meshes hide avatars. The meshes in whose place Gaussians are drawn never do, but holdouts among them cut.
            kept: Triangles of earlier pictures.
        """
        self._depsgraph, self._view_layer = depsgraph, depsgraph.view_layer
        self._camera, self._use_scene = camera, use_scene
        self._kept = MeshCache() if kept is None else kept
        self._generated: dict[_Key, np.ndarray] = {}  # of instances, by object and mesh
        self._meshes_of: Counter[int] = Counter()
        self._found: list[_Found] = []  # in the order of the pass, for a carrier's cloud may come after it

    def visit(self, instance: bpy.types.DepsgraphObjectInstance, is_drawn: bool) -> None:
        """Note a mesh.

        Args:
            instance: Anything of the evaluated scene.
            is_drawn: Gaussians are drawn in its place.
        """
        candidate = instance.object
        if candidate.type not in MESH_TYPES or not instance.show_self or not candidate.visible_camera:
            return
        view_layer, original = self._view_layer, candidate.original
        replaced = is_drawn and is_rendered(original, view_layer)
        carries = not replaced and candidate.type == "MESH" and carries_splats(original)
        if not is_holdout(original, view_layer) if replaced else not (self._use_scene or carries):
            return
        # What an instance may hide follows from the object that stands in the scene.
        owner = (instance.parent or candidate).original if instance.is_instance else original
        if owner.indirect_only_get(view_layer=view_layer):
            return
        matrix = np.array(instance.matrix_world, np.float64)
        box = np.array(candidate.bound_box, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        if self._camera is not None and not _touches(self._camera, box):
            return
        cuts = replaced or original.is_holdout or is_holdout(owner, view_layer)
        self._found.append(_Found(self._triangles(instance), matrix, cuts, original if carries else None))

    @property
    def found(self) -> bool:
        """Whether there may be any."""
        return bool(self._found)

    def occluders(self, replaced: dict[bpy.types.Object, bool]) -> Occluders:
        """Copy and return them, after the pass and before the depsgraph changes.

        Args:
            replaced: Mesh objects in whose place Gaussians are drawn, and whether these are a holdout.
        """
        plain: list[Occluder] = []
        holdouts: list[Occluder] = []
        for mesh in self._found:
            cuts, known = mesh.cuts, mesh.carrier is not None and mesh.carrier in replaced
            if known and not replaced[mesh.carrier]:
                continue
            if mesh.carrier is not None and not known and not self._use_scene:
                continue
            triangles = mesh.triangles()
            if len(triangles):
                (holdouts if known or cuts else plain).append(Occluder(triangles, mesh.matrix))
        self._kept.drop_unused()
        return Occluders(tuple(plain), tuple(holdouts))

    def _triangles(self, instance: bpy.types.DepsgraphObjectInstance) -> Callable[[], np.ndarray]:
        candidate, original = instance.object, instance.object.original
        if not instance.is_instance and candidate.type == original.type == "MESH":
            # what the pass lends is somebody else's with the next object, also where it is no instance
            return lambda: self._kept.get(original.evaluated_get(self._depsgraph))
        if not instance.is_instance:
            triangles = self._kept.get(candidate)
            return lambda: triangles
        # All instances are lent one object of Blender's in turn: what tells meshes apart is their data.
        key = (original.session_uid, candidate.data.as_pointer())
        if key not in self._generated:
            self._meshes_of[key[0]] += 1
            self._generated[key] = self._kept.get(candidate, self._meshes_of[key[0]])
        return lambda: self._generated[key]


def drawn_triangles(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Occluder | None:
    """Return the surface of a mesh object that solid viewports draw, None where they draw none."""
    if obj.display_type not in SOLID_DISPLAYS:
        return None
    evaluated = obj.evaluated_get(depsgraph)
    triangles = _read(evaluated, None).triangles
    return Occluder(triangles, np.array(evaluated.matrix_world, np.float64)) if len(triangles) else None


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


def _read(item: bpy.types.Object, known: _Mesh | None) -> _Mesh:
    """Return an evaluated object's triangles, those of `known` if nothing has changed."""
    try:
        mesh = item.to_mesh()
    except RuntimeError:  # objects that have no geometry, such as an empty curve
        return _NOTHING
    if mesh is None:
        return _NOTHING
    try:
        if not len(mesh.polygons):
            return _NOTHING
        positions = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.attributes["position"].data.foreach_get("vector", positions)
        corners, faces = np.empty(len(mesh.loops), np.int32), np.empty(len(mesh.polygons), np.int32)
        mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
        mesh.polygons.foreach_get("loop_start", faces)
        if known is not None and all(
            np.array_equal(one, other)
            for one, other in ((known.positions, positions), (known.corners, corners), (known.faces, faces))
        ):
            return known
        mesh.calc_loop_triangles()
        indices = np.empty(len(mesh.loop_triangles) * 3, np.int32)
        mesh.loop_triangles.foreach_get("vertices", indices)
        return _Mesh(positions.reshape(-1, 3)[indices.reshape(-1, 3)], positions, corners, faces)
    finally:
        item.to_mesh_clear()


_NOTHING = _Mesh(np.zeros((0, 3, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32))
