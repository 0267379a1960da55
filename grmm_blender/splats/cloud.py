"""A splat cloud as plain arrays: what the engine and the viewport draw.

`Cloud` wraps a cloud object; `Cloud.shot` copies what a picture needs out of the evaluated scene, in head axes (y up), so that
a cloud is placed like an avatar: world = matrix_world @ HEAD_TO_BLENDER. Imports neither torch nor the session's model.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.errors import FileFormatError
from ...grmm_core.formats.avatars.binding import bind_to_mesh, place_on_mesh
from ...grmm_core.formats.splats.cloud import SplatCloud
from ...grmm_core.geometry.rotations import multiply_quaternions
from ...grmm_core.session import HEAD_TO_BLENDER, CloudArrays
from ...grmm_core.session.values import CLOUD_TERMS
from ..wrapper import ObjectWrapper

POSITION, ROTATION, SCALE, OPACITY, TRIANGLE = "position", "rotation", "scale", "opacity", "triangle"
HARMONIC = "sh_"
_WIDTHS = {"FLOAT_VECTOR": (3, "vector"), "QUATERNION": (4, "value"), "FLOAT": (1, "value"), "INT": (1, "value")}
_HALF = 0.5**0.5
# A quarter turn about x brings Blender's axes (z up) to head axes (y up): (x, y, z) -> (x, z, -y).
_TO_HEAD = np.array([_HALF, -_HALF, 0.0, 0.0], np.float32)
_TO_BLENDER = np.array([_HALF, _HALF, 0.0, 0.0], np.float32)
_RESTING_KEPT = 8
_resting: dict[tuple[int, str], SplatCloud] = {}
"""Splats in the frames of their triangles, by object and version: they change only when the resting cloud is edited."""


@dataclass(frozen=True)
class CloudShot:
    """A cloud as it is in one frame; refers to none of Blender's data.

    Attributes:
        key: Identifies the cloud object for as long as the file is open.
        version: Changes when the Gaussians do.
        arrays: The Gaussians, head axes.
    """

    key: str
    version: str
    arrays: CloudArrays


class Cloud(ObjectWrapper):
    """The splat cloud of a mesh object."""

    @property
    def key(self) -> str:
        """Identifies the object for as long as the file is open, also across undo."""
        return f"cloud {self.object.session_uid}"

    @property
    def carrier(self) -> bpy.types.Object | None:
        """Mesh that moves the splats, or None."""
        return self.object.grmm_cloud.carrier

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return len(self.object.data.vertices)

    def shot(self, depsgraph: bpy.types.Depsgraph) -> CloudShot:
        """Copy the Gaussians of the depsgraph's moment.

        Raises:
            FileFormatError: An attribute or the carrier was removed, or the carrier's mesh is another one by now.
        """
        mesh = self.object.evaluated_get(depsgraph).data
        raw = self._raw(mesh)
        version = _checksum(*raw.values())
        carrier = self.carrier
        if carrier is None:
            return CloudShot(self.key, version, _in_head_axes(raw))
        posed = mesh_positions(carrier.evaluated_get(depsgraph).data)
        placed = self._carried(carrier, raw, version, posed)
        return CloudShot(self.key, version + _checksum(posed), placed)

    def placement(self, matrix_world: np.ndarray) -> np.ndarray:
        """Return head axes to world for an instance of the object (or of its carrier) with this matrix, [4, 4]."""
        return np.asarray(matrix_world, np.float64) @ HEAD_TO_BLENDER

    def splats(self, depsgraph: bpy.types.Depsgraph) -> SplatCloud:
        """Return the Gaussians as exporters take them, in the object's own space with y up. Raises as `shot`."""
        found = self.shot(depsgraph).arrays
        return SplatCloud(found.means, found.quats, found.scales, np.clip(found.opacities, 0.0, 1.0), found.harmonics)

    def resting(self) -> SplatCloud:
        """Return the Gaussians as they were imported or last edited, whatever moves them, as `splats` does."""
        found = _in_head_axes(self._raw(self.object.data))
        return SplatCloud(found.means, found.quats, found.scales, np.clip(found.opacities, 0.0, 1.0), found.harmonics)

    def binding(self) -> np.ndarray:
        """Return the carrier's triangle of each Gaussian, [N] int32. Raises `FileFormatError` for a free cloud."""
        if TRIANGLE not in self.object.data.attributes:
            raise FileFormatError(f"{self.name} is not bound to a mesh; export it as splats.")
        return read_attribute(self.object.data, TRIANGLE).astype(np.int32)

    def _raw(self, mesh: bpy.types.Mesh) -> dict[str, np.ndarray]:
        """Attributes of a mesh by name, in Blender's axes, with the harmonics under "sh" [N, K, 3]."""
        wanted = [POSITION, ROTATION, SCALE, OPACITY]
        terms = 0
        while f"{HARMONIC}{terms}" in mesh.attributes:
            terms += 1
        terms = max((count for count in CLOUD_TERMS if count <= terms), default=0)
        missing = [name for name in wanted if name not in mesh.attributes] + ([] if terms else [f"{HARMONIC}0"])
        if missing or not len(mesh.vertices):
            lost = f"the attribute {missing[0]!r}" if missing else "its points"
            raise FileFormatError(f"{self.name} has lost {lost} and cannot be drawn as splats; import it again.")
        raw = {name: read_attribute(mesh, name) for name in wanted}
        raw["sh"] = np.stack([read_attribute(mesh, f"{HARMONIC}{k}") for k in range(terms)], 1)
        if self.carrier is not None:
            if TRIANGLE not in mesh.attributes:
                raise FileFormatError(f"{self.name} has lost the attribute {TRIANGLE!r} that binds it; import it again.")
            raw[TRIANGLE] = read_attribute(mesh, TRIANGLE).astype(np.int32)
        return raw

    def _carried(self, carrier: bpy.types.Object, raw: dict[str, np.ndarray], version: str, posed: np.ndarray) -> CloudArrays:
        """Move resting splats with the triangles of the carrier, whose posed vertices are `posed` [V, 3] in Blender's axes."""
        resting, faces = resting_positions(carrier.data), triangles(carrier.data)
        if posed.shape != resting.shape or int(raw[TRIANGLE].max(initial=0)) >= len(faces):
            raise FileFormatError(
                f"{carrier.name} has other vertices or triangles than {self.name} was bound to; undo its edits."
            )
        key = (self.object.session_uid, version + _checksum(resting))
        local = _resting.get(key)
        if local is None:
            while len(_resting) >= _RESTING_KEPT:
                _resting.pop(next(iter(_resting)))
            free = SplatCloud(raw[POSITION], raw[ROTATION], raw[SCALE], raw[OPACITY], raw["sh"])
            local = _resting[key] = bind_to_mesh(free, resting, faces, raw[TRIANGLE])
        moved = place_on_mesh(local, posed, faces)
        return _in_head_axes(
            {POSITION: moved.means, ROTATION: moved.quats, SCALE: moved.scales, OPACITY: raw[OPACITY], "sh": raw["sh"]}
        )


def is_cloud(obj: bpy.types.Object | None) -> bool:
    """Whether an object is a splat cloud."""
    return obj is not None and obj.type == "MESH" and obj.grmm_cloud.is_cloud


def carries_splats(obj: bpy.types.Object) -> bool:
    """Whether an object moves splats and is not drawn itself."""
    return obj.grmm_cloud.carries


def forget() -> None:
    """Drop what is kept between frames; called when another file is opened."""
    _resting.clear()


def read_attribute(mesh: bpy.types.Mesh, name: str) -> np.ndarray:
    """Values of a point attribute, [N] or [N, width]."""
    attribute = mesh.attributes[name]
    width, field = _WIDTHS[attribute.data_type]
    values = np.empty(len(mesh.vertices) * width, np.int32 if attribute.data_type == "INT" else np.float32)
    attribute.data.foreach_get(field, values)
    return values if width == 1 else values.reshape(-1, width)


def write_attribute(mesh: bpy.types.Mesh, name: str, data_type: str, values: np.ndarray) -> None:
    """Store a point attribute, made where it is missing."""
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, data_type, "POINT")
    kind = np.int32 if data_type == "INT" else np.float32
    attribute.data.foreach_set(_WIDTHS[data_type][1], np.ascontiguousarray(values, kind).ravel())


def mesh_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Vertices of a mesh, [V, 3]."""
    return read_attribute(mesh, POSITION)


def resting_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Vertices of a mesh before its shape keys, [V, 3]."""
    if mesh.shape_keys is None:
        return mesh_positions(mesh)
    values = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.shape_keys.reference_key.points.foreach_get("co", values)
    return values.reshape(-1, 3)


def triangles(mesh: bpy.types.Mesh) -> np.ndarray:
    """Corners of a mesh that has triangles only, [F, 3]. Raises `FileFormatError` for other faces."""
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    if len(corners) != 3 * len(mesh.polygons):
        raise FileFormatError(f"The mesh {mesh.name} has faces that are no triangles and cannot carry splats; undo its edits.")
    return corners.reshape(-1, 3)


def to_blender_axes(cloud: SplatCloud) -> dict[str, np.ndarray]:
    """Positions and rotations of a cloud with y up, in Blender's axes."""
    return {
        POSITION: np.stack([cloud.means[:, 0], -cloud.means[:, 2], cloud.means[:, 1]], -1),
        ROTATION: multiply_quaternions(np.broadcast_to(_TO_BLENDER, cloud.quats.shape), cloud.quats),
    }


def _in_head_axes(raw: dict[str, np.ndarray]) -> CloudArrays:
    position = raw[POSITION]
    means = np.stack([position[:, 0], position[:, 2], -position[:, 1]], -1)
    quats = multiply_quaternions(np.broadcast_to(_TO_HEAD, raw[ROTATION].shape), raw[ROTATION])
    return CloudArrays(means, quats, raw[SCALE], raw[OPACITY], raw["sh"])


def _checksum(*arrays: np.ndarray) -> str:
    value = 0
    for array in arrays:
        value = zlib.crc32(np.ascontiguousarray(array).data, value)
    return f"{value:08x}"
