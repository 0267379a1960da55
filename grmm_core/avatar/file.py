"""`.grmm` files: one avatar as a safetensors file with a JSON description. Nothing in it is ever executed.

Layout, versions 1 to 4. Metadata of the tensor file (all strings):

``format``          "grmm-avatar"
``format_version``  "4" for an avatar with lashes of its own, else "3" where changes are packed in eight bits, else "2"
                    for one with other hair of its own, else "1": the lowest that a reader must know
``avatar``          JSON object: name, head {name, sha256}, weights {name, sha256}, provenance {made_by, from_photos,
                    photos [{name, sha256}], date, licence}, camera or null, thumbnail (PNG, base64),
                    from version 2 on hair: {settings {name: number}, parts {part: settings}, scalp true/false} or null

Tensors, float32: ``z_id`` [Z], ``z_exp`` [Y], ``shape`` [300], ``expression`` [<=100], ``pose`` [5, 3],
``tracking/NAME`` any (int8 where that is exact and they are many), ``delta/PARAMETER`` in the shape of that parameter
(float16 where that is exact; from version 3 on maps [N, C] in int8, with float16 ``delta_scale/PARAMETER`` [C, ceil(N / 64)],
see `files.packing`), ``hair/NAME`` the strands as `hair.compact` has them, ``hair/PART/NAME`` those of brows, beard and lashes,
at most 1 MB in all; without them an avatar with hair settings has none. Lashes of earlier versions stood wrong on lids that
move: on the open head the package's take their place.
Uint8, where there is one: ``painting`` [P, P, 3]; what does not know it passes over it.

Called by sessions, fitting, the command line and Blender's panels (`read_avatar_header`). Needs numpy only.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, GrmmError, ShapeError
from ..files.tensorfile import read_metadata, read_tensors, write_tensors
from ..geometry.camera import Camera
from ..hair.compact import compact_parts, restored_parts
from ..hair.groom import Groom, join
from ..hair.packaged import HEAD, library_groom
from ..hair.roots import GROUPS, LASHES
from ..hair.settings import HairSettings
from .deltas import SCALE, delta_tensors, deltas_of
from .types import MAX_NAME_LENGTH, AssetReference, Avatar, Hair, PhotoRecord, Provenance

FORMAT_NAME = "grmm-avatar"
FORMAT_VERSION = 4
OWN_LASHES = 4  # version from which on lashes are as they shall be
EXTENSION = ".grmm"
_TRACKING = "tracking/"
_PAINTING = "painting"
_HAIR = "hair/"
_LARGE = 4096  # numbers from which on an array is tried in eight bits
_ARRAYS = ("z_id", "z_exp", "shape", "expression", "pose")
_HEX_DIGITS = frozenset("0123456789abcdef")


@dataclass(frozen=True)
class AvatarHeader:
    """What can be told about an avatar file without reading its tensors.

    Attributes:
        format_version: Version of the file's layout.
        name, head, weights, camera, provenance, thumbnail: As in `Avatar`.
        hair: The avatar's own hair without its strands, or None.
    """

    format_version: int
    name: str
    head: AssetReference
    weights: AssetReference
    camera: Camera | None
    provenance: Provenance
    thumbnail: bytes
    hair: Hair | None


def save_avatar(avatar: Avatar, path: str | os.PathLike[str]) -> None:
    """Write an avatar, whole or not at all. Raises `FileAccessError`."""
    description = {
        "name": avatar.name,
        "head": _reference_to_json(avatar.head),
        "weights": _reference_to_json(avatar.weights),
        "camera": _camera_to_json(avatar.camera),
        "provenance": {
            "made_by": avatar.provenance.made_by,
            "from_photos": avatar.provenance.from_photos,
            "photos": [{"name": photo.name, "sha256": photo.sha256} for photo in avatar.provenance.photos],
            "date": avatar.provenance.date,
            "licence": avatar.provenance.licence,
        },
        "thumbnail": base64.b64encode(avatar.thumbnail).decode("ascii"),
    }
    hair = avatar.hair
    version = 1 if hair is None else 2
    if hair is not None:
        parts = {name: settings.to_json() for name, settings in hair.parts.items()}
        description["hair"] = {"settings": hair.settings.to_json(), "parts": parts, "scalp": hair.scalp}
    tensors = {name: getattr(avatar, name) for name in _ARRAYS}
    tensors |= {_TRACKING + name: _in_bytes(array) for name, array in avatar.tracking.items()}
    changes = delta_tensors(avatar.deltas)
    tensors |= changes
    if avatar.painting.size:
        tensors[_PAINTING] = avatar.painting
    if hair is not None and hair.groom is not None:
        tensors |= {_HAIR + name: array for name, array in compact_parts(hair.groom).items()}
        version = OWN_LASHES if (hair.groom.groups == LASHES).any() else version
    version = max(version, 3 if any(name.startswith(SCALE) for name in changes) else 1)
    metadata = {
        "format": FORMAT_NAME,
        "format_version": str(version),
        "avatar": json.dumps(description, ensure_ascii=False, allow_nan=False),
    }
    write_tensors(path, tensors, metadata)


def _in_bytes(array: np.ndarray) -> np.ndarray:
    """Int8 where an array is large and that loses nothing; readers of every version take it for the numbers that it was."""
    if array.size < _LARGE or not np.abs(array).max() <= np.iinfo(np.int8).max:  # nor what is no number
        return array
    whole = array.astype(np.int8)
    return whole if np.array_equal(whole, array) else array


def read_avatar_header(path: str | os.PathLike[str]) -> AvatarHeader:
    """Read name, references, provenance and thumbnail of a file without its tensors.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Not an avatar, damaged, or made by a newer version.
    """
    path = Path(path)
    try:
        metadata = read_metadata(path)
    except FileFormatError as error:
        if path.suffix.lower() != EXTENSION:  # a photo or splats: nothing about them is damaged
            raise FileFormatError(f"{path} is no avatar; choose a {EXTENSION} file.") from error
        raise
    return _parse_header(path, metadata)


def load_avatar(path: str | os.PathLike[str]) -> Avatar:
    """Read an avatar.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Not an avatar, damaged, made by a newer version, or with values that are not finite.
    """
    path = Path(path)
    # The header first: a file of another kind is named as such before its data is read.
    header = read_avatar_header(path)
    tensors, _ = read_tensors(path)
    missing = [name for name in _ARRAYS if name not in tensors]
    if missing:
        raise _damaged(path, f"it has no {missing[0]}")
    try:
        return Avatar(
            name=header.name,
            head=header.head,
            weights=header.weights,
            **{name: tensors[name] for name in _ARRAYS},
            camera=header.camera,
            tracking=_with_prefix(tensors, _TRACKING),
            deltas=deltas_of(tensors),
            provenance=header.provenance,
            thumbnail=header.thumbnail,
            hair=None if header.hair is None else replace(header.hair, groom=_groom(header, _with_prefix(tensors, _HAIR))),
            **({_PAINTING: tensors[_PAINTING]} if _PAINTING in tensors else {}),
        )
    except (ShapeError, FileFormatError) as error:
        raise _damaged(path, str(error).rstrip(".").replace(";", ",")) from error


def _groom(header: AvatarHeader, tensors: dict[str, np.ndarray]) -> Groom | None:
    """The strands of a file; lashes of versions that stood wrong on lids that move are the package's."""
    groom = restored_parts(tensors)
    if groom is None or header.format_version >= OWN_LASHES or header.head.name != HEAD:
        return groom
    others = groom.select(groom.groups != LASHES)
    return groom if len(others) == len(groom) else join([others, library_groom("natural", part=GROUPS[LASHES])])


def _parse_header(path: Path, metadata: dict[str, str]) -> AvatarHeader:
    if metadata.get("format") != FORMAT_NAME:
        raise FileFormatError(f"{path} is not a GRMM avatar; choose a {EXTENSION} file.")
    version = metadata.get("format_version", "")
    if not (version.isascii() and version.isdigit() and len(version) < 10 and int(version) >= 1):
        raise _damaged(path, "its format version is not a number")
    if int(version) > FORMAT_VERSION:
        raise FileFormatError(
            f"{path} has avatar format {int(version)}, newer than {FORMAT_VERSION}, which this GRMM reads; update GRMM."
        )
    try:
        description = json.loads(metadata.get("avatar", ""))
        return AvatarHeader(
            format_version=int(version),
            name=_text(description["name"], MAX_NAME_LENGTH),
            head=_reference_from_json(description["head"]),
            weights=_reference_from_json(description["weights"]),
            camera=_camera_from_json(description["camera"]),
            provenance=_provenance_from_json(description["provenance"]),
            thumbnail=base64.b64decode(_text(description["thumbnail"]), validate=True),
            hair=_hair(description.get("hair")),
        )
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError, binascii.Error, GrmmError) as error:
        raise _damaged(path, "its description is malformed") from error


def _reference_to_json(reference: AssetReference) -> dict[str, str]:
    return {"name": reference.name, "sha256": reference.sha256}


def _reference_from_json(value: Any) -> AssetReference:
    return AssetReference(_text(value["name"], MAX_NAME_LENGTH), _hash(value["sha256"]))


def _provenance_from_json(value: Any) -> Provenance:
    if not isinstance(value["from_photos"], bool) or not isinstance(value["photos"], list):
        raise TypeError
    return Provenance(
        made_by=_text(value["made_by"]),
        from_photos=value["from_photos"],
        photos=tuple(PhotoRecord(_text(photo["name"]), _hash(photo["sha256"])) for photo in value["photos"]),
        date=_text(value["date"], MAX_NAME_LENGTH),
        licence=_text(value["licence"]),
    )


def _camera_to_json(camera: Camera | None) -> dict[str, Any] | None:
    if camera is None:
        return None
    return {
        "world_to_camera": camera.world_to_camera.tolist(),
        "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "width": camera.width, "height": camera.height, "orthographic": camera.orthographic,
    }  # fmt: skip


def _camera_from_json(value: Any) -> Camera | None:
    if value is None:
        return None
    if type(value["width"]) is not int or type(value["height"]) is not int:
        raise TypeError
    fx, fy, cx, cy = (float(value[name]) for name in ("fx", "fy", "cx", "cy"))
    matrix = np.array(value["world_to_camera"], np.float64)
    return Camera(matrix, fx, fy, cx, cy, value["width"], value["height"], bool(value["orthographic"]))


def _hair(value: Any) -> Hair | None:
    if value is None:
        return None
    scalp = value.get("scalp", True)
    if not isinstance(scalp, bool):
        raise TypeError
    parts = {_text(name): _settings(row) for name, row in value.get("parts", {}).items() if name in GROUPS}
    return Hair(None, _settings(value["settings"]), parts, scalp)


def _settings(value: Any) -> HairSettings:
    return HairSettings().changed(**{_text(name): float(number) for name, number in value.items()})


def _with_prefix(tensors: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name[len(prefix) :]: array for name, array in tensors.items() if name.startswith(prefix)}


def _text(value: Any, limit: int | None = None) -> str:
    if not isinstance(value, str) or (limit is not None and len(value) > limit):
        raise TypeError
    return value


def _hash(value: Any) -> str:
    text = _text(value)
    if text and not (len(text) == 64 and set(text) <= _HEX_DIGITS):
        raise ValueError
    return text


def _damaged(path: Path, reason: str) -> FileFormatError:
    return FileFormatError(f"{path} is not a readable avatar ({reason}); get the file again or make the avatar anew.")
