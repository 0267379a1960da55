"""An avatar of the open head on the user's FLAME head: what GaussianAvatars' files need.

FLAME's mesh is moved onto the avatar's resting surface by per-vertex offsets (`static_offset`, the shape coefficients stay
zero), and each Gaussian is bound to the triangle of FLAME that it is nearest to. Expressions then come from FLAME's own
coefficients (`performance.retarget`). Called by Blender's exporter; needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import FileFormatError, ShapeError
from ...head.flame_align import correspond
from ...head.flame_file import FLAME_FACES
from ...head.flame_regions import find_surface
from ...head.model import HeadModel
from ...head.open_head import load_open_head
from ..splats.cloud import SplatCloud
from .binding import bind_to_mesh

_CHUNK = 512  # Gaussians compared with all triangles at once: bounds memory
_MOUTH_VERTICES = 80  # of the skin nearest to the teeth, whose movement the teeth follow
_FOLLOWS = 0.99  # weight of an eye's joint at the vertices of its eyeball
_SIDES = ("left", "right")


@dataclass(frozen=True)
class FlameFit:
    """FLAME's mesh on an avatar.

    Attributes:
        offset: Movement of FLAME's resting vertices (with teeth) onto the avatar, metres, [V, 3].
        vertices: Where they are then, FLAME's coordinates, [V, 3].
        scale, shift: FLAME's coordinates = scale * the open head's + shift.
    """

    offset: np.ndarray
    vertices: np.ndarray
    scale: float
    shift: np.ndarray


def fit_flame(vertices: np.ndarray, flame: HeadModel) -> FlameFit:
    """Move FLAME onto an avatar of the open head.

    Args:
        vertices: The avatar's mesh at rest, open head's coordinates, [V_open, 3].
        flame: Of `load_flame`.

    Raises:
        ShapeError: The mesh is not the open head's.
        FileFormatError: The head model is not a FLAME head.
    """
    head = load_open_head()
    if np.shape(vertices) != head.v_template.shape:
        raise ShapeError(f"The avatar's mesh has shape {np.shape(vertices)}; the open head's is {head.v_template.shape}.")
    if len(flame.faces) <= FLAME_FACES:
        raise FileFormatError(f"The head model {flame.name!r} is not a FLAME head with teeth; choose your FLAME file.")
    count = int(flame.faces[:FLAME_FACES].max()) + 1
    surface = find_surface(flame.v_template[:count], flame.faces[:FLAME_FACES], flame.name)
    found = correspond(surface, flame.weights[:count, 2], head, flame.name)
    target = found.scale * np.asarray(vertices, np.float64) + found.shift  # [V_open, 3] in FLAME's coordinates
    offset = np.zeros(flame.v_template.shape)
    # The movement from where the warped open head lies on FLAME keeps FLAME's own detail where the two meshes differ.
    offset[surface.skin] = found.carry(target - found.warped)
    for index, side in enumerate(_SIDES):
        own = np.flatnonzero(flame.weights[:, 3 + index] > _FOLLOWS)
        moved = target[head.regions[f"{side}_eyeball"]].mean(0) - flame.v_template[own].mean(0)
        offset[own] = moved
    teeth = np.arange(count, len(flame.v_template))
    gap = np.linalg.norm(flame.v_template[surface.skin] - flame.v_template[teeth].mean(0), axis=1)
    offset[teeth] = offset[surface.skin[np.argsort(gap)[:_MOUTH_VERTICES]]].mean(0)
    return FlameFit(offset.astype(np.float32), (flame.v_template + offset).astype(np.float32), found.scale, found.shift)


def bind_to_flame(cloud: SplatCloud, fit: FlameFit, flame: HeadModel) -> SplatCloud:
    """Bind an avatar's resting Gaussians (open head's coordinates) to FLAME's triangles."""
    moved = replace(
        cloud,
        means=(fit.scale * cloud.means + fit.shift).astype(np.float32),
        scales=(fit.scale * cloud.scales).astype(np.float32),
    )
    faces = np.asarray(flame.faces, np.int64)
    return bind_to_mesh(moved, fit.vertices, faces, nearest_triangles(moved.means, fit.vertices, faces))


def nearest_triangles(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the nearest triangle of each point, [n] int32: of the one whose middle is nearest and its neighbours.

    Args:
        points: [n, 3].
        vertices: [V, 3].
        faces: [F, 3].
    """
    corners = np.asarray(vertices, np.float64)[faces]  # [F, 3, 3]
    middles = corners.mean(1)
    centre = middles.mean(0)
    middles = (middles - centre).astype(np.float32)
    squares = (middles**2).sum(1)
    neighbours = _neighbours(faces, len(vertices))
    result = np.empty(len(points), np.int32)
    for start in range(0, len(points), _CHUNK):
        part = np.asarray(points[start : start + _CHUNK], np.float64)
        first = (squares - 2.0 * (part - centre).astype(np.float32) @ middles.T).argmin(1)  # [n]
        near = neighbours[first]  # [n, k]
        gaps = _triangle_distances(part[:, None], corners[near])
        result[start : start + len(part)] = np.take_along_axis(near, gaps.argmin(1)[:, None], 1)[:, 0]
    return result


def _neighbours(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Triangles that share a corner with each triangle, itself included and repeated to fill the rows, [F, k]."""
    order = np.argsort(faces.ravel(), kind="stable")
    around = np.split(order // 3, np.cumsum(np.bincount(faces.ravel(), minlength=vertex_count))[:-1])
    rings = [np.unique(np.concatenate([around[corner] for corner in face])) for face in faces]
    result = np.repeat(np.arange(len(faces))[:, None], max(map(len, rings)), 1)
    for face, ring in enumerate(rings):
        result[face, : len(ring)] = ring
    return result


def _triangle_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances [n, k] of points [n, 1, 3] to triangles [n, k, 3, 3], clipped in barycentric coordinates."""
    a = corners[..., 0, :]
    first, second, arm = corners[..., 1, :] - a, corners[..., 2, :] - a, points - a
    d11, d12, d22 = (first * first).sum(-1), (first * second).sum(-1), (second * second).sum(-1)
    e1, e2 = (arm * first).sum(-1), (arm * second).sum(-1)
    determinant = np.maximum(d11 * d22 - d12 * d12, 1e-30)
    v, w = (d22 * e1 - d12 * e2) / determinant, (d11 * e2 - d12 * e1) / determinant
    inside = np.maximum(np.stack([1.0 - v - w, v, w], -1), 0.0)
    inside /= inside.sum(-1, keepdims=True)
    return np.linalg.norm((inside[..., None] * corners).sum(-2) - points, axis=-1)
