"""The skin under scalp hair: in the shade of the roots, so that no bright stripe shines through where strands part.

Drawn strands are fewer than hairs, and a parting is a line of skin no wider than they are thick. Imports torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from ..avatar import Avatar
from ..avatar.deltas import APPEARANCE
from ..geometry.camera import Camera
from ..hair.coloring import WornHair
from ..hair.roots import SCALP
from ..light.resting import Texels
from ..model.grmm import GRMM
from .photo_light import seen_texels
from .photo_targets import FitView, bare_pixels

ROOTS = 2000  # that stand for all
REACH, FADE = 0.010, 0.006  # metres from a root that its shade reaches, and over which it ends
SHARE, SHADE = 0.75, 0.8  # of the hair's color in the skin's, and how much darker than strands that is
SURELY = 0.4  # cosine between normal and view from which on skin that is seen bare is wholly believed to be
_CHUNK, _SIDE = 4096, 256


def shaded_scalp(model: GRMM, avatar: Avatar, views: Sequence[FitView]) -> Avatar:
    """An avatar whose skin takes the shade of its scalp hair where that is rooted and no photo shows it bare.

    Args:
        model: With the avatar's own changes.
        avatar: Fitted to photos.
        views: The photos.
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
    share *= 1.0 - _bare(model, views)[:, None]
    camera = Camera.orbit(_SIDE, _SIDE, 0.0, 0.0)
    worn = WornHair(roots, avatar.hair.settings, vertices, camera, head)
    shade = SHADE * worn.gaussians(avatar.hair.settings).colors.mean(0)
    change = np.zeros_like(avatar.deltas[APPEARANCE])
    change[:, :3] = share * (shade - colors)
    return dataclasses.replace(avatar, deltas={**avatar.deltas, APPEARANCE: avatar.deltas[APPEARANCE] + change})


def _bare(model: GRMM, views: Sequence[FitView]) -> np.ndarray:
    """How surely photos show the texels of an avatar as bare skin, 0..1 [N]."""
    head, layout = model.head_model, model.layout
    texels = Texels.of(head, layout.face, layout.barycentric)
    bare = np.zeros(len(layout))
    for view in views:
        posed = head.vertices(*(part.cpu().numpy() for part in (view.shape, view.expression, view.pose)))
        facing = seen_texels(head, texels, posed, view.camera, bare_pixels(view))[1]
        bare = np.maximum(bare, (facing / SURELY).clip(0.0, 1.0))
    return bare
