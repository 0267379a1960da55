"""The inside of the bust, which is open below: nobody wants to look into it, and scenes' lamps leave it black.

What of the neck and shoulders turns its back on the eye, and has no skin before it, is not drawn, so that the bust ends at its
edge from every side. Exported splats have all of it: other programs look at them from everywhere.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from ..geometry.camera import Camera
from ..geometry.libraries import as_like, to_numpy
from ..hair.drawing import Hiding
from ..hair.ribbons import Eye
from ..light.resting import Texels
from ..light.transfer import vertex_normals
from ..splat import Gaussians
from .evaluator import Evaluator, Inputs, OpenAvatar

BACK = (-0.2, 0.0)  # cosine between the skin's normal and the way to the eye: gone below the first, whole above the second
_BUST = "neck"
_PIXELS = 288  # of the picture of the bust that says what has skin before it: its cells are 6 mm of a bust
_RINGS = 2  # of vertices beyond those that are seen
_NEAREST = 0.05  # metres: of a bust that is nearer to the eye, nothing is left out for being behind skin


def from_far(view: np.ndarray) -> Camera:
    """An orthographic camera that sees a head from a direction, the unit vector [3] from it towards the camera."""
    yaw, pitch = math.degrees(math.atan2(view[0], view[2])), math.degrees(math.asin(float(np.clip(view[1], -1.0, 1.0))))
    return dataclasses.replace(Camera.orbit(1, 1, yaw, pitch), fx=1.0, fy=1.0, orthographic=True)


def without_inside(
    own: Gaussians, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, lod: int, camera: Camera,
    hidden_from: Callable[[Camera], Hiding],
) -> Gaussians:  # fmt: skip
    """Return Gaussians without the inside of the bust that a camera would see.

    Args:
        own: Of the skin, head space.
        evaluator: Has the mesh.
        target: Whose they are.
        inputs: Of this frame.
        lod: Level of detail of `own`.
        camera: In head space.
        hidden_from: What skin hides from a camera.
    """
    bust, faces, rows = evaluator.cache.get((target.id, "bust"), lambda: _parts(target, evaluator.texels(target)))
    vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
    normals, here = vertex_normals(vertices, target.model.head_model.faces)[bust], vertices[bust]
    towards = -camera.forward if camera.orthographic else camera.position - here
    cosine = (normals * towards).sum(1) / np.linalg.norm(towards, axis=-1).clip(1e-9)
    share = np.clip((cosine - BACK[0]) / (BACK[1] - BACK[0]), 0.0, 1.0)
    bare = np.ones(len(here), np.float32)
    near = _on_bust(camera, here)
    if near is not None:
        hidden_from(near).hide(np.ascontiguousarray(here, np.float32), Eye.of(near).numbers(), bare)
    hollow = np.zeros(len(vertices), bool)
    hollow[bust] = (bare > 0) & (share < 1.0)
    if not hollow.any():
        return own
    for _ in range(_RINGS):  # up behind the edge; farther behind skin, it closes what gaps that has
        hollow[faces[hollow[faces].any(1)]] = True
    seen = np.ones(len(vertices), np.float32)
    seen[bust] = np.where(hollow[bust], share * share * (3.0 - 2.0 * share), 1.0)
    texels = evaluator.texels(target)
    left = np.ones(len(texels.corners), np.float32)
    left[rows] = (texels.barycentric[rows] * seen[texels.corners[rows]]).sum(1)
    left = left if lod == 0 else left[evaluator.blocks(target, lod).middle]
    return dataclasses.replace(own, opacities=own.opacities * as_like(left, own.opacities))


def _parts(target: OpenAvatar, texels: Texels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of the bust, the faces at them, and the numbers of the texels on these."""
    head = target.model.head_model
    bust = head.marked(_BUST)
    touched = bust[head.faces].any(1)
    return np.flatnonzero(bust), head.faces[touched], np.flatnonzero(touched[texels.face])


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
