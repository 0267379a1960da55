"""An avatar of the open head on the user's FLAME head: what GaussianAvatars' files need.

FLAME's mesh is moved onto the avatar's resting surface by per-vertex offsets (`static_offset`, the shape coefficients stay
zero), and each Gaussian is bound to a triangle of FLAME. At rest the nearest triangle may lie across the closed lips, or be a
lid in place of the eyeball: so the nearest one is looked for in several poses at once, `PROBES`, in which these move apart.
What is inside the mouth is bound to the skin that moves most alike, since every program builds its own teeth for FLAME.
Expressions then come from FLAME's own coefficients (`performance.retarget`). Called by the exporters; needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import FileFormatError, ShapeError
from ...head.flame_align import Correspondence, correspond
from ...head.flame_file import FLAME_FACES
from ...head.flame_regions import find_surface
from ...head.head_model import HeadModel
from ...head.open_head import load_open_head
from ..splats.cloud import SplatCloud
from .binding import bind_to_mesh, triangle_frames

_CHUNK = 512  # Gaussians compared with all triangles at once: bounds memory
_MOUTH_VERTICES = 80  # of the skin nearest to the teeth, whose movement the teeth follow
_FOLLOWS = 0.99  # weight of an eye's joint at the vertices of its eyeball
_SIDES = ("left", "right")
_INSIDE = ("upper_teeth", "lower_teeth", "tongue", "mouth_interior")
_LEVER = 0.02  # of the distance to a triangle counts as error: what the poses do not show grows with it
_WIDE = 128  # Gaussians that are tried on all triangles at once
PROBES: tuple[dict[str, float], ...] = (
    {"jawOpen": 1.0},
    {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    {"mouthUpperUpLeft": 1.0, "mouthUpperUpRight": 1.0, "mouthLowerDownLeft": 1.0, "mouthLowerDownRight": 1.0},
    {"mouthFunnel": 1.0},
)
"""Aligned expressions that pull apart what touches at rest: jaws and lips, lids and eyeballs, lips and teeth."""


@dataclass(frozen=True)
class FlameFit:
    """FLAME's mesh on an avatar.

    Attributes:
        offset: Movement of FLAME's resting vertices (with teeth) onto the avatar, metres, [V, 3].
        vertices: Where they are then, FLAME's coordinates, [V, 3].
        scale, shift: FLAME's coordinates = scale * the open head's + shift.
        resting: The avatar's mesh at rest in FLAME's coordinates, [V_open, 3].
        skin: Vertices of FLAME's skin, [M].
        correspondence: FLAME's skin in terms of the open head.
    """

    offset: np.ndarray
    vertices: np.ndarray
    scale: float
    shift: np.ndarray
    resting: np.ndarray
    skin: np.ndarray
    correspondence: Correspondence

    def posed(self, vertices: np.ndarray, flame: HeadModel) -> np.ndarray:
        """Return FLAME's mesh on the avatar in another pose, [V, 3]; the teeth stay.

        Args:
            vertices: The avatar's mesh in that pose, open head's coordinates, [V_open, 3].
            flame: Of `fit_flame`.
        """
        head = load_open_head()
        target = self.scale * np.asarray(vertices, np.float64) + self.shift
        result = self.vertices.astype(np.float64)
        result[self.skin] += self.correspondence.carry(target - self.resting)
        own = [np.flatnonzero(flame.weights[:, 3 + side] > _FOLLOWS) for side in range(2)]
        for side, moved in zip(_SIDES, own, strict=True):
            part = head.regions[f"{side}_eyeball"]
            rotation, shift = _rigid(self.resting[part], target[part])
            result[moved] = result[moved] @ rotation.T + shift
        return result


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
    vertices = (flame.v_template + offset).astype(np.float32)
    return FlameFit(offset.astype(np.float32), vertices, found.scale, found.shift, target, surface.skin, found)


def bind_to_flame(
    cloud: SplatCloud, fit: FlameFit, flame: HeadModel, probes: Sequence[tuple[np.ndarray, np.ndarray]] = ()
) -> SplatCloud:
    """Bind an avatar's resting Gaussians (open head's coordinates) to FLAME's triangles.

    Args:
        cloud: At rest.
        fit: Of `fit_flame`.
        flame: The user's head model.
        probes: For each of `PROBES` the Gaussians' centres [N, 3] and the avatar's mesh [V_open, 3] in that pose.
    """
    moved = replace(
        cloud,
        means=(fit.scale * cloud.means + fit.shift).astype(np.float32),
        scales=(fit.scale * cloud.scales).astype(np.float32),
    )
    faces = np.asarray(flame.faces[:FLAME_FACES], np.int64)
    points = np.stack([moved.means, *(fit.scale * means + fit.shift for means, _ in probes)])
    meshes = np.stack([fit.vertices, *(fit.posed(vertices, flame) for _, vertices in probes)])
    binding = nearest_triangles(points, meshes, faces)
    if probes:
        own = np.stack([fit.resting, *(fit.scale * vertices + fit.shift for _, vertices in probes)])
        inside = np.flatnonzero(_inside_mouth(points, own))
        binding[inside] = carrying_triangles(points[:, inside], meshes, faces)
    return bind_to_mesh(moved, fit.vertices, faces, binding)


def _inside_mouth(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Whether points [P, n, 3] belong to teeth, tongue or the mouth's inside of the open head [P, V_open, 3], [n]."""
    head = load_open_head()
    return head.marked(*_INSIDE)[_nearest(np.concatenate(list(points), 1), np.concatenate(list(vertices), 1))]


def _nearest(own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Index of the nearest row of `others` [m, d] for each row of `own` [n, d], [n]."""
    centre = others.mean(0)
    others = (others - centre).astype(np.float32)
    squares = (others**2).sum(1)
    parts = np.array_split(own, range(_CHUNK, len(own), _CHUNK))
    return np.concatenate([(squares - 2.0 * (part - centre).astype(np.float32) @ others.T).argmin(1) for part in parts])


def nearest_triangles(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the nearest triangle of each point, [n] int32: of the one whose middle is nearest and its neighbours.

    Args:
        points: In each of P poses, [P, n, 3].
        vertices: Of the mesh in the same poses, [P, V, 3].
        faces: [F, 3].
    """
    corners = np.asarray(vertices, np.float64)[:, faces]  # [P, F, 3, 3]
    first = _nearest(np.concatenate(list(points), 1), np.concatenate(list(corners.mean(2)), 1))  # [n]
    neighbours = _neighbours(faces, vertices.shape[1])
    result = np.empty(points.shape[1], np.int32)
    for start in range(0, len(result), _CHUNK):
        part = np.asarray(points[:, start : start + _CHUNK], np.float64)  # [P, c, 3]
        near = neighbours[first[start : start + _CHUNK]]  # [c, k]
        gaps = sum(_triangle_distances(pose[:, None], mesh[near]) ** 2 for pose, mesh in zip(part, corners, strict=True))
        result[start : start + len(near)] = np.take_along_axis(near, np.argmin(gaps, 1)[:, None], 1)[:, 0]
    return result


def carrying_triangles(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return for each point the triangle that would carry it best from the first pose to the others, [n] int32.

    Args:
        points: In each of P poses, [P, n, 3].
        vertices: Of the mesh in the same poses, [P, V, 3].
        faces: [F, 3].
    """
    frames = [triangle_frames(pose, faces) for pose in vertices]
    centre, rotation, size = frames[0]
    usable = size > 0
    turns = []  # of each pose: what an arm from the centre becomes, [F, 3, 3], and where the centre goes, [F, 3, 1]
    for middle, turned, grown in frames[1:]:
        growth = np.where(usable, grown / np.where(usable, size, 1.0), 1.0)
        turns.append((growth[:, None, None] * (turned @ rotation.transpose(0, 2, 1)), middle[..., None]))
    result = np.empty(points.shape[1], np.int32)
    for start in range(0, len(result), _WIDE):
        part = points[:, start : start + _WIDE].transpose(0, 2, 1).astype(np.float64)  # [P, 3, c]
        arms = part[0] - centre[..., None]  # [F, 3, c]
        errors = _LEVER**2 * (arms**2).sum(1)  # [F, c]
        for (turn, middle), wanted in zip(turns, part[1:], strict=True):
            errors += ((turn @ arms + (middle - wanted)) ** 2).sum(1)
        result[start : start + _WIDE] = np.where(usable[:, None], errors, np.inf).argmin(0)
    return result


def _rigid(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation [3, 3] and shift [3] that best take points [n, 3] to others."""
    middle, aim = source.mean(0), target.mean(0)
    left, _, right = np.linalg.svd((target - aim).T @ (source - middle))
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    rotation = left @ right
    return rotation, aim - rotation @ middle


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
