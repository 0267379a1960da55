"""Saved residual codes and the blend between them.

The states A and B of a code live on the head object as the arrays ``z_exp_a`` and ``z_exp_b`` (``z_id_a``, ``z_id_b``), and the
slider ``z_exp_blend`` goes from one to the other. The code of the avatar is the array ``z_exp``, as before, plus the blend. So
without saved states nothing changes, and array and slider can both be animated. `avatar` reads them, operators write them.
Must not import `avatar`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np

from ...grmm_core.controls.control import Control, Limits
from ...grmm_core.controls.table import CONTROLS, Z_EXP, Z_ID
from .custom_properties import read_array

CODES = (Z_ID, Z_EXP)
SLOTS = ("a", "b")


@functools.cache
def slot_control(name: str, slot: str) -> Control:
    """Property that holds a saved state of the code `name`; `slot` is "a" or "b"."""
    code = CONTROLS[name]
    return replace(code, name=f"{name}_{slot}", description=f"{code.description}: saved as {slot.upper()}")


@functools.cache
def blend_control(name: str) -> Control:
    """Property that blends the saved states of the code `name`."""
    description = "From the saved code A at 0 to the saved code B at 1; values beyond exaggerate"
    limits = Limits(-1.0, 2.0, 0.0, 1.0)
    return Control(f"{name}_blend", "Blend A to B", description, CONTROLS[name].section, limits, "share")


def saved_slots(obj: bpy.types.Object, name: str) -> list[str]:
    """The slots of a code in which something is saved."""
    return [slot for slot in SLOTS if slot_control(name, slot).name in obj]


def blend_of(obj: bpy.types.Object, name: str, size: int) -> np.ndarray:
    """What the saved states add to a code, [size]; nothing before both are saved.

    Args:
        obj: Head object, also an evaluated one.
        name: `Z_ID` or `Z_EXP`; other arrays have no saved states.
        size: Length of the code; states of another length (an older model) are cut or filled with zeros.
    """
    result = np.zeros(size, np.float32)
    if name not in CODES or len(saved_slots(obj, name)) < len(SLOTS):
        return result
    weight = float(obj.get(blend_control(name).name, 0.0))
    for slot, share in zip(SLOTS, (1.0 - weight, weight), strict=True):
        values = read_array(obj, slot_control(name, slot).name)[:size]
        result[: len(values)] += share * values
    return result


def code_properties(obj: bpy.types.Object, name: str) -> Iterator[str]:
    """Names of the properties of saved states that an object has for a code."""
    for control in (*(slot_control(name, slot) for slot in SLOTS), blend_control(name)):
        if control.name in obj:
            yield control.name
