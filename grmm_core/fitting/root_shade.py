"""The skin under scalp hair: in the shade of the roots, so that no bright stripe shines through where strands part.

Drawn strands are fewer than hairs, and a parting is a line of skin no wider than they are thick. Imports torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from ..avatar import Avatar
from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from ..hair.coloring import WornHair
from ..hair.roots import SCALP
from ..light.resting import Texels
from ..light.transfer import vertex_normals
from ..model.grmm import GRMM
from ..photo.parser import PhotoParts
from .types import PhotoTrack

ROOTS = 2000  # that stand for all
REACH, FADE = 0.010, 0.006  # metres from a root that its shade reaches, and over which it ends
SHARE, SHADE = 0.75, 0.8  # of the hair's color in the skin's, and how much darker than strands that is
APPEARANCE = "decoders.appearance_mean"
BEHIND = 0.004  # metres behind the mesh's depth that still are its surface
GRAZING = (0.1, 0.3)  # cosine between normal and view: from where on skin is believed to be bare, and wholly
_CHUNK, _SIDE = 4096, 256


def shaded_scalp(
    model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack] = (), parts: Sequence[PhotoParts] = ()
) -> Avatar:  # fmt: skip
    """An avatar whose skin takes the shade of its scalp hair where that is rooted and no photo shows it bare.

    Args:
        model: With the avatar's own changes.
        avatar: Fitted to photos.
        tracks: The photos.
        parts: What their pixels show.
    """
    if avatar.hair is None or avatar.hair.groom is None or APPEARANCE not in avatar.deltas:
        return avatar
    head, strands = model.head_model, avatar.hair.groom.select(avatar.hair.groom.groups == SCALP)
    if not len(strands):
        return avatar
    vertices = np.asarray(head.v_template, np.float64)
    roots = strands.select(np.linspace(0, len(strands) - 1, min(ROOTS, len(strands))).astype(int))
    places = roots.frames(vertices, head.faces).at(vertices)[0]
    with torch.no_grad():
        z_id, shape = (
            torch.as_tensor(np.array(part), device=model.device, dtype=model.dtype) for part in (avatar.z_id, avatar.shape)
        )
        front = z_id.new_tensor([0.0, 0.0, 1.0])
        colors = model.appearance(model.z_identity(z_id, shape), front)[0].cpu().numpy()
        texels = model.anchor(torch.as_tensor(vertices, dtype=model.dtype, device=model.device)).positions.cpu()
        far = torch.cat([torch.cdist(part, torch.from_numpy(places).to(part)).amin(1) for part in texels.split(_CHUNK)]).numpy()
    share = SHARE * np.clip((REACH - far) / FADE, 0.0, 1.0)[:, None]
    share[head.marked("ears")[np.asarray(head.faces)[model.layout.face]].any(1)] = 0.0
    for track, seen in zip(tracks, parts, strict=True):
        share *= 1.0 - bare_texels(model, track, seen)[:, None]
    camera = Camera.orbit(_SIDE, _SIDE, 0.0, 0.0)
    worn = WornHair(roots, avatar.hair.settings, vertices, camera, head)
    shade = SHADE * worn.gaussians(avatar.hair.settings).colors.mean(0)
    change = np.zeros_like(avatar.deltas[APPEARANCE])
    change[:, :3] = share * (shade - colors)
    return dataclasses.replace(avatar, deltas={**avatar.deltas, APPEARANCE: avatar.deltas[APPEARANCE] + change})


def bare_texels(model: GRMM, track: PhotoTrack, parts: PhotoParts) -> np.ndarray:
    """How surely a photo shows the texels of an avatar as bare skin, 0..1 [N]."""
    head, layout = model.head_model, model.layout
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    texels = Texels.of(head, layout.face, layout.barycentric)
    points = texels.receivers(vertices, vertex_normals(vertices, head.faces))
    local, pixels = track.camera.project(points.points.astype(np.float64))
    rays = points.points - track.camera.position
    facing = -(points.normals * rays).sum(1) / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in enumerate((track.camera.width, track.camera.height)))
    near = local[:, 2] < triangle_depth(vertices[head.faces], track.camera)[row, column] + BEHIND
    there = (pixels >= 0.0).all(1) & (pixels < [track.camera.width, track.camera.height]).all(1)
    bare: np.ndarray = (there & near) * parts.skin[row, column] * track.valid[row, column] * np.clip((facing - GRAZING[0]) / (GRAZING[1] - GRAZING[0]), 0.0, 1.0)
    return bare
