"""Pictures of a track: the fitted mesh as a wire over the photo, with found and fitted landmarks.

For the fit panel's preview, for the evaluation's sheets, and to look at while developing. Needs Pillow.
"""

from __future__ import annotations

import numpy as np

from ..geometry.zbuffer import triangle_depth
from ..head.model import HeadModel
from ..pictures.images import quantize
from .outline import project_points
from .types import PhotoTrack

FOUND_COLOR, FITTED_COLOR = (60, 255, 90), (255, 50, 50)
_WIRE_COLOR = (90, 200, 255)
_EYE_COLOR = (255, 220, 60)
_DEPTH_SLACK = 0.004  # metres that a point may lie behind the surface and still be drawn


def overlay_picture(
    track: PhotoTrack, head: HeadModel, *, wire: bool = True, landmarks: bool = True, mask: bool = False, scale: int = 1
) -> np.ndarray:
    """Draw a track over its working picture.

    Args:
        track: What to draw.
        head: The head model that it refers to.
        wire: Draw the visible mesh edges.
        landmarks: Draw found (green) and fitted (red) landmarks, joined by a line.
        mask: Darken what is not the person.
        scale: Integer magnification of the working picture.

    Returns:
        uint8, [H * scale, W * scale, 3].
    """
    from PIL import Image, ImageDraw

    pixels = track.image * (0.35 + 0.65 * track.mask[:, :, None]) if mask else track.image
    height, width = pixels.shape[:2]
    picture = Image.fromarray(quantize(pixels)).resize((width * scale, height * scale), Image.Resampling.BICUBIC)
    if wire:
        layer = Image.new("RGBA", picture.size, (0, 0, 0, 0))
        _draw_wire(ImageDraw.Draw(layer), track, head, scale)
        picture = Image.alpha_composite(picture.convert("RGBA"), layer).convert("RGB")
    if landmarks:
        draw = ImageDraw.Draw(picture)
        radius = max(0.6, track.eye_distance * scale / 90.0)
        for found, fitted in zip(track.landmarks * scale, track.landmarks_fitted * scale, strict=True):
            draw.line([tuple(found.tolist()), tuple(fitted.tolist())], fill=(255, 255, 255))
            for (x, y), color in ((found, FOUND_COLOR), (fitted, FITTED_COLOR)):
                draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=color)
    return np.asarray(picture)


def track_vertices(track: PhotoTrack, head: HeadModel) -> np.ndarray:
    """Posed vertices of a track's head in head space, metres, [V, 3]."""
    return head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))


def _draw_wire(draw: object, track: PhotoTrack, head: HeadModel, scale: int) -> None:
    camera = track.camera
    vertices = track_vertices(track, head).astype(np.float64)
    depth = triangle_depth(vertices[head.faces], camera)
    local, pixels = project_points(vertices, camera)
    columns = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
    rows = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
    visible = local[:, 2] < depth[rows, columns] + _DEPTH_SLACK
    corners = pixels[head.faces]  # [F, 3, 2]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    front = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0.0  # y points down
    faces = head.faces[front]
    eyeballs = np.zeros(head.vertex_count, bool)
    for name in ("left_eyeball", "right_eyeball"):
        if name in head.regions:
            eyeballs[head.regions[name]] = True
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    edges = edges[visible[edges].all(axis=1)]
    for a, b in edges:
        color = _EYE_COLOR if eyeballs[a] else _WIRE_COLOR
        draw.line([tuple((pixels[a] * scale).tolist()), tuple((pixels[b] * scale).tolist())], fill=(*color, 70))
