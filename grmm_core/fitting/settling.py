"""The last steps: skin under strands and in a session's light looks as the fit has it.

Skin is fitted bare. Brows, lashes and fringes that are drawn over it darken it again, and a session's light, which knows the
avatar's own mesh and albedo, is not the fit's to the last per cent. What of that shows is taken out of the skin's colors,
smoothed, so that no strand leaves its negative on the skin. Of several photos skin is compared in the studio's light, and what
each photo shows otherwise then becomes a part of its own light. Imports torch.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import torch

from ..avatar import EXTENSION, Avatar, save_avatar
from ..avatar.deltas import APPEARANCE, rounded
from ..controls.frame import Controls
from ..geometry.libraries import to_numpy
from ..light.cornea import on_eyes
from ..model.grmm import GRMM, Picture
from ..session import Instance, RenderOptions, Session
from .blurring import blurred
from .inpainting import corners_of
from .invert import photo_error, photo_model_inputs, photo_views, seen_in
from .lids import lash_line
from .local_light import more_fine, more_local, on_face
from .objective import contributions, decode, spread_to_colors
from .photo_light import MATT, Light
from .photo_targets import FitView, bare_pixels
from .result import FINE, LOCAL, photo_controls, photo_light
from .types import PhotoTrack

SMOOTH = 2.0  # pixels: what is finer are the strands themselves
COVERED = 0.7  # of a pixel by strands: under more, nothing is known of skin
MOST = 0.15  # change of a color
BARE = 0.05  # of a pixel by strands, from which on it tells no light of skin
SLANT = 0.08  # cosine between normal and view from which on it does: the chin's underside is seen at a slant
FINE_ROUNDS = 2  # of `local_light.more_fine`, each by another drawing: texels and pixels are about as large
HALF_SEEN = 0.1  # pixels at which a texel is half believed
_OPTIONS = RenderOptions(passes=("rgb", "alpha", "hair"), background=(0.0, 0.0, 0.0))


def settled(
    session: Session, model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], aims: Sequence[tuple[FitView, Picture]],
    *, lit: bool = True,
) -> Avatar:  # fmt: skip
    """An avatar whose skin, worn and lit by a session, differs less from its bare fit where its photos show skin.

    Args:
        session: With the avatar's weights.
        model: With the avatar's own changes.
        avatar: Fitted, with strands.
        tracks: Its photos.
        aims: The avatar without strands in each photo's view, of `invert.photo_pictures`.
        lit: Whether these are in the photos' lights.
    """
    if avatar.hair is None or avatar.hair.groom is None or APPEARANCE not in avatar.deltas:
        return avatar
    colors = np.array(avatar.deltas[APPEARANCE], np.float32)
    colors[:, :3] += _step(session, avatar, model, tracks, aims, lit).clamp(-MOST, MOST).cpu().numpy()
    return dataclasses.replace(avatar, deltas={**avatar.deltas, APPEARANCE: rounded(colors)})


def _step(
    session: Session, avatar: Avatar, model: GRMM, tracks: Sequence[PhotoTrack], aims: Sequence[tuple[FitView, Picture]],
    lit: bool,
) -> torch.Tensor:  # fmt: skip
    """Change of the colors that brings what the session draws nearer to the aims, [N, 3]."""
    total = aims[0][1].image.new_zeros(model.gaussian_count, 3)
    weight = total[:, :1]
    with _opened(session, avatar) as number, torch.no_grad():
        for (view, drawn), track in zip(aims, tracks, strict=True):
            controls = photo_controls(avatar, model.head_model, view.index)
            instance = Instance(number, controls)
            if lit:
                instance = dataclasses.replace(instance, response=MATT, lighting=photo_light(avatar, view.index).lighting)
            worn = session.render([instance], view.camera, _OPTIONS)
            bare = bare_pixels(view) * (1.0 - worn["hair"][..., 0])
            counts = (bare > 1.0 - COVERED)[..., None]
            off = blurred(((drawn.image.cpu().numpy() - worn["rgb"]) * counts).transpose(2, 0, 1), SMOOTH).transpose(1, 2, 0)
            inputs = photo_model_inputs(model, avatar, track, view.index)[0]
            seen = view, model.mesh(inputs).vertices, decode(model, inputs, view.camera)
            step = spread_to_colors(model, *seen, torch.as_tensor(off * counts).to(total))
            shown = contributions(model, *seen, torch.as_tensor(bare).to(total))[:, None]
            shown = shown / (shown + HALF_SEEN)
            total, weight = total + shown * step, weight + shown
    total[torch.as_tensor(on_eyes(model.head_model, corners_of(model)), device=total.device)] = (
        0.0  # lashes over an eye are no matter of its colors
    )
    return total / weight.clamp(min=1.0)


def locally_lit(session: Session, model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack]) -> Avatar:
    """An avatar whose photos' lights have what they still lack (`local_light`), drawn by a session, strands and all.

    Args:
        session: With the avatar's weights.
        model: With the avatar's own changes.
        avatar: Finished but for that.
        tracks: Its photos.
    """
    if LOCAL not in avatar.tracking:
        return avatar
    head, texels, found = model.head_model, model.lit_texels, []
    face, lashed = on_face(head, texels), to_numpy(lash_line(model)[0]) > 0.0
    lashed[on_eyes(head, corners_of(model))] = True  # eyes, and the line around them: strands lie over these
    with _opened(session, avatar) as number, torch.no_grad():
        for view, track in zip(photo_views(model, tracks), tracks, strict=True):
            light, controls = photo_light(avatar, view.index), photo_controls(avatar, head, view.index)
            shown = model, texels, photo_model_inputs(model, avatar, track, view.index)[0], view

            worn = partial(_worn, session, number, controls, view)
            drawn = worn(light)
            strands = drawn["hair"][..., 0]
            seen = seen_in(*shown, None, (strands < BARE).astype(np.float32), SLANT)
            light = light._replace(local=more_local(head, texels, seen, seen_in(*shown, drawn["rgb"]).colors, light.local))
            skin = seen.of_skin(head, texels)
            amid_lashes = seen_in(*shown, None, (strands < COVERED).astype(np.float32), SLANT).weights
            skin = skin._replace(weights=np.where(lashed, amid_lashes, skin.weights * face))
            light = light._replace(fine=np.zeros((len(texels.face), 3), np.float32))
            for _ in range(FINE_ROUNDS):
                light = light._replace(fine=more_fine(skin, seen_in(*shown, worn(light)["rgb"]).colors, light.fine))
            found.append(light)
    local, fine = np.stack([light.local for light in found]), np.stack([light.fine for light in found])
    return dataclasses.replace(avatar, tracking={**avatar.tracking, LOCAL: local, FINE: fine})


def worn_errors(session: Session, model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack]) -> list[float]:
    """RMSE of an avatar in each photo's view and light (`invert.photo_error`), as a session draws it, strands and all."""
    errors = []
    with _opened(session, avatar) as number, torch.no_grad():
        for view in photo_views(model, tracks):
            controls, light = photo_controls(avatar, model.head_model, view.index), photo_light(avatar, view.index)
            drawn = _worn(session, number, controls, view, light)
            image, alpha = (torch.as_tensor(drawn[name]).to(view.image) for name in ("rgb", "alpha"))
            errors.append(photo_error(view, Picture(image, image, alpha[..., 0], torch.zeros_like(alpha[..., 0]))))
    return errors


def _worn(session: Session, number: int, controls: Controls, view: FitView, light: Light) -> dict[str, np.ndarray]:
    """An avatar in a photo's view, in a light."""
    return session.render([Instance(number, controls, response=MATT, lighting=light.lighting)], view.camera, _OPTIONS)


@contextmanager
def _opened(session: Session, avatar: Avatar) -> Iterator[int]:
    """An avatar's number in a session, which forgets it afterwards."""
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder:
        path = Path(folder) / f"worn{EXTENSION}"
        save_avatar(avatar, path)
        number = session.open(path).id
    try:
        yield number
    finally:
        session.release(number)
