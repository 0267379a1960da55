"""Layers come and go: drivers of the expressions anew, and upper lids that several layers close without passing each other.

Slider and face bones add up and may exaggerate. What follows the gaze takes no more than the room that they leave, and a blink
closes an eye to 1, not by 1. All by drivers: a least of two, and sums whose curve is cut off.
"""

from __future__ import annotations

from ...grmm_core.head import HeadModel
from ..rig.avatar import Avatar
from ..rig.build import drive_again
from ..rig.custom_properties import property_path
from ..rig.drivers import drive_sum
from ..rig.layers import add_hidden, layer_name, layer_properties, remove_properties
from . import parts

BLINKS = {"left_eye": "eyeBlinkLeft", "right_eye": "eyeBlinkRight"}
BLINK = "blink"
"""Property of the head object that closes both eyes; the generated blink's keys are on it, in the NLA."""
_FAR = 10.0  # more than any sum of weights


def asked(share: str) -> str:
    """Property that holds what a layer asks for, before the others are looked at."""
    return f"{share}.asked"


def layers_changed(avatar: Avatar, head: HeadModel) -> None:
    """Drive a head by the layers that it has now."""
    obj = avatar.object
    for name in BLINKS.values():
        control, look, blink = (layer_name(name, layer) for layer in ("control", "look", "blink"))
        before = [property_path(found) for found in (name, control) if found in obj]
        if look in obj:
            _drive(avatar, f"{look}.room", before, [(0.0, 1.0), (1.0, 0.0)])
            _drive(avatar, look, [property_path(asked(look)), property_path(f"{look}.room")])
            obj.animation_data.drivers.find(property_path(look)).driver.type = "MIN"
            before.append(property_path(look))
        if blink in obj:
            _drive(avatar, f"{blink}.before", before, [(-_FAR, _FAR), (_FAR, -_FAR)])
            _drive(avatar, blink, [property_path(BLINK), property_path(f"{blink}.before")], [(0.0, 0.0), (1.0, 1.0)])
    drive_again(avatar, head)


def remove_layer(avatar: Avatar, layer: str) -> None:
    """Take a layer away from all expressions of a head, with what it was made of; drivers are then as if it had never been."""
    obj = avatar.object
    shares = [layer_name(name, found) for name, found in layer_properties(obj) if found == layer]
    made_of = [key for key in obj.keys() if any(key.startswith(f"{share}.") for share in shares)]  # noqa: SIM118
    remove_properties(obj, [*shares, *made_of])
    layers_changed(avatar, parts.head_of(avatar))


def _drive(avatar: Avatar, name: str, paths: list[str], points: list[tuple[float, float]] | None = None) -> None:
    """Make a hidden property the sum of others, by a curve of its own."""
    obj = avatar.object
    if name not in obj:
        add_hidden(obj, [name])
    obj.driver_remove(property_path(name))
    drive_sum(obj, property_path(name), -1, obj, paths)
    if points:
        parts.bend(obj.animation_data.drivers.find(property_path(name)), points)
