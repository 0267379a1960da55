"""The inside of the bust, which is open below: nobody wants to look into it, and scenes' lamps leave it black.

What of the neck and shoulders turns its back on the eye, and has no skin before it, is not drawn, so that the bust ends at its
edge from every side. Exported splats have all of it: other programs look at them from everywhere.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..geometry.camera import Camera
from ..geometry.libraries import as_like, to_numpy
from ..hair.drawing import coarse_depth
from ..light.resting import Texels
from ..light.transfer import vertex_normals
from ..splat import Gaussians
from .evaluator import Evaluator, Inputs, OpenAvatar

SKIN_ISLAND = 0  # of the UV map: skin hides hair, eyes and teeth are behind it
BACK = (-0.2, 0.0)  # cosine between the skin's normal and the way to the eye: gone below the first, whole above the second
BELOW = (-0.62, -0.47)  # height of the eye, of its distance: from 38 degrees below one would look into the head, from 28 not
_BUST = "neck"
_PIXELS = 288  # of the picture of the bust that says what has skin before it: its cells are 6 mm of a bust
_BEFORE = 0.02  # metres
_RINGS = 3  # of vertices beyond those that are seen
_NEAREST = 0.05  # metres: of a bust that is nearer to the eye, nothing is left out for being behind skin


def from_far(view: np.ndarray) -> Camera:
    """An orthographic camera that sees a head from a direction, the unit vector [3] from it towards the camera."""
    yaw, pitch = math.degrees(math.atan2(view[0], view[2])), math.degrees(math.asin(float(np.clip(view[1], -1.0, 1.0))))
    return dataclasses.replace(Camera.orbit(1, 1, yaw, pitch), fx=1.0, fy=1.0, orthographic=True)


def without_inside(
    own: Gaussians, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, lod: int, camera: Camera
) -> Gaussians:  # fmt: skip
    """Return Gaussians without the inside of the bust that a camera would see.

    Args:
        own: Of the skin, head space.
        evaluator: Has the mesh.
        target: Whose they are.
        inputs: Of this frame.
        lod: Level of detail of `own`.
        camera: In head space.
    """
    texels = evaluator.texels(target)
    bust, faces, skin, rows, corners, barycentric = evaluator.cache.get((target.id, "bust"), lambda: _parts(target, texels))
    vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
    normals, here = vertex_normals(vertices, target.model.head_model.faces)[bust], vertices[bust]
    towards = -camera.forward if camera.orthographic else camera.position - here
    cosine = (normals * towards).sum(1) / np.linalg.norm(towards, axis=-1).clip(1e-9)
    share = np.clip((cosine - BACK[0]) / (BACK[1] - BACK[0]), 0.0, 1.0)
    open_to = np.clip((camera.view_direction(np.zeros(3))[1] - BELOW[0]) / (BELOW[1] - BELOW[0]), 0.0, 1.0)
    share = 1.0 - open_to * (1.0 - share)
    hollow = np.zeros(len(vertices), bool)
    hollow[bust] = (share < 1.0) & _is_bare(here, vertices, skin, camera)
    if not hollow.any():
        return own
    for _ in range(_RINGS):  # up behind the edge; farther behind skin, it closes what gaps that has
        hollow[faces[hollow[faces].any(1)]] = True
    seen = np.ones(len(vertices), np.float32)
    seen[bust] = np.where(hollow[bust], share * share * (3.0 - 2.0 * share), 1.0)
    left = np.ones(len(texels.corners), np.float32)
    left[rows] = np.einsum("nk,nk->n", barycentric, seen[corners])
    left = left if lod == 0 else left[evaluator.blocks(target, lod).middle]
    return dataclasses.replace(own, opacities=own.opacities * as_like(left, own.opacities))


def _parts(target: OpenAvatar, texels: Texels) -> tuple[np.ndarray, ...]:
    """Vertices of the bust, the faces at them, all faces of skin; numbers of the texels on the former, and where they lie."""
    head = target.model.head_model
    bust, skin = head.marked(_BUST), np.asarray(head.uv_islands) == SKIN_ISLAND
    touched = bust[head.faces].any(1)
    rows = np.flatnonzero(touched[texels.face])
    faces = np.asarray(head.faces)
    return np.flatnonzero(bust), faces[touched], faces[skin], rows, texels.corners[rows], texels.barycentric[rows]


def _is_bare(here: np.ndarray, vertices: np.ndarray, skin: np.ndarray, camera: Camera) -> np.ndarray:
    """Whether places on the bust [K, 3] have no skin before them nor a cell beside that, [K] bool: outlines of necks stay."""
    near = _on_bust(camera, here)
    if near is None:
        return np.ones(len(here), bool)
    depth, cell = coarse_depth(vertices, skin, near)
    for _ in range(2):  # along both axes
        depth = np.minimum(depth, np.minimum(np.vstack([depth[:1], depth[:-1]]), np.vstack([depth[1:], depth[-1:]]))).T
    local, pixels = near.project(here)
    column, row = (pixels // cell).astype(int).T
    size = float(np.cbrt(np.linalg.det(near.world_to_camera[:3, :3])))
    nearest = depth[row.clip(0, len(depth) - 1), column.clip(0, depth.shape[1] - 1)]
    result: np.ndarray = local[:, 2] < nearest + _BEFORE * size
    return result


def _on_bust(camera: Camera, here: np.ndarray) -> Camera | None:
    """The same eye, with a picture of places [K, 3] alone; None where they reach too near to it."""
    place = camera.world_to_camera
    local = here @ place[:3, :3].T + place[:3, 3]
    if not camera.orthographic and (not len(here) or local[:, 2].min() < _NEAREST):
        return None
    shown = local[:, :2] if camera.orthographic else local[:, :2] / local[:, 2:]
    low, high = shown.min(0), shown.max(0)
    scale = _PIXELS / float((high - low).max().clip(1e-9))
    left, top = -low * scale
    return dataclasses.replace(camera, fx=scale, fy=scale, cx=left, cy=top, width=_PIXELS, height=_PIXELS)
