"""Layers: what adds to named expressions beside their sliders, such as bones on the face or a generated blink.

A layer's share of an expression is one more property of the head object, ``jawOpen.control`` beside ``jawOpen``. Shape keys and
joints are driven by their sum, and `Avatar.controls` returns it. So a slider keeps its own value and its own keys, whatever
moves the layer, and taking the layer away leaves the head as it was. `motion` adds and removes layers.
Must not import `avatar` or `drivers`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import bpy

from ...grmm_core.controls.table import EXPRESSIONS
from .custom_properties import property_path

LAYERS = ("control", "look", "blink", "breath")
_NAMES = frozenset(control.name for control in EXPRESSIONS)


def layer_name(expression: str, layer: str) -> str:
    """Name of the property that holds a layer's share of an expression."""
    return f"{expression}.{layer}"


def input_paths(obj: bpy.types.Object, expression: str) -> list[str]:
    """Data paths on a head object whose sum is a named expression: its slider and its layers."""
    names = (layer_name(expression, layer) for layer in LAYERS)
    return [property_path(name) for name in (expression, *(name for name in names if name in obj))]


def added_weights(obj: bpy.types.Object) -> dict[str, float]:
    """What all layers add to each named expression that has any; also of an evaluated head object."""
    added: dict[str, float] = {}
    for name, layer in layer_properties(obj):
        added[name] = added.get(name, 0.0) + float(obj[layer_name(name, layer)])
    return added


def layer_properties(obj: bpy.types.Object) -> Iterator[tuple[str, str]]:
    """Yield expression and layer of each share that a head object has."""
    for key in obj.keys():  # noqa: SIM118  an object is no mapping that can be iterated
        name, _, layer = key.partition(".")
        if layer in LAYERS and name in _NAMES:
            yield name, layer


def add_hidden(obj: bpy.types.Object, names: Iterable[str]) -> None:
    """Give a head object properties at 0 that something else sets."""
    for name in names:
        obj[name] = 0.0
        obj.property_overridable_library_set(property_path(name), True)


def remove_properties(obj: bpy.types.Object, names: Iterable[str]) -> None:
    """Take properties away with what drives them."""
    for name in list(names):
        if name in obj:
            obj.driver_remove(property_path(name))
            del obj[name]
