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
from ..model.grmm import GRMM, Picture
from ..session import Instance, RenderOptions, Session
from .blurring import blurred
from .invert import photo_model_inputs
from .objective import contributions, decode, spread_to_colors
from .photo_light import MATT
from .photo_targets import FitView, bare_pixels
from .result import photo_controls, photo_light
from .root_shade import APPEARANCE
from .types import PhotoTrack

SMOOTH = 2.0  # pixels: what is finer are the strands themselves
COVERED = 0.7  # of a pixel by strands: under more, nothing is known of skin
MOST = 0.15  # change of a color
HALF_SEEN = 0.1  # pixels at which a texel is half believed


def settled(
    session: Session, model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], aims: Sequence[tuple[FitView, Picture]]
) -> Avatar:  # fmt: skip
    """An avatar whose skin, worn and lit by a session, differs less from its bare fit where its photos show skin.

    Args:
        session: With the avatar's weights.
        model: With the avatar's own changes.
        avatar: Fitted, with strands.
        tracks: Its photos.
        aims: The avatar without strands in each photo's view and light, of `invert.photo_pictures`.
    """
    if avatar.hair is None or avatar.hair.groom is None or APPEARANCE not in avatar.deltas:
        return avatar
    colors = np.array(avatar.deltas[APPEARANCE], np.float32)
    colors[:, :3] += _step(session, avatar, model, tracks, aims).clamp(-MOST, MOST).cpu().numpy()
    return dataclasses.replace(avatar, deltas={**avatar.deltas, APPEARANCE: colors})


def _step(
    session: Session, avatar: Avatar, model: GRMM, tracks: Sequence[PhotoTrack], aims: Sequence[tuple[FitView, Picture]],
) -> torch.Tensor:  # fmt: skip
    """Change of the colors that brings what the session draws nearer to the aims, [N, 3]."""
    options = RenderOptions(passes=("rgb", "hair"), background=(0.0, 0.0, 0.0))
    total = aims[0][1].image.new_zeros(model.gaussian_count, 3)
    weight = total[:, :1]
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder, torch.no_grad():
        path = Path(folder) / f"worn{EXTENSION}"
        save_avatar(avatar, path)
        number = session.open(path).id
        for (view, drawn), track in zip(aims, tracks, strict=True):
            lighting = photo_light(avatar, view.index).lighting
            controls = photo_controls(avatar, model.head_model, view.index)
            worn = session.render([Instance(number, controls, response=MATT, lighting=lighting)], view.camera, options)
            bare = bare_pixels(view) * (1.0 - worn["hair"][..., 0])
            counts = (bare > 1.0 - COVERED)[..., None]
            off = blurred(((drawn.image.cpu().numpy() - worn["rgb"]) * counts).transpose(2, 0, 1), SMOOTH).transpose(1, 2, 0)
            inputs = photo_model_inputs(model, avatar, track, view.index)[0]
            seen = view, model.mesh(inputs).vertices, decode(model, inputs, view.camera)
            step = spread_to_colors(model, *seen, torch.as_tensor(off * counts).to(total))
            shown = contributions(model, *seen, torch.as_tensor(bare).to(total))[:, None]
            shown = shown / (shown + HALF_SEEN)
            total, weight = total + shown * step, weight + shown
        session.release(number)
    return total / weight.clamp(min=1.0)
