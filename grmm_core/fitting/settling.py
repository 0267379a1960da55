"""The last step: skin under strands and in a session's light looks as the fit has it.

Skin is fitted bare. Brows, lashes and fringes that are drawn over it darken it again, and a session's light, which knows the
avatar's own mesh and albedo, is not the fit's to the last per cent. What of that shows is taken out of the skin's colors,
smoothed, so that no strand leaves its negative on the skin. Imports torch.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ..avatar import EXTENSION, Avatar, save_avatar
from ..head import HeadModel
from ..model.grmm import GRMM, Picture
from ..session import Instance, RenderOptions, Session
from .blurring import blurred
from .invert import photo_model_inputs, photo_pictures
from .objective import contributions, decode, spread_to_colors
from .photo_light import MATT
from .photo_targets import FitView, bare_pixels
from .result import photo_controls, photo_light
from .root_shade import APPEARANCE
from .types import PhotoTrack

ROUNDS = 2
SMOOTH = 2.0  # pixels: what is finer are the strands themselves
COVERED = 0.7  # of a pixel by strands: under more, nothing is known of skin
MOST = 0.15  # change of a color
HALF_SEEN = 0.1  # pixels at which a texel is half believed


def settled(session: Session, model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], head: HeadModel) -> Avatar:
    """An avatar whose skin, worn and lit by a session, differs less from its bare fit where its photos show skin.

    Args:
        session: With the avatar's weights.
        model: With the avatar's own changes.
        avatar: Fitted, with strands.
        tracks: Its photos.
        head: Head model.
    """
    if avatar.hair is None or avatar.hair.groom is None or APPEARANCE not in avatar.deltas:
        return avatar
    aims = photo_pictures(model, avatar, tracks)
    change = torch.zeros(model.gaussian_count, 3)
    for _ in range(ROUNDS):
        change = (change + _step(session, changed(avatar, change), model, tracks, aims, head)).clamp(-MOST, MOST)
    return changed(avatar, change)


def changed(avatar: Avatar, change: torch.Tensor) -> Avatar:
    """An avatar with other colors of its texels, [N, 3] more."""
    map_ = np.array(avatar.deltas[APPEARANCE], np.float32)
    map_[:, :3] += change.numpy()
    return dataclasses.replace(avatar, deltas={**avatar.deltas, APPEARANCE: map_})


def _step(
    session: Session, avatar: Avatar, model: GRMM, tracks: Sequence[PhotoTrack], aims: Sequence[tuple[FitView, Picture]],
    head: HeadModel,
) -> torch.Tensor:  # fmt: skip
    """Change of the colors that brings what the session draws nearer to the aims, [N, 3]."""
    total, weight = torch.zeros(model.gaussian_count, 3), torch.full((model.gaussian_count, 1), 1e-6)
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder, torch.no_grad():
        path = Path(folder) / f"worn{EXTENSION}"
        save_avatar(avatar, path)
        number = session.open(path).id
        for (view, drawn), track in zip(aims, tracks, strict=True):
            options = RenderOptions(passes=("rgb", "hair"), background=(0.0, 0.0, 0.0))
            light = photo_light(avatar, view.index).lighting
            controls = photo_controls(avatar, head, view.index)
            worn = session.render([Instance(number, controls, response=MATT, lighting=light)], view.camera, options)
            bare = torch.from_numpy(bare_pixels(view)) * (1.0 - torch.from_numpy(worn["hair"][..., 0]))
            off = (drawn.image - torch.from_numpy(worn["rgb"])) * (bare > 1.0 - COVERED)[..., None]
            off = torch.from_numpy(blurred(off.permute(2, 0, 1).numpy(), SMOOTH)).permute(1, 2, 0)
            inputs = photo_model_inputs(model, avatar, track, view.index)[0]
            attributes = decode(model, inputs, view.camera)
            vertices = model.mesh(inputs).vertices
            step = spread_to_colors(model, view, vertices, attributes, off * (bare > 1.0 - COVERED)[..., None])
            shown = contributions(model, view, vertices, attributes, bare)[:, None]
            shown = shown / (shown + HALF_SEEN)
            total, weight = total + shown * step, weight + shown
        session.release(number)
    return total / weight.clamp(min=1.0)
