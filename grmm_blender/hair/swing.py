"""Hair that was baked while an animation played: which file, for what hair, and what it says of a frame."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.errors import FileAccessError, GrmmError
from ...grmm_core.hair.swing import SwingBake
from ...grmm_core.session import HairUse
from .grooms import RANDOM_HAIR

FOLDER = "grmm_hair"  # beside the blend file
_TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # from Blender's axes


def bake_path(name: str) -> str:
    """Where an object's bake goes, relative to the blend file. Raises `FileAccessError` where that has no place yet."""
    if not bpy.data.filepath:
        raise FileAccessError("Save the blend file first; the baked hair is written beside it.")
    return f"//{FOLDER}/{bpy.path.clean_name(name)}.npz"


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
    hair = head.grmm.hair
    if not hair.swing:
        return use, ""
    if not hair.swing_file:
        return use, "Bake the swing of the hair, or switch it off."
    if hair.swing_of != hair_key(head):
        return use, "The hair was changed after its swing was baked; bake it again."
    path = Path(bpy.path.abspath(hair.swing_file, library=head.original.library))
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return use, f"The baked hair {path.name} is not there; bake it again."
    try:
        return _at(use, path, changed, frame), ""
    except GrmmError as error:
        return use, str(error)


@functools.lru_cache(maxsize=4)
def _bake(path: Path, changed: int) -> SwingBake:
    return SwingBake.read(path)


@functools.lru_cache(maxsize=16)
def _at(use: HairUse, path: Path, changed: int, frame: float) -> HairUse:
    """The same object for the same frame, so that viewports see that nothing has changed."""
    bake = _bake(path, changed)
    first, part = int(np.floor(frame)), frame - float(np.floor(frame))
    strands = bake.frames.shape[1]
    swing = bake.at(first, strands)
    if part > 0.0:
        swing = swing + np.float32(part) * (bake.at(first + 1, strands) - swing)
    return dataclasses.replace(use, swing=swing)
