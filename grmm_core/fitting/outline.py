"""Where the head's outline should be in a photo: ears, cheeks and bald scalps against background, hair or clothes.

The person's mask alone does not show the head's outline, for it has hair in it. What is looked for is the end of the *skin*:
from every point of the mesh's outline outward to where person and skin color end, or inward to where the person begins. What
the parser takes for hair, neck, clothes or a thing is no skin of face and ears, whatever its color: fair hair over an ear would
draw the head wider. Used by `photometric_stage`. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.triangles import vertex_normals
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..head.head_model import HeadModel
from ..pictures.sampling import bilinear

REGIONS = ("face", "ears")
OUTLINED = (*REGIONS, "scalp")  # a bald head's; hair is no outline, and a skull ends within it
REACH_OUT, REACH_IN = 0.30, 0.15  # eye distances from the mesh's outline that are searched
FACE_REACH_OUT = 0.12  # likewise beside the cheek, where a neck wider than the mesh's goes on as skin
_CLEAR = (0.03, 0.08)  # eye distances outward that must be free of the mesh: inner contours (chin over neck) do not count
_INSIDE = 0.05  # eye distances inside the outline where skin must be seen
_STEPS = 96
_HALF = 0.5
_CHROMA_FLOOR, _LUMA_FLOOR = 0.12, 0.45  # spreads of skin color (logarithms) that are always allowed
_SKIN_LIMIT, _SKIN_SOFTNESS = 9.0, 1.5  # squared standard scores
_BLACK = 0.02


@dataclass(frozen=True)
class OutlinePoints:
    """Points of the mesh and where they should be seen.

    Attributes:
        triangles: [N].
        barycentric: [N, 3].
        target: Pixels, [N, 2].
        normals: Outward unit normals of the outline in the picture, [N, 2].
        distance: From the mesh to the target along the normal, pixels, [N].
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    target: np.ndarray
    normals: np.ndarray
    distance: np.ndarray


def skin_map(image: np.ndarray, skin_points: np.ndarray) -> np.ndarray:
    """How much each pixel has the color of the person's skin.

    Args:
        image: Display sRGB 0..1, [H, W, 3].
        skin_points: Pixels that are skin, for the most part, [N, 2].

    Returns:
        0..1, [H, W].
    """
    features = _color_features(image)  # [H, W, 3]
    known = bilinear(features, skin_points)
    middle = np.median(known, axis=0)
    spread = 1.48 * np.median(np.abs(known - middle), axis=0)
    spread = np.maximum(spread, [_CHROMA_FLOOR, _CHROMA_FLOOR, _LUMA_FLOOR])
    squared = (((features - middle) / spread) ** 2).sum(-1)
    return 1.0 / (1.0 + np.exp(np.clip((squared - _SKIN_LIMIT) / _SKIN_SOFTNESS, -50.0, 50.0)))


def find_outline(
    head: HeadModel,
    vertices: np.ndarray,
    camera: Camera,
    image: np.ndarray,
    mask: np.ndarray,
    valid: np.ndarray,
    unit: float,
    others: np.ndarray | None = None,
) -> OutlinePoints:
    """Match the mesh's outline with the end of the skin.

    Args:
        head: Head model.
        vertices: Posed vertices in metres, [V, 3].
        camera: Of the picture.
        image: Display sRGB 0..1, [H, W, 3].
        mask: The person, 0..1, [H, W].
        valid: 1 where the photo has pixels, [H, W].
        unit: Eye distance in pixels.
        others: What is no skin of face and ears, hair and neck as well, 0..1, [H, W]; None: nothing is known.

    Returns:
        Possibly no points at all.
    """
    vertices = vertices.astype(np.float64)
    pixels = camera.project(vertices)[1]
    depth = triangle_depth(vertices[head.faces], camera)
    triangles, barycentric, position, normals = _mesh_outline(head, pixels, depth, unit)
    skin = skin_map(image, visible_skin(head, vertices, camera, depth)) * mask
    skin = skin if others is None else skin * (1.0 - others)
    offsets = np.linspace(-REACH_IN, REACH_OUT, _STEPS) * unit
    path = position[:, None] + offsets[:, None] * normals[:, None]  # [N, T, 2]
    skin_along, mask_along = bilinear(skin, path), bilinear(mask, path)
    valid_along = bilinear(valid, path).min(axis=1) > 0.99
    outward, found_out = _skin_end(skin_along, offsets, unit)
    inward, found_in = _person_begin(mask_along, offsets)
    distance = np.where(found_out, outward, inward)
    ear = np.isin(head.faces[triangles], head.regions["ears"]).any(axis=1)
    use = valid_along & (found_out | found_in) & (distance <= np.where(ear, REACH_OUT, FACE_REACH_OUT) * unit)
    target = position + distance[:, None] * normals
    return OutlinePoints(triangles[use], barycentric[use], target[use], normals[use], distance[use])


def visible_skin(head: HeadModel, vertices: np.ndarray, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Pixels of the face's skin vertices that face the camera, [N, 2]."""
    chosen = visible_skin_vertices(head, vertices, camera, depth)
    return camera.project(vertices[chosen])[1]


def visible_skin_vertices(head: HeadModel, vertices: np.ndarray, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Indices of the face's skin vertices (no lips, lids, brows) that face the camera and are not hidden, [N]."""
    others = [head.regions[name] for name in ("lips", "lids", "brows", "lashes", "mouth_interior") if name in head.regions]
    face = np.setdiff1d(head.regions["face"], np.concatenate(others)) if others else head.regions["face"]
    local, pixels = camera.project(vertices[face])
    normals = vertex_normals(vertices, head.faces)[face]
    rays = vertices[face] - camera.position
    facing = -(normals * rays).sum(1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    columns = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
    rows = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
    inside = (pixels >= 1.0).all(1) & (pixels[:, 0] < camera.width - 1) & (pixels[:, 1] < camera.height - 1)
    return face[(facing > 0.4) & inside & (local[:, 2] < depth[rows, columns] + 0.004)]


def _color_features(image: np.ndarray) -> np.ndarray:
    """Two logarithmic color ratios and logarithmic lightness, [..., 3]."""
    r, g, b = (np.log(np.maximum(image[..., c], 0.0) + _BLACK) for c in range(3))
    return np.stack([r - g, b - g, g], axis=-1)


def _mesh_outline(
    head: HeadModel, pixels: np.ndarray, depth: np.ndarray, unit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Middles of the mesh edges on the outline of ears, face and scalp: triangle, barycentric, pixel, outward normal."""
    faces = head.faces
    corners = pixels[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    front = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0.0  # y points down
    allowed = head.marked(*OUTLINED)
    # edges as (low, high) of all triangles; partners lie next to each other after sorting
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    corner = np.repeat(np.arange(3), len(faces))
    key = pairs[:, 0].astype(np.int64) * head.vertex_count + pairs[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = order[same], order[same + 1]
    crossing = (front[owner[a]] != front[owner[b]]) & allowed[pairs[a]].all(axis=1)
    chosen = np.where(front[owner[a]], a, b)[crossing]  # the edge as its front triangle's
    triangles, corner = owner[chosen], corner[chosen]
    barycentric = np.full((len(chosen), 3), _HALF)
    barycentric[np.arange(len(chosen)), (corner + 2) % 3] = 0.0
    ends = pixels[pairs[chosen]]  # [N, 2, 2]
    position = ends.mean(axis=1)
    along = ends[:, 1] - ends[:, 0]
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    opposite = pixels[faces[triangles, (corner + 2) % 3]]
    normals *= np.where(((opposite - position) * normals).sum(1) > 0.0, -1.0, 1.0)[:, None]
    free = np.linalg.norm(along, axis=1) > 1e-3
    for share in _CLEAR:
        beyond = (position + share * unit * normals).astype(int)
        rows, columns = beyond[:, 1], beyond[:, 0]
        inside = (rows >= 0) & (rows < depth.shape[0]) & (columns >= 0) & (columns < depth.shape[1])
        free &= inside
        free[inside] &= depth[rows[inside], columns[inside]] >= EMPTY
    return triangles[free], barycentric[free], position[free], normals[free]


def _skin_end(skin: np.ndarray, offsets: np.ndarray, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Offset at which skin ends beyond the outline, [N], and where that was seen."""
    just_inside = (offsets >= -_INSIDE * unit) & (offsets <= 0.0)
    seen = skin[:, just_inside].mean(axis=1) > 0.6
    outside = np.flatnonzero(offsets > 0.0)
    ended = skin[:, outside] < _HALF
    ended[:, :-1] &= ended[:, 1:]  # one dark pixel is no end
    ended[:, -1] = False
    return offsets[outside][np.argmax(ended, axis=1)], seen & ended.any(axis=1)


def _person_begin(mask: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset inside the outline at which the person begins, [N], and where background was seen up to the outline."""
    inside = np.flatnonzero(offsets <= 0.0)
    person = mask[:, inside] > _HALF
    last = len(inside) - 1 - np.argmax(person[:, ::-1], axis=1)
    return offsets[inside][last], person.any(axis=1) & ~person[:, -1]
