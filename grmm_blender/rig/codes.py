"""Saved residual codes and the blend between them.

The states A and B of a code live on the head object as the arrays ``z_exp_a`` and ``z_exp_b`` (``z_id_a``, ``z_id_b``), and the
slider ``z_exp_blend`` goes from one to the other. The code of the avatar is the array ``z_exp``, as before, plus the blend. So
without saved states nothing changes, and array and slider can both be animated. `avatar` reads them, operators write them.
Must not import `avatar`.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from .definitions import CODES, Range

SLOTS = ("a", "b")
BLEND_RANGE = Range(-1.0, 2.0, 0.0, 1.0)
BLEND_DESCRIPTION = "From the saved code A at 0 to the saved code B at 1; values beyond exaggerate"


def slot_name(name: str, slot: str) -> str:
    """Property that holds a saved state of the code `name`; `slot` is "a" or "b"."""
    return f"{name}_{slot}"


def blend_name(name: str) -> str:
    """Property that blends the saved states of the code `name`."""
    return f"{name}_blend"


def saved_slots(obj: bpy.types.Object, name: str) -> list[str]:
    """The slots of a code in which something is saved."""
    return [slot for slot in SLOTS if slot_name(name, slot) in obj]


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
    weight = float(obj.get(blend_name(name), 0.0))
    for slot, share in zip(SLOTS, (1.0 - weight, weight), strict=True):
        values = np.array(obj[slot_name(name, slot)].to_list(), np.float32)[:size]
        result[: len(values)] += share * values
    return result


def code_properties(obj: bpy.types.Object, name: str) -> Iterator[str]:
    """Names of the properties of saved states that an object has for a code."""
    for key in (*(slot_name(name, slot) for slot in SLOTS), blend_name(name)):
        if key in obj:
            yield key
