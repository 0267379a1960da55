"""Splats that ride on triangles, as in GaussianAvatars and CAP4D.

Each splat is given in the frame of one triangle: p = s (R x) + c, scale = s exp(log scale), q = q_R q, with c the mean of the
corners, R's columns a0 = norm(v1 - v0), a1 = norm(a0 x (v2 - v0)), a2 = -norm(a1 x a0), and s the mean of the first edge and
the height over it. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import ShapeError
from ...geometry.rotations import matrix_to_quaternion, multiply_quaternions
from ..splats.cloud import SplatCloud

_TINY = 1e-20


def triangle_frames(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames of triangles.

    Args:
        vertices: [V, 3] metres.
        faces: [F, 3].

    Returns:
        Centres [F, 3], rotations [F, 3, 3] (columns are the axes), sizes [F] in metres.
    """
    v0, v1, v2 = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    first, second = v1 - v0, v2 - v0
    a0 = _unit(first)
    a1 = _unit(np.cross(a0, second))
    a2 = -_unit(np.cross(a1, a0))
    size = (np.linalg.norm(first, axis=1) + np.abs((a2 * second).sum(1))) / 2.0
    return (v0 + v1 + v2) / 3.0, np.stack([a0, a1, a2], -1), size


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), _TINY)


def place_on_mesh(cloud: SplatCloud, vertices: np.ndarray, faces: np.ndarray) -> SplatCloud:
    """Put bound splats where a posed mesh carries them.

    Args:
        cloud: With `binding`, local to the triangles.
        vertices: Posed mesh, [V, 3] metres.
        faces: [F, 3].

    Returns:
        Free splats (no binding). Higher harmonics stay in the frame of the file, as viewers of this format treat them.

    Raises:
        ShapeError: No binding, or one beyond the mesh: the splats belong to another head model.
    """
    binding = _binding(cloud, faces)
    centre, rotation, size = triangle_frames(vertices, faces)
    turned = np.einsum("nij,nj->ni", rotation[binding], cloud.means.astype(np.float64))
    quats = multiply_quaternions(_triangle_quaternions(rotation)[binding], cloud.quats).astype(np.float32)
    return replace(
        cloud,
        means=(turned * size[binding, None] + centre[binding]).astype(np.float32),
        quats=quats,
        scales=(cloud.scales * np.maximum(size[binding, None], _TINY)).astype(np.float32),
        binding=None,
    )


def bind_to_mesh(cloud: SplatCloud, vertices: np.ndarray, faces: np.ndarray, binding: np.ndarray) -> SplatCloud:
    """Express free splats in the frames of triangles: the inverse of `place_on_mesh`.

    Args:
        cloud: Free splats in the pose of the mesh.
        vertices: Posed mesh, [V, 3] metres.
        faces: [F, 3].
        binding: Triangle of each splat, [N].

    Raises:
        ShapeError: A binding beyond the mesh, or a triangle without extent.
    """
    bound = replace(cloud, binding=np.asarray(binding, np.int32))
    index = _binding(bound, faces)
    centre, rotation, size = triangle_frames(vertices, faces)
    if (size[index] < 1e-12).any():
        raise ShapeError("A splat is bound to a triangle without extent; choose another triangle.")
    local = np.einsum("nji,nj->ni", rotation[index], cloud.means.astype(np.float64) - centre[index]) / size[index, None]
    inverse = _triangle_quaternions(rotation)[index] * np.array([1, -1, -1, -1])
    return replace(
        bound,
        means=local.astype(np.float32),
        quats=multiply_quaternions(inverse, cloud.quats).astype(np.float32),
        scales=(cloud.scales / size[index, None]).astype(np.float32),
    )


def _triangle_quaternions(rotation: np.ndarray) -> np.ndarray:
    """Quaternions [F, 4] of frames [F, 3, 3]; a triangle without extent does not turn."""
    flat = np.abs(np.linalg.det(rotation)) < 0.5
    return matrix_to_quaternion(np.where(flat[:, None, None], np.eye(3), rotation))


def _binding(cloud: SplatCloud, faces: np.ndarray) -> np.ndarray:
    if cloud.binding is None:
        raise ShapeError("These splats are not bound to triangles.")
    highest = int(cloud.binding.max()) if cloud.count else -1
    if highest >= faces.shape[0]:
        raise ShapeError(
            f"The splats are bound to triangle {highest} and the mesh has {faces.shape[0]}; choose the head they belong to."
        )
    return cloud.binding
