"""Triangle meshes in memory, as the readers and writers of this package pass them on.

Why not `trimesh` for the files: it is well kept and reads both (the tests use it for that), but its exporter writes no named
morph targets, merges or drops UV seams, and is not in stock Blender. Both formats are a page each. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...errors import ShapeError
from ...geometry import triangles


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

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        faces = 0 if self.faces is None else len(self.faces)
        return {"vertices": len(self.vertices), "faces": faces, "morph targets": list(self.morphs)}

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
    normals = triangles.vertex_normals(vertices, faces)
    return np.where(normals.any(axis=1, keepdims=True), normals, np.array([0, 0, 1], normals.dtype))
