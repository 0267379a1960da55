"""From the inversion's tensors to an avatar, and from an avatar back to what its photos showed.

`photo_controls` and `photo_camera` need numpy only, so that Blender's panel can set the rig as a photo shows it.
Called by `invert`, the evaluation, the command line and Blender.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import AssetReference, Avatar, PhotoRecord, Provenance
from ..avatar.deltas import rounded
from ..avatar.types import MADE_BY, SHAPE_SIZE
from ..controls.frame import ALIGNED_TO_ARKIT, Controls, weights_of
from ..errors import ShapeError
from ..geometry.camera import Camera
from ..head import HeadModel, arkit_gain
from .photo_light import Light
from .types import PhotoTrack

if TYPE_CHECKING:
    from ..model.weights_file import WeightsInfo

LIGHT = "light_"  # before the names of a `photo_light.Light`'s parts in an avatar's arrays
LOCAL, FINE = LIGHT + "local", LIGHT + "fine"  # there where skin is told from the rest
LICENCE = "Shows a real person. To be used only with that person's agreement."


def make_avatar(
    name: str, tracks: Sequence[PhotoTrack], info: WeightsInfo, z_id: np.ndarray, z_exp: np.ndarray,
    deltas: Mapping[str, np.ndarray], tracking: Mapping[str, np.ndarray],
) -> Avatar:  # fmt: skip
    """Put an avatar together; its photos are named without hashes, which whoever has read the files adds.

    Args:
        name: Display name.
        tracks: Photos.
        info: Weights that the codes belong to.
        z_id: [Z].
        z_exp: [Y].
        deltas: Changes of the weights by parameter name; rounded to half precision, in which they are stored.
        tracking: Further arrays, one row a photo: aligned [P, 60], z_exp [P, Y], those of `photo_light.Light`, rmse [P].
    """
    shape = np.zeros(SHAPE_SIZE, np.float32)
    shape[: len(tracks[0].shape)] = tracks[0].shape[:SHAPE_SIZE]
    cameras = [track.photo_camera for track in tracks]
    numbers = [(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in cameras]
    found = {
        "expression": np.stack([track.expression for track in tracks]),
        "pose": np.stack([track.pose for track in tracks]),
        "camera_matrix": np.stack([c.world_to_camera for c in cameras]),
        "camera_numbers": np.array(numbers),
    }
    return Avatar(
        name=name,
        head=AssetReference(info.head_name, info.head_sha256),
        weights=AssetReference(info.name, info.sha256),
        z_id=z_id,
        z_exp=z_exp,
        shape=shape,
        camera=cameras[0],
        tracking={**found, **tracking},
        deltas={key: rounded(value) for key, value in deltas.items()},
        provenance=Provenance(
            made_by=MADE_BY, from_photos=True, photos=tuple(PhotoRecord(track.source, "") for track in tracks), licence=LICENCE,
        ),
    )  # fmt: skip


def photo_camera(avatar: Avatar, index: int = 0) -> Camera:
    """Camera of a whole photo in head space. Raises `ShapeError` where the avatar has no such photo."""
    matrix, numbers = _row(avatar, "camera_matrix", index), _row(avatar, "camera_numbers", index)
    fx, fy, cx, cy, width, height = (float(value) for value in numbers)
    return Camera(matrix.astype(np.float64), fx, fy, cx, cy, round(width), round(height))


def photo_controls(avatar: Avatar, head: HeadModel, index: int = 0) -> Controls:
    """Controls that show the avatar as it is in a photo.

    Raises:
        ShapeError: The avatar has no such photo.
    """
    expression, aligned = _row(avatar, "expression", index), _row(avatar, "aligned", index)
    by_name = aligned @ ALIGNED_TO_ARKIT @ np.asarray(head.arkit_to_expression, np.float32)  # [E]
    return Controls(
        aligned=weights_of(aligned, arkit_gain(head, avatar.shape)),
        expression=expression - by_name[: len(expression)],
        pose=_row(avatar, "pose", index).copy(),
        z_exp=_row(avatar, "z_exp", index).copy(),
    )


def photo_light(avatar: Avatar, index: int = 0) -> Light:
    """Light of a photo, in the axes of the head; the studio's where it is not known, as of avatars of earlier versions.

    Raises:
        ShapeError: The avatar has no such photo, or its file is damaged.
    """
    if LIGHT + "suns" not in avatar.tracking:
        _row(avatar, "pose", index)
        return Light.studio()
    known = [name for name in Light._fields if LIGHT + name not in (LOCAL, FINE) or LIGHT + name in avatar.tracking]
    light = Light(**{name: _row(avatar, LIGHT + name, index) for name in known})
    usual = Light.studio()._replace(local=light.local, fine=light.fine)  # what lies on the skin is checked with the head
    if any(np.shape(value) != np.shape(other) for value, other in zip(light, usual, strict=True)):
        raise ShapeError(f"The light of photo {index + 1} in {avatar.name!r} is damaged; make the avatar from photos again.")
    return light


def _row(avatar: Avatar, name: str, index: int) -> np.ndarray:
    table = avatar.tracking.get(name)
    if table is None or not np.ndim(table) or not 0 <= index < len(table):
        raise ShapeError(f"The avatar {avatar.name!r} does not know its photo {index + 1}; make it from photos again.")
    return table[index]
