"""Meshes in glTF: `.glb` with named morph targets, read and written. Needs numpy only."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, ShapeError
from ...files.format import Format
from ..glb import ELEMENT_BUFFER, UINT32, GltfReader, GltfWriter
from .mesh import Mesh, split_seams, vertex_normals

KIND = "glTF mesh file"
_TRIANGLES = 4
_MAX_MORPHS = 4096
_MAX_MORPH_BYTES = 1 << 30
_SPARSE_THRESHOLD = 1e-9  # metres; smaller movements of a morph target are not stored


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
        primitive["targets"] = [{"POSITION": add_morph_target(writer, delta)} for delta in mesh.morphs.values()]
        entry["weights"] = [0.0] * len(mesh.morphs)
        entry["extras"] = {"targetNames": list(mesh.morphs)}
    primitive["material"] = writer.add(
        "materials", {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.6, 0.5, 1.0], "metallicFactor": 0.0}}
    )
    node = writer.add("nodes", {"mesh": writer.add("meshes", entry), "name": name})
    writer.add("scenes", {"nodes": [node]})
    writer.document["scene"] = 0
    writer.write(path)


def add_morph_target(writer: GltfWriter, delta: np.ndarray, threshold: float = _SPARSE_THRESHOLD) -> int:
    """Add a morph target [V, 3] as a sparse accessor over zeros, without moves below a threshold, and return its index."""
    rows = np.flatnonzero((np.abs(delta) > threshold).any(1))
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


FORMAT = Format(
    "gltf-mesh", "glTF mesh (.glb)", "The mesh with the expressions as named morph targets", "mesh",
    (".glb",), read_gltf_mesh, write_gltf_mesh, shared_suffixes=(".gltf",), morphs=True,
)  # fmt: skip
