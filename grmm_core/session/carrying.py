"""Avatars of weights that are not installed, carried over to those that are: nothing that a user has made is lost.

Shape, expression and pose belong to the head model and stay. Colors come from the painting of the person on the UV map that the
file carries; codes become those of the training people's mean. What the other weights alone knew is gone: how this face
changes with expression, and hair that was in the Gaussians, in whose color a plain groom grows. Called by `local`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..avatar import AssetReference, Avatar, Hair
from ..avatar.deltas import APPEARANCE, rounded
from ..hair.packaged import HEAD, library_groom
from ..hair.settings import HairSettings
from ..head import HeadModel
from ..model.config import COLOR_CHANNELS
from ..model.layout import TexelLayout
from ..model.store import LoadedModel
from ..pictures.sampling import bilinear

GROOM = "crop"
_INSIDE = ("mouth_interior", "upper_teeth", "lower_teeth", "tongue", "lashes")  # what a painting hardly shows
_BALD = 0.08  # difference of colors, display sRGB, up to which a painted scalp is skin


def can_carry(avatar: Avatar, loaded: LoadedModel[Any]) -> bool:
    """Whether an avatar says enough to be carried over to weights: their head model, and a painting."""
    info = loaded.info
    same = avatar.head.name == info.head_name and info.stands_on(avatar.head.sha256)
    return same and avatar.painting.size > 0 and loaded.model.config.residuals and len(info.people) > 0


def without_changes(avatar: Avatar, loaded: LoadedModel[Any]) -> Avatar:
    """The avatar's shape and pose with the mean code of the weights."""
    info, size = loaded.info, loaded.model.z_exp_size
    return replace(
        avatar, weights=AssetReference(info.name, info.sha256), z_id=info.z_id.mean(0), z_exp=np.zeros(size, np.float32),
        deltas={},
    )  # fmt: skip


def in_its_colors(plain: Avatar, loaded: LoadedModel[Any], colors: np.ndarray) -> Avatar:
    """Give an avatar `without_changes` the colors of its painting.

    Args:
        plain: The avatar.
        loaded: Its weights.
        colors: What they make of it at rest, display sRGB [N, 3].
    """
    model = loaded.model
    head, layout = model.head_model, model.layout
    uv = (np.asarray(head.uv)[np.asarray(head.uv_faces)[layout.face]] * layout.barycentric[..., None]).sum(1)
    painted = bilinear(plain.painting.astype(np.float32) / 255.0, uv * len(plain.painting))
    scalp = _share(head, layout, "scalp")
    face = (_share(head, layout, "face") > 0.99) & (scalp < 0.01)
    skin = np.median(painted[face], 0) if face.any() else painted.mean(0)
    hair = plain.hair
    if model.config.hairless and hair is None:
        top = np.median(painted[scalp > 0.99], 0)
        if np.abs(top - skin).max() > _BALD and head.name == HEAD:
            hair = Hair(library_groom(GROOM), _dyed(top))
        painted = painted + scalp[:, None] * (skin - painted)
    known = 1.0 - np.maximum.reduce([_share(head, layout, name) for name in _INSIDE])
    changed = np.zeros((len(uv), COLOR_CHANNELS + model.config.features), np.float32)
    changed[:, :COLOR_CHANNELS] = known[:, None] * (painted - colors)
    return replace(plain, deltas={APPEARANCE: rounded(changed)}, hair=hair)


def _share(head: HeadModel, layout: TexelLayout, name: str) -> np.ndarray:
    """How far each texel belongs to a region, 0..1 [N]."""
    marks = head.marked(name).astype(np.float32)[np.asarray(head.faces)[layout.face]]
    share: np.ndarray = (marks * layout.barycentric).sum(1)
    return share


def _dyed(color: np.ndarray) -> HairSettings:
    red, green, blue = (float(value) for value in np.clip(color, 0.0, 1.0))
    return HairSettings().changed(dye=1.0, dye_red=red, dye_green=green, dye_blue=blue)
