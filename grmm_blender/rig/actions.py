"""Actions: curves of an object's action, and writing many keys at once.

Blender 4.4 and later keep curves in layers, strips and slots; 5.0 removed the shortcut that hides them. Used by `live` and by
the importers of performances.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from ...grmm_core.performance.curves import ReducedCurve

_LAYER = "Layer"
_SAME_FRAME = 1e-3
_KINDS = ("interpolation", "handle_left_type", "handle_right_type")


def action_curves(obj: bpy.types.ID) -> Iterator[bpy.types.FCurve]:
    """Yield the curves that an object's own action holds for it."""
    yield from action_fcurves(obj) or ()


def action_fcurves(obj: bpy.types.ID) -> bpy.types.ActionChannelbagFCurves | None:
    """Return the collection of the curves that an object's own action holds for it, or None where it has no action."""
    bag = action_bag(obj)
    return None if bag is None else bag.fcurves


def action_bag(obj: bpy.types.ID) -> bpy.types.ActionChannelbag | None:
    """Return where an object's own action keeps its curves, or None where it has none."""
    data = obj.animation_data
    if data is None or data.action is None or data.action_slot is None:
        return None
    return _bag(data.action, data.action_slot)


def ensure_bag(obj: bpy.types.ID, name: str, action: bpy.types.Action | None = None) -> bpy.types.ActionChannelbag:
    """Return where an object's curves are kept, making its action, slot, layer and strip where they are missing.

    Args:
        obj: What is animated.
        name: Name of a new action.
        action: Action to assign, with a slot for `obj`; None keeps the object's action, or makes one.
    """
    data = obj.animation_data_create()
    if action is not None and data.action != action:
        data.action = action
    if data.action is None:
        data.action = bpy.data.actions.new(name)
    action = data.action
    if data.action_slot is None:
        data.action_slot = next(
            (slot for slot in action.slots if slot.target_id_type == obj.id_type and slot.name_display == obj.name), None
        ) or action.slots.new(obj.id_type, obj.name)
    return slot_bag(action, data.action_slot)


def slot_bag(action: bpy.types.Action, slot: bpy.types.ActionSlot) -> bpy.types.ActionChannelbag:
    """Return where a slot's curves are kept in an action, making layer and strip where they are missing."""
    layer = action.layers[0] if action.layers else action.layers.new(_LAYER)
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True)


def put_aside(obj: bpy.types.ID, push_down: bool) -> None:
    """Take the present action off an object, so that another one can be made; it stays in the file.

    Args:
        obj: What is animated.
        push_down: Leave the action playing in a track of the nonlinear animation; else it gets a fake user.
    """
    data = obj.animation_data
    if data is None or data.action is None:
        return
    action, slot = data.action, data.action_slot
    if push_down and slot is not None:
        first, last = action.frame_range
        track = data.nla_tracks.new()
        track.name = action.name
        strip = track.strips.new(action.name, int(first), action)
        strip.action_slot = slot
        strip.frame_start_raw, strip.frame_end_raw = first, max(last, first + 1.0)
        strip.blend_type, strip.extrapolation = data.action_blend_type, data.action_extrapolation  # it plays on as it did
        if data.action_influence < 1.0:
            strip.influence, strip.use_animated_influence = data.action_influence, True  # which makes a key of it
    else:
        action.use_fake_user = True
    data.action = None


@dataclass(frozen=True)
class Keys:
    """Keys of one curve.

    Attributes:
        points: Frame and value, frames increasing, [K, 2].
        left, right: Handles before and after each key, [K, 2].
        interpolation: "LINEAR" or "BEZIER".
    """

    points: np.ndarray
    left: np.ndarray
    right: np.ndarray
    interpolation: str


def linear_keys(frames: np.ndarray, values: np.ndarray) -> Keys:
    """A key on each of `frames` [K] with `values` [K], straight in between."""
    points = np.stack([frames, values], 1)
    return Keys(points, points, points, "LINEAR")


def reduced_keys(curve: ReducedCurve, start: float, fps: float) -> Keys:
    """Keys of a curve in seconds, as scene frames from `start`."""
    scale, shift = np.array([fps, 1.0]), np.array([start, 0.0])
    points = np.stack([curve.times, curve.values], 1)
    return Keys(points * scale + shift, curve.left * scale + shift, curve.right * scale + shift, curve.interpolation.upper())


def find_curve(bag: bpy.types.ActionChannelbag, path: str, index: int, group: str = "") -> bpy.types.FCurve:
    """Return the curve of a property, made where it is missing.

    Args:
        bag: Of `ensure_bag`.
        path: Data path of the property.
        index: Index in the property, 0 for single ones.
        group: Channel group of a new curve.
    """
    curve = bag.fcurves.find(path, index=index)
    if curve is None:
        curve = bag.fcurves.new(path, index=index)
        if group:  # not an argument of `new` in 4.5
            curve.group = bag.groups.get(group) or bag.groups.new(group)
    return curve


def replace_keys(curve: bpy.types.FCurve, keys: Keys, span: tuple[float, float]) -> None:
    """Put keys in the place of those between the frames of `span`; keys outside stay as they are."""
    points = curve.keyframe_points
    old = {name: np.empty(len(points) * 2, np.float32) for name in ("co", "handle_left", "handle_right")}
    for name, values in old.items():
        points.foreach_get(name, values)
    kinds = {name: np.empty(len(points), np.int32) for name in _KINDS}
    for name, numbers in kinds.items():
        points.foreach_get(name, numbers)
    frames = old["co"][::2]
    outside = (frames < span[0] - _SAME_FRAME) | (frames > span[1] + _SAME_FRAME)
    new = {"co": keys.points, "handle_left": keys.left, "handle_right": keys.right}
    merged = {name: np.concatenate([old[name].reshape(-1, 2)[outside], new[name].astype(np.float32)]) for name in old}
    order = np.argsort(merged["co"][:, 0], kind="stable")
    new_kinds = {"interpolation": keys.interpolation, "handle_left_type": "FREE", "handle_right_type": "FREE"}
    points.clear()
    points.add(len(order))
    for name, kept in kinds.items():
        number = bpy.types.Keyframe.bl_rna.properties[name].enum_items[new_kinds[name]].value
        points.foreach_set(name, np.concatenate([kept[outside], np.full(len(keys.points), number, np.int32)])[order])
    for name, values in merged.items():
        points.foreach_set(name, values[order].ravel())
    curve.update()


def _bag(action: bpy.types.Action, slot: bpy.types.ActionSlot) -> bpy.types.ActionChannelbag | None:
    for layer in action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(slot)
            if bag is not None:
                return bag
    return None
