"""How clean a person looks from all sides, without a truth: what stands beside the head, holes, specks, and a seam.

``SHEET``         twelve views and expressions that are looked at
``cleanliness``   figures of one of these pictures
``seam``          jumps of color between skin that a photo shows and skin that it does not

Called by `photo_fits`. The pictures are a session's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional

from ..geometry.camera import Camera
from ..geometry.triangles import face_normals
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..head import HeadModel
from ..photo.parser import MESH_PARTS, part_map

SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0}
JAW = {"jawOpen": 0.7}
BLINK = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}
SHEET: tuple[tuple[Mapping[str, float], float, float], ...] = (
    ({}, 0, 0), ({}, -30, 0), ({}, 30, 0), ({}, -60, 0), ({}, 60, 0), ({}, 180, 0), ({}, 0, 55), ({}, 140, 10),
    (SMILE, 0, 0), (JAW, 0, 0), (BLINK, 0, 0), (JAW, 40, -5),
)  # fmt: skip
"""Controls, yaw and pitch in degrees of each picture."""
FROM_FRONT = 5  # the first of them: neutral, from the front and the sides
WIDENED = 0.01  # of the picture's side around mesh and strands that still belongs to the head
STRANDS = 0.02  # cover by strands from which a pixel is hair
SPECK = 0.08  # of lightness, beside the median of 5 x 5 pixels
PLAIN = ("ears", "scalp", "neck", "skin")  # parts of the mesh without edges of their own
SEEN, FACING = 0.5, 0.25  # of a photo's pixel; cosine towards its camera
BEHIND = 0.002  # metres
_FEW = 20


class Shot(NamedTuple):
    """One picture of an avatar.

    Attributes:
        vertices: Its posed mesh, [V, 3].
        camera: In head space.
        rgb: Display sRGB over grey, [H, W, 3].
        alpha: [H, W].
        hair: Cover by strands, [H, W].
    """

    vertices: np.ndarray
    camera: Camera
    rgb: np.ndarray
    alpha: np.ndarray
    hair: np.ndarray


def cleanliness(shot: Shot, head: HeadModel) -> dict[str, float]:
    """Shares of one picture.

    Returns:
        outside: Of the avatar's cover, what is neither on the mesh nor hair.
        holes: Of the pixels of the mesh's outer side, what shows the background. The inside of an open bust is not drawn.
        specks: Of the pixels of plain skin, those of another lightness than around them.
    """
    corners = shot.vertices[head.faces]
    outer = (face_normals(shot.vertices, head.faces) * (shot.camera.position - corners.mean(1))).sum(1) > 0
    mesh, outside = (triangle_depth(some, shot.camera) < EMPTY for some in (corners, corners[outer]))
    reach = max(1, round(WIDENED * max(mesh.shape)))
    near, inner = _widened(mesh | (shot.hair > STRANDS), reach), ~_widened(~outside, reach)
    parts = part_map(head, shot.vertices, shot.camera)[0]
    plain = np.isin(parts, [tuple(MESH_PARTS).index(name) for name in PLAIN]) & (shot.hair < STRANDS)
    plain = ~_widened(~plain, reach)
    light = torch.from_numpy(np.ascontiguousarray(shot.rgb.mean(2), np.float32))
    around = functional.unfold(functional.pad(light[None, None], (2, 2, 2, 2), "replicate"), 5).median(1).values
    off = np.abs(light.numpy() - around.reshape(light.shape).numpy()) > SPECK
    return {
        "outside": float((shot.alpha * ~near).sum() / max(float(shot.alpha.sum()), 1.0)),
        "holes": float(((1.0 - shot.alpha) * inner).sum() / max(int(inner.sum()), 1)),
        "specks": float((off & plain).sum() / max(int(plain.sum()), 1)),
    }


def seen_vertices(vertices: np.ndarray, camera: Camera, inside: np.ndarray, head: HeadModel) -> np.ndarray:
    """Vertices that a photo shows well, [V] bool: on its pixels of bare skin [H, W], towards its camera, not hidden."""
    pixels, visible = _visible(vertices, camera, head)
    normals = np.zeros_like(vertices)
    np.add.at(normals, head.faces, face_normals(vertices, head.faces)[:, None])
    towards = camera.position - vertices
    cosine = (normals * towards).sum(1) / np.maximum(np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1), 1e-12)
    result: np.ndarray = visible & (cosine > FACING) & (inside[pixels[:, 1], pixels[:, 0]] > SEEN)
    return result


def seam(shots: Sequence[Shot], seen: np.ndarray, head: HeadModel) -> float:
    """Mean jump of color along edges of skin from seen to unseen vertices, relative to all edges of skin; 1 is no seam.

    Args:
        shots: Pictures of the neutral face.
        seen: `seen_vertices`, [V].
        head: Mesh.
    """
    edges = np.unique(np.sort(np.concatenate([head.faces[:, [0, 1]], head.faces[:, [1, 2]], head.faces[:, [2, 0]]]), 1), axis=0)
    skin = head.marked("face", "neck", "scalp", "ears") & ~head.marked("lips", "lids", "brows", "lashes")
    edges = edges[skin[edges].all(1)]
    border = seen[edges[:, 0]] != seen[edges[:, 1]]
    at_border, everywhere = [], []
    for shot in shots:
        pixels, visible = _visible(shot.vertices, shot.camera, head)
        column, row = pixels.T
        bare = visible & (shot.hair[row, column] < STRANDS) & (shot.alpha[row, column] > SEEN)
        shown = bare[edges].all(1)
        jump = np.abs(np.diff(shot.rgb[row, column][edges], axis=1)[:, 0]).mean(1)
        at_border.append(jump[shown & border])
        everywhere.append(jump[shown])
    some, every = np.concatenate(at_border), np.concatenate(everywhere)
    return float(some.mean() / max(float(every.mean()), 1e-6)) if len(some) >= _FEW else 1.0


def _visible(vertices: np.ndarray, camera: Camera, head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [V, 2] of vertices inside the picture, and whether nothing is before them, [V]."""
    local, places = camera.project(vertices)
    pixels = np.stack(
        [np.clip(places[:, k].astype(int), 0, side - 1) for k, side in enumerate((camera.width, camera.height))], 1
    )
    depth = triangle_depth(vertices[head.faces], camera)
    return pixels, local[:, 2] < depth[pixels[:, 1], pixels[:, 0]] + BEHIND


def _widened(mask: np.ndarray, reach: int) -> np.ndarray:
    plane = torch.from_numpy(mask.astype(np.float32))[None, None]
    result: np.ndarray = functional.max_pool2d(plane, 2 * reach + 1, 1, reach)[0, 0].numpy() > 0.5
    return result
