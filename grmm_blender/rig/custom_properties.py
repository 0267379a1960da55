"""Custom properties of a head object, which hold its controls: made, read and written as their rows in the core's table say.

They keep working where the extension is absent. Used by `build`, `avatar`, panels and operators.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ...grmm_core.controls.control import Control
from ...grmm_core.controls.table import CONTROLS


def property_path(name: str, index: int | None = None) -> str:
    """Return the data path of a property, or of one of its values, on the head object."""
    return f'["{name}"]' if index is None else f'["{name}"][{index}]'


def add_property(obj: bpy.types.Object, control: Control, size: int = 0) -> None:
    """Create the property of a control at rest, with range and tooltip; library overrides may change it.

    Args:
        obj: Head object.
        control: Its row.
        size: Values of an array on this head, 0 for a single number.
    """
    rest = [control.rest] * size if size else control.rest
    obj[control.name] = rest
    obj.id_properties_ui(control.name).update(
        min=control.limits.low,
        max=control.limits.high,
        soft_min=control.limits.soft_low,
        soft_max=control.limits.soft_high,
        default=rest,
        description=control.description,
        step=1.0,
        precision=3,
    )
    obj.property_overridable_library_set(property_path(control.name), True)


def controls_of(obj: bpy.types.Object, section: str = "") -> Iterator[Control]:
    """Yield the controls, of one section or of all, that a head object has properties for."""
    for control in CONTROLS.values():
        if control.source == "property" and control.name in obj and section in ("", control.section):
            yield control


def read_array(obj: bpy.types.Object, name: str) -> np.ndarray:
    """Return an array property, float32, empty where the object has none."""
    values = obj.get(name)
    return np.array([] if values is None else values.to_list(), np.float32)


def write_array(obj: bpy.types.Object, name: str, values: np.ndarray) -> None:
    """Set the array property of a control, kept in its range."""
    limits = CONTROLS[name].limits
    obj[name] = values.clip(limits.low, limits.high).tolist()


def put_at_rest(obj: bpy.types.Object, control: Control) -> None:
    """Set a property that exists to the value that changes nothing."""
    obj[control.name] = [control.rest] * len(obj[control.name]) if control.size else control.rest
