"""What a person looks like, painted onto the head's UV map: a picture for wherever only the mesh is drawn.

A Gaussian is translucent and may stand centimetres off its texel, so that the colors of texels alone are no picture of a face.
Here the person is drawn from all around, and every texel of the picture takes what the views show where it is on the mesh,
most from those that look straight at it. Needs numpy only; whoever calls `paint` draws: a session, or the model itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.triangles import face_normals
from ..geometry.zbuffer import triangle_depth
from ..head import HeadModel
from ..pictures.images import quantize
from ..pictures.sampling import bilinear
from .layout import texel_layout
from .portrait import portrait_camera

PIXELS = 256
"""Side of the painting."""
VIEW_PIXELS = 512
_YAWS, _ABOVE, _BELOW = (0, 30, -30, 60, -60, 95, -95, 135, -135, 180), (0, 90, 180, -90), (0, 50, -50)
_CLOSED = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0, "jawOpen": 0.5}
_WIDE = {"eyeWideLeft": 1.0, "eyeWideRight": 1.0, "jawOpen": 0.2}
_VIEWS: tuple[tuple[float, float, Mapping[str, float], float], ...] = (
    *((yaw, 0.0, {}, 1.0) for yaw in _YAWS),
    *((yaw, 50.0, {}, 1.0) for yaw in _ABOVE),
    *((yaw, -30.0, {}, 1.0) for yaw in _BELOW),
    *((0.0, pitch, controls, 0.01) for pitch in (0.0, -20.0) for controls in (_WIDE, _CLOSED)),
)
"""Yaw and pitch in degrees, expression, and weight: what other expressions show counts where the face at rest hides it."""
_HIDDEN = 0.002  # metres behind the nearest surface from which on a texel is not seen
_STRAIGHT = 4  # power of the cosine between normal and view: edge-on views smear
_FEW = 1e-4  # weight below which a texel counts as unseen
_COVERED = 0.3  # alpha from which on a pixel's color means something


class View(NamedTuple):
    """One picture of a person.

    Attributes:
        vertices: The posed mesh, head space, metres, [V, 3].
        rgb: Display sRGB times alpha, [H, W, 3].
        alpha: [H, W].
    """

    vertices: np.ndarray
    rgb: np.ndarray
    alpha: np.ndarray


def paint(head: HeadModel, draw: Callable[[Mapping[str, float], Camera], View], pixels: int = PIXELS) -> np.ndarray:
    """Paint a person.

    Args:
        head: The mesh and its UV map.
        draw: Draws the person with named expressions as a camera in head space sees it.
        pixels: Side of the picture.

    Returns:
        Display sRGB, uint8, [pixels, pixels, 3], the row of v = 0 first. Texels off the map, and those that no view shows,
        take the colors around them.
    """
    layout = texel_layout(head.uv, head.uv_faces, pixels)
    corners = head.faces[layout.face]  # [N, 3]
    solid = head.faces[~head.marked("lashes")[head.faces].any(1)]
    total, weights = np.zeros((len(layout), 3), np.float32), np.zeros(len(layout), np.float32)
    for yaw, pitch, controls, share in _VIEWS:
        camera = portrait_camera(VIEW_PIXELS, yaw, pitch)
        view = draw(controls, camera)
        points = (view.vertices[corners] * layout.barycentric[..., None]).sum(1)
        normals = face_normals(view.vertices, head.faces)[layout.face]
        towards = camera.position - points
        lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1)
        facing = np.maximum((normals * towards).sum(1) / np.maximum(lengths, 1e-20), 0.0)
        local, places = camera.project(points)
        column, row = (np.clip(places[:, k].astype(int), 0, VIEW_PIXELS - 1) for k in range(2))
        seen = local[:, 2] < triangle_depth(view.vertices[solid], camera)[row, column] + _HIDDEN
        cover = bilinear(view.alpha, places)
        weight = (share * facing**_STRAIGHT * seen * (cover > _COVERED)).astype(np.float32)
        total += weight[:, None] * bilinear(view.rgb, places) / np.maximum(cover, _COVERED)[:, None]
        weights += weight
    seen = weights > _FEW
    picture, known = np.zeros((pixels * pixels, 3), np.float32), np.zeros(pixels * pixels, bool)
    picture[layout.texel[seen]] = total[seen] / weights[seen, None]
    known[layout.texel[seen]] = True
    return quantize(fill_unknown(picture.reshape(pixels, pixels, 3), known.reshape(pixels, pixels)))


def fill_unknown(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill unknown pixels of [H, W, 3] from the known ones around them, by pyramids: each level of half the size is filled."""
    if known.all() or min(known.shape) < 2:
        return picture
    weight = known.astype(np.float32)[..., None]
    sums, counts = (
        part[0::2, 0::2] + part[1::2, 0::2] + part[0::2, 1::2] + part[1::2, 1::2] for part in (picture * weight, weight)
    )
    coarse = fill_unknown(sums / np.maximum(counts, 1.0), counts[..., 0] > 0)
    rows, columns = (np.arange(size) for size in known.shape)
    places = np.stack(np.broadcast_arrays(columns[None, :] / 2 + 0.25, rows[:, None] / 2 + 0.25), -1)
    enlarged = bilinear(coarse, places) if min(coarse.shape[:2]) > 1 else np.broadcast_to(coarse[:1, :1], picture.shape)
    return np.where(known[..., None], picture, enlarged)
