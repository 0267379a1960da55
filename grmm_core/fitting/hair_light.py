"""Hair in a photo as the studio's light would show it: what a session's light makes of the strands is taken out.

Colors of strands are flat, as those of skin are: found in a photo as it is, they would be lit twice. Called by `api`.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from ..avatar import EXTENSION, Avatar, Hair, save_avatar
from ..hair.coloring import with_colors
from ..hair.roots import BEARD, GROUPS, SCALP
from ..head import HeadModel
from ..light.lamps import Lighting
from ..light.relight import to_display, to_linear
from ..photo.parser import PhotoParts
from ..session import Instance, RenderOptions, Session
from .blurring import blurred
from .hair_view import hair_view, hardly_shown
from .photo_light import MATT
from .result import photo_controls, photo_light
from .tilt import hung_free
from .types import PhotoTrack

SIDE = 384  # pixels: longer side of the pictures that tell the light
SMOOTH = 3.0  # pixels: strands are never quite where the photo has them
LEAST, MOST = 0.3, 3.0  # light relative to the studio's that is believed
_THIN = 1e-3


def unlit_hair(
    session: Session, avatar: Avatar, tracks: Sequence[PhotoTrack], parts: Sequence[PhotoParts], head: HeadModel
) -> tuple[Hair | None, list[PhotoTrack]]:
    """Take the photos' light out of hair.

    Args:
        session: With the avatar's weights.
        avatar: Fitted, with strands; its file need not be there.
        tracks: Photos it was fitted to.
        parts: What their pixels show.
        head: Head model.

    Returns:
        The hair with pigments anew, and the photos with hair in the studio's light.
    """
    hair = avatar.hair
    lights = [photo_light(avatar, index).lighting for index in range(len(tracks))]
    if hair is None or hair.groom is None or all(light is None for light in lights):
        return hair, list(tracks)
    with tempfile.TemporaryDirectory(prefix="grmm-") as folder:
        path = Path(folder) / f"lit{EXTENSION}"
        save_avatar(dataclasses.replace(avatar, hair=hung_free(hair, tracks, head)), path)  # a session hangs it
        number = session.open(path).id
        shown = [Instance(number, photo_controls(avatar, head, index), wrinkles=0.0) for index in range(len(tracks))]
        unlit = [
            track if light is None else _unlit(session, instance, track, light)
            for instance, track, light in zip(shown, tracks, lights, strict=True)
        ]
        session.release(number)
    groom = hair.groom
    scalp = groom.groups == SCALP
    views = [hair_view(track, seen, head) for track, seen in zip(unlit, parts, strict=True)]
    if scalp.any() and not hardly_shown(views[0], parts[0]):
        settings = with_colors(hair.settings, groom.select(scalp), views, head)
        hair = dataclasses.replace(hair, settings=settings)
    beard, name = groom.groups == BEARD, GROUPS[BEARD]
    if beard.any():
        bearded = [dataclasses.replace(view, hair=seen.beard) for view, seen in zip(views, parts, strict=True)]
        settings = with_colors(hair.parts.get(name, hair.settings.for_part(BEARD)), groom.select(beard), bearded, head)
        hair = dataclasses.replace(hair, parts={**hair.parts, name: settings})
    return hair, unlit


def _unlit(session: Session, instance: Instance, track: PhotoTrack, light: Lighting) -> PhotoTrack:
    camera = track.camera
    scale = min(1.0, SIDE / max(camera.width, camera.height))
    small = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    options = RenderOptions(refine=False, passes=("linear", "hair"))
    flat = session.render([instance], small, options)
    lit = session.render([dataclasses.replace(instance, response=MATT, lighting=light)], small, options)
    planes = np.concatenate([buffers["linear"][..., :3] * flat["hair"] for buffers in (lit, flat)], 2)
    soft = blurred(planes.transpose(2, 0, 1), SMOOTH)
    ratio = ((soft[:3] + _THIN) / (soft[3:] + _THIN)).clip(LEAST, MOST)
    size = track.image.shape[:2]
    whole = functional.interpolate(torch.from_numpy(ratio)[None], size, mode="bilinear", align_corners=False)[0]
    linear = np.asarray(to_linear(track.image.astype(np.float64))) / whole.permute(1, 2, 0).numpy()
    return dataclasses.replace(track, image=np.asarray(to_display(linear)).clip(0.0, 1.0).astype(track.image.dtype))
