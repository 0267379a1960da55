"""Meshes for other programs: Wavefront `.obj`, and `.glb` with named morph targets (read and written).

Why not `trimesh`: it is well kept and reads both (the tests use it for that), but its exporter writes no named morph targets,
merges or drops UV seams, and is not in stock Blender. Both formats are a page each. Needs numpy only.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, ShapeError
from ..files.access import atomic_write_bytes
from .glb import ELEMENT_BUFFER, UINT32, GltfReader, GltfWriter

KIND = "glTF mesh file"
_TRIANGLES = 4
_MAX_MORPHS = 4096
_MAX_MORPH_BYTES = 1 << 30
_SPARSE_THRESHOLD = 1e-9  # metres; smaller movements of a morph target are not stored


@dataclass
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: [V, 3] metres.
        faces: [F, 3] vertex indices, or None for points.
        uv: Texture coordinates with v up, [V, 2] (or [U, 2] with `uv_faces`), or None.
        uv_faces: [F, 3] indices into `uv` where it has its own seams, or None.
        morphs: Movement of every vertex at weight 1, [V, 3], by name.
    """

    vertices: np.ndarray
    faces: np.ndarray | None
    uv: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    morphs: dict[str, np.ndarray] = field(default_factory=dict)

    def validated(self) -> Mesh:
        """Return a copy in float32 and int64. Raises `ShapeError` for wrong shapes, indices and values."""
        vertices = np.asarray(self.vertices, np.float32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not vertices.shape[0] or not np.isfinite(vertices).all():
            raise ShapeError(f"Mesh vertices must be finite and of shape [V, 3]; got {vertices.shape}.")
        faces = _indices("faces", self.faces, vertices.shape[0])
        uv = None if self.uv is None else np.asarray(self.uv, np.float32)
        if uv is not None and (uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all()):
            raise ShapeError(f"Texture coordinates must be finite and of shape [U, 2]; got {uv.shape}.")
        uv_faces = None if self.uv_faces is None or uv is None else _indices("uv_faces", self.uv_faces, uv.shape[0])
        if uv is not None and uv_faces is None and uv.shape[0] != vertices.shape[0]:
            raise ShapeError(f"{uv.shape[0]} texture coordinates for {vertices.shape[0]} vertices need uv_faces.")
        if uv_faces is not None and (faces is None or uv_faces.shape != faces.shape):
            raise ShapeError("uv_faces must have the shape of faces.")
        morphs = {str(name): np.asarray(delta, np.float32) for name, delta in self.morphs.items()}
        for name, delta in morphs.items():
            if delta.shape != vertices.shape or not np.isfinite(delta).all():
                raise ShapeError(f"Morph target {name!r} must be finite and of shape {vertices.shape}; got {delta.shape}.")
        return Mesh(vertices, faces, uv, uv_faces, morphs)


def _indices(name: str, faces: np.ndarray | None, count: int) -> np.ndarray | None:
    if faces is None:
        return None
    array = np.asarray(faces, np.int64)
    if array.ndim != 2 or array.shape[1] != 3 or (array.size and (array.min() < 0 or array.max() >= count)):
        raise ShapeError(f"Mesh {name} must be of shape [F, 3] with indices below {count}; got {array.shape}.")
    return array


def write_obj(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Write a Wavefront file: vertices, texture coordinates, triangles. Morph targets do not fit this format and are left out.

    Raises:
        ShapeError: The mesh is malformed.
        FileAccessError: The file cannot be written.
    """
    mesh = mesh.validated()
    text = io.StringIO()
    text.write("# metres, y up, face towards +z\n")
    np.savetxt(text, mesh.vertices, "v %.7g %.7g %.7g")
    if mesh.uv is not None:
        np.savetxt(text, mesh.uv, "vt %.7g %.7g")
    if mesh.faces is not None:
        corners = mesh.faces + 1
        if mesh.uv is None:
            np.savetxt(text, corners, "f %d %d %d")
        else:
            uv = corners if mesh.uv_faces is None else mesh.uv_faces + 1
            np.savetxt(text, np.stack([corners, uv], -1).reshape(-1, 6), "f %d/%d %d/%d %d/%d")
    atomic_write_bytes(path, text.getvalue().encode("ascii"))


def split_seams(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """Give every vertex one texture coordinate by doubling vertices at UV seams.

    Returns:
        The mesh without `uv_faces`, and for each of its vertices the index of the original one, [V'].
    """
    count = mesh.vertices.shape[0]
    if mesh.uv is None or mesh.uv_faces is None or mesh.faces is None:
        return mesh, np.arange(count)
    pairs = mesh.faces.reshape(-1) * mesh.uv.shape[0] + mesh.uv_faces.reshape(-1)
    unique, inverse = np.unique(pairs, return_inverse=True)
    source, uv_index = unique // mesh.uv.shape[0], unique % mesh.uv.shape[0]
    unused = np.setdiff1d(np.arange(count), source)  # vertices of no face keep their place in morph targets
    source = np.concatenate([source, unused])
    uv = np.concatenate([mesh.uv[uv_index], np.zeros((unused.size, 2), np.float32)])
    morphs = {name: delta[source] for name, delta in mesh.morphs.items()}
    return Mesh(mesh.vertices[source], inverse.reshape(-1, 3), uv, None, morphs), source


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals [V, 3] of a triangle mesh; +z where a vertex has no area."""
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for column in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, column], face_normals[:, axis], vertices.shape[0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-20, normals / np.maximum(lengths, 1e-20), np.array([0, 0, 1], normals.dtype))


def write_gltf_mesh(path: str | os.PathLike[str], mesh: Mesh, name: str = "head") -> None:
    """Write a `.glb` with normals, texture coordinates and named morph targets (`extras.targetNames`, as importers expect).

    Morph targets are stored sparsely: only vertices that move.

    Raises:
        ShapeError: The mesh is malformed.
        FileAccessError: The file cannot be written.
    """
    mesh, _ = split_seams(mesh.validated())
    writer = GltfWriter()
    attributes = {"POSITION": writer.add_array(mesh.vertices, bounds=True)}
    primitive: dict[str, Any] = {"attributes": attributes, "mode": _TRIANGLES if mesh.faces is not None else 0}
    if mesh.faces is not None:
        attributes["NORMAL"] = writer.add_array(vertex_normals(mesh.vertices, mesh.faces))
        primitive["indices"] = writer.add_array(mesh.faces.reshape(-1), ELEMENT_BUFFER)
    if mesh.uv is not None:
        attributes["TEXCOORD_0"] = writer.add_array(mesh.uv * [1, -1] + [0, 1])  # glTF's v points down
    entry: dict[str, Any] = {"primitives": [primitive], "name": name}
    if mesh.morphs:
        primitive["targets"] = [{"POSITION": _add_sparse(writer, delta)} for delta in mesh.morphs.values()]
        entry["weights"] = [0.0] * len(mesh.morphs)
        entry["extras"] = {"targetNames": list(mesh.morphs)}
    primitive["material"] = writer.add(
        "materials", {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.6, 0.5, 1.0], "metallicFactor": 0.0}}
    )
    node = writer.add("nodes", {"mesh": writer.add("meshes", entry), "name": name})
    writer.add("scenes", {"nodes": [node]})
    writer.document["scene"] = 0
    writer.write(path)


def _add_sparse(writer: GltfWriter, delta: np.ndarray) -> int:
    """A morph target as a sparse accessor over zeros."""
    rows = np.flatnonzero((np.abs(delta) > _SPARSE_THRESHOLD).any(1))
    if rows.size == 0:
        rows = np.zeros(1, np.int64)  # a sparse accessor may not be empty
    full = np.zeros_like(delta)
    full[rows] = delta[rows]
    entry = {
        "componentType": 5126,
        "count": int(delta.shape[0]),
        "type": "VEC3",
        "min": full.min(0).astype(float).tolist(),
        "max": full.max(0).astype(float).tolist(),
        "sparse": {
            "count": int(rows.size),
            "indices": {"bufferView": writer.add_bytes(rows.astype("<u4").tobytes()), "componentType": UINT32},
            "values": {"bufferView": writer.add_bytes(np.ascontiguousarray(delta[rows], "<f4").tobytes())},
        },
    }
    return writer.add("accessors", entry)


def read_gltf_mesh(path: Path, data: bytes | None = None) -> Mesh:
    """Read the first mesh of a `.glb` with its morph targets and their names.

    Args:
        path: The file, or the archive that `data` came from.
        data: The file's bytes where they were read elsewhere.

    Raises:
        FileFormatError: Damaged, or without a mesh.
        FileAccessError: Missing or unreadable.
    """
    reader = GltfReader(path, data, KIND)
    entry = reader.item("meshes", 0)
    primitives = entry.get("primitives")
    if not isinstance(primitives, list) or not primitives or not isinstance(primitives[0], dict):
        raise reader.bad("its mesh has no primitive")
    primitive = primitives[0]
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        raise reader.bad("its mesh has no attributes")
    vertices = _vectors(reader, attributes.get("POSITION"), 3)
    faces = _faces(reader, primitive, vertices.shape[0])
    uv = None
    if "TEXCOORD_0" in attributes:
        uv = _vectors(reader, attributes["TEXCOORD_0"], 2, vertices.shape[0]) * np.array([1, -1], np.float32) + [0, 1]
    targets = primitive.get("targets", [])
    if not isinstance(targets, list) or len(targets) > _MAX_MORPHS or not all(isinstance(t, dict) for t in targets):
        raise reader.bad("its morph targets are malformed")
    if len(targets) * vertices.nbytes > _MAX_MORPH_BYTES:  # a file may name one array thousands of times
        raise reader.bad(f"its {len(targets)} morph targets would take more than {_MAX_MORPH_BYTES} bytes")
    names = _target_names(entry, primitive, len(targets))
    morphs = {
        name: _vectors(reader, target["POSITION"], 3, vertices.shape[0])
        for name, target in zip(names, targets, strict=True)
        if "POSITION" in target
    }
    mesh = Mesh(vertices, faces, None if uv is None else uv.astype(np.float32), None, morphs)
    try:
        return mesh.validated()
    except ShapeError as error:
        raise FileFormatError(f"{path} has a mesh with values that are not finite; export it again.") from error


def _vectors(reader: GltfReader, index: Any, width: int, count: int | None = None) -> np.ndarray:
    values = reader.accessor(index)
    if values.ndim != 2 or values.shape[1] != width or (count is not None and values.shape[0] != count):
        raise reader.bad("an attribute of its mesh has another shape than its positions")
    return values.astype(np.float32)


def _faces(reader: GltfReader, primitive: dict[str, Any], count: int) -> np.ndarray | None:
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        return None
    if "indices" in primitive:
        indices = reader.accessor(primitive["indices"])
        if indices.ndim != 1 or indices.dtype.kind != "u":
            raise reader.bad("its triangles are malformed")
        indices = indices.astype(np.int64)
    else:
        indices = np.arange(count)
    if indices.size % 3 or (indices.size and indices.max() >= count):
        raise reader.bad("its triangles refer to vertices that it does not have")
    return indices.reshape(-1, 3)


def _target_names(entry: dict[str, Any], primitive: dict[str, Any], count: int) -> list[str]:
    """Names of morph targets from `extras`, or numbers."""
    for place in (entry, primitive):
        extras = place.get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        if isinstance(names, list) and len(names) == count and len(set(map(str, names))) == count:
            return [str(name)[:200] for name in names]
    return [f"target_{i}" for i in range(count)]


def make_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray | None = None,
    uv_faces: np.ndarray | None = None,
    morphs: Mapping[str, np.ndarray] | None = None,
) -> Mesh:
    """Gather arrays to a validated `Mesh`. Raises `ShapeError`."""
    return Mesh(vertices, faces, uv, uv_faces, dict(morphs or {})).validated()
