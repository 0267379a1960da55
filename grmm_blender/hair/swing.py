"""Hair that was baked while an animation played: which file, for what hair, and what it says of a frame."""

from __future__ import annotations

import dataclasses
import functools
import zlib
from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.errors import ConfigError, FileAccessError, GrmmError
from ...grmm_core.hair.swing import SwingBake
from ...grmm_core.session import HairUse
from ...grmm_core.session.swinging import named_groom
from ...grmm_core.session.wearing import OWN_HAIR
from ..rig.avatar import Avatar, located
from ..rig.identity import avatar_file, own_hair
from .grooms import RANDOM_HAIR

FOLDER = "grmm_hair"  # beside the blend file
_TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from Blender's axes


def bake_path(name: str) -> Path:
    """The file of an object's bake, beside the blend file. Raises `FileAccessError` where that has no place yet.

    Blend files of one folder have files of their own, and so have objects whose names differ in what file names cannot have.
    """
    if not bpy.data.filepath:
        raise FileAccessError("Save the blend file first; the baked hair is written beside it.")
    clean = bpy.path.clean_name(name)
    if clean != name:
        clean += f"_{zlib.crc32(name.encode()):08x}"
    blend = Path(bpy.data.filepath)
    return blend.parent / FOLDER / f"{blend.stem}.{clean}.npz"


def hair_key(head: bpy.types.Object) -> str:
    """What a bake belongs to: the strands of another person or another groom swing otherwise."""
    hair = head.grmm.hair
    return f"{head.grmm.source}|{hair.groom}|{hair.seed if hair.groom == RANDOM_HAIR else 0}"


def place_of_head(model_to_world: np.ndarray) -> np.ndarray:
    """Where a head is, as `Swing.step` takes it: y up, in the head's own metres, [4, 4]."""
    place = _TO_Y_UP @ model_to_world
    place[:3] /= np.cbrt(max(float(np.linalg.det(place[:3, :3])), 1e-12))
    return place


def swung(use: HairUse, head: bpy.types.Object, frame: float) -> tuple[HairUse, str]:
    """Return what is worn in a frame, and what is wrong with the bake: then the hair follows the head without swinging.

    Args:
        use: What is worn at rest.
        head: The evaluated head object.
        frame: With its part.
    """
    if not head.grmm.hair.swing:
        return use, ""
    try:
        return _swung(use, head, frame), ""
    except GrmmError as error:
        return use, f"{head.name}: {error}"


def _swung(use: HairUse, head: bpy.types.Object, frame: float) -> HairUse:
    hair = head.grmm.hair
    if not hair.swing_file:
        raise ConfigError("Bake the swing of the hair, or switch it off.")
    if hair.swing_of != hair_key(head):
        raise ConfigError("The hair was changed after its swing was baked; bake it again.")
    path = Path(located(head.original, hair.swing_file, hair.swing_known))
    changed = _written(path)
    if not changed:
        raise FileAccessError(f"The baked hair {path.name} is not there; bake it again.")
    if hair.swing_digest not in ("", _bake(path, changed).digest):  # earlier versions kept none
        raise ConfigError(f"Another hair or movement was baked to {path.name} since; bake it again.")
    source = Avatar(head).source
    strands = _strand_count(use, source, head.grmm.head_name, _written(Path(avatar_file(source))))
    return _at(use, path, changed, frame, strands)


def _written(path: Path) -> int:
    """When a file was written, as a number that is another one each time; 0 where there is none."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


@functools.lru_cache(maxsize=4)
def _bake(path: Path, changed: int) -> SwingBake:
    return SwingBake.read(path)


@functools.lru_cache(maxsize=16)
def _strand_count(use: HairUse, source: str, head_name: str, changed: int) -> int:
    """Strands of the groom that swings: an avatar's file may be written anew, and another version may have other grooms."""
    own = own_hair(source) if use.groom == OWN_HAIR else None
    groom = named_groom(use, head_name) if own is None else own.groom
    return 0 if groom is None else len(groom)


@functools.lru_cache(maxsize=16)
def _at(use: HairUse, path: Path, changed: int, frame: float, strands: int) -> HairUse:
    """The same object for the same frame, so that viewports see that nothing has changed."""
    bake = _bake(path, changed)
    first, part = int(np.floor(frame)), frame - float(np.floor(frame))
    swing = bake.at(first, strands)
    if part > 0.0:
        swing = swing + np.float32(part) * (bake.at(first + 1, strands) - swing)
    return dataclasses.replace(use, swing=swing)
