"""Actions: curves of an object's action, and writing many keys at once.

Blender 4.4 and later keep curves in layers, strips and slots; 5.0 removed the shortcut that hides them. Used by `live` and by
the importers of performances.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

_LAYER = "Layer"


def action_curves(obj: bpy.types.ID) -> Iterator[bpy.types.FCurve]:
    """Yield the curves that an object's own action holds for it."""
    data = obj.animation_data
    if data is None or data.action is None or data.action_slot is None:
        return
    bag = _bag(data.action, data.action_slot)
    if bag is not None:
        yield from bag.fcurves


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
    layer = action.layers[0] if action.layers else action.layers.new(_LAYER)
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(data.action_slot, ensure=True)


def set_keys(
    bag: bpy.types.ActionChannelbag, path: str, index: int, frames: np.ndarray, values: np.ndarray, group: str = ""
) -> bpy.types.FCurve:
    """Replace the keys of a curve between the first and the last of `frames`; keys outside stay.

    Args:
        bag: Of `ensure_bag`.
        path: Data path of the property.
        index: Index in the property, 0 for single ones.
        frames: Increasing, [K].
        values: [K].
        group: Channel group of a new curve.
    """
    curve = bag.fcurves.find(path, index=index)
    if curve is None:
        curve = bag.fcurves.new(path, index=index)
        if group:  # not an argument of `new` in 4.5
            curve.group = bag.groups.get(group) or bag.groups.new(group)
    kept = np.empty(len(curve.keyframe_points) * 2, np.float32)
    curve.keyframe_points.foreach_get("co", kept)
    kept = kept.reshape(-1, 2)
    outside = (kept[:, 0] < frames[0] - 1e-3) | (kept[:, 0] > frames[-1] + 1e-3)
    points = np.concatenate([kept[outside], np.stack([frames, values], 1).astype(np.float32)])
    points = points[np.argsort(points[:, 0], kind="stable")]
    curve.keyframe_points.clear()
    curve.keyframe_points.add(len(points))
    curve.keyframe_points.foreach_set("co", points.ravel())
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    curve.keyframe_points.foreach_set("interpolation", np.full(len(points), linear, np.int32))
    curve.update()
    return curve


def _bag(action: bpy.types.Action, slot: bpy.types.ActionSlot) -> bpy.types.ActionChannelbag | None:
    for layer in action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(slot)
            if bag is not None:
                return bag
    return None
